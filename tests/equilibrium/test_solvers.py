"""The sparse solvers of all platforms give one solution; errors before any of them."""

from functools import partial
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from bodies import (
    DENSITY,
    LENGTH,
    POISSON,
    SIDE,
    TIGHT,
    YOUNG,
    factor_solve,
    hanging,
    lane,
    small_lanes,
    small_model,
    solve,
    stiffness,
)
from jax import Array
from jaxtyping import Float

from softcal_jax.configurations import configuration_arrays
from softcal_jax.equilibrium import (
    _solver_choice,
    build_model,
    linearise,
    solve_equilibrium,
    tangent_values,
)
from softcal_jax.equilibrium._balance import System
from softcal_jax.equilibrium._linear_solver import (
    _MINIMUM_DEGREE,
    _MKL_DOMAIN_PARDISO,
    _NESTED,
    _PER_SOLVE,
    REFINED,
    AbstractLinearSolver,
    Klu,
    Pardiso,
)
from softcal_jax.equilibrium._sparsity import (
    Sparsity,
    from_entries,
    mask_supports,
    product,
)
from softcal_jax.fields import set_field
from softcal_jax.materials import Corotational, Isotropic, NeoHookean, StVenantKirchhoff
from softcal_jax.mesh import beam

PACKAGES = {
    "pardiso": "pardiso_mkl_jax",
    "klu": "klujax",
    "pardiso-host": "pypardiso",
}

SOLVERS = {"pardiso": Pardiso, "klu": Klu}
each_solver = pytest.mark.parametrize("solver", PACKAGES)
MESH = beam(LENGTH, SIDE, SIDE, (8, 2, 2))
SQUEEZED = MESH.points * np.array([-0.3, 0.0, 0.0])
RHS = np.random.default_rng(0).normal(size=(3, MESH.n_nodes, 3))
CONFIGURATION = lane(configuration_arrays(MESH, [hanging()]), 0)
FREE = ~np.asarray(CONFIGURATION.fixed).ravel()
REST = jnp.zeros(MESH.points.shape)
compiled = jax.jit(factor_solve)
by_factors = jax.jit(lambda solver, values, rhs: solver.factor_solve(values, rhs))


def linear_model(solver):
    """A beam of linear tets, small enough for LAPACK."""
    pytest.importorskip(PACKAGES[solver], reason="not installed on this platform")
    law = Corotational(Isotropic(YOUNG, POISSON))
    return build_model(MESH, law, density=DENSITY, solver=solver)


def dense_system(model, u):
    """Tangent and right-hand sides of the free coordinates."""
    return stiffness(model, u)[np.ix_(FREE, FREE)], RHS.reshape(3, -1)[:, FREE]


def counted(solver, n_negative):
    """What the solver can say about the negative eigenvalues; KLU says nothing."""
    return -1 if solver == "klu" else n_negative


@each_solver
def test_several_right_hand_sides_on_one_factor(solver):
    model = linear_model(solver)
    solved = compiled(model, CONFIGURATION, REST, jnp.asarray(RHS))
    K, rhs = dense_system(model, REST)
    x = np.linalg.solve(K, rhs.T).T
    assert bool(solved.ok)
    assert int(solved.n_negative) == counted(solver, 0)
    ours = np.asarray(solved.x).reshape(3, -1)
    # Rounding times the condition of a slender beam, below 1e6.
    np.testing.assert_allclose(ours[:, FREE], x, rtol=0, atol=1e-9 * np.abs(x).max())
    np.testing.assert_array_equal(ours[:, ~FREE], 0.0)


@each_solver
def test_an_indefinite_matrix_kills_nothing(solver):
    """Solved, and its negative eigenvalues counted by the solver that can."""
    model, u = linear_model(solver), jnp.asarray(SQUEEZED)
    solved = compiled(model, CONFIGURATION, u, jnp.asarray(RHS))
    K, rhs = dense_system(model, u)
    negative = int(np.sum(np.linalg.eigvalsh(K) < 0))
    assert negative > 0
    assert bool(solved.ok)
    assert int(solved.n_negative) == counted(solver, negative)
    x = np.asarray(solved.x).reshape(3, -1)[:, FREE]
    np.testing.assert_allclose(x @ K, rhs, rtol=0, atol=1e-8)


@each_solver
@pytest.mark.parametrize("E", [jnp.nan, 0.0])
def test_a_matrix_of_nan_or_zeros_is_flagged_and_kills_nothing(solver, E):
    model = linear_model(solver)
    broken = eqx.tree_at(lambda m: m.law.elasticity.E, model, jnp.asarray(E, float))
    solved = compiled(broken, CONFIGURATION, REST, jnp.asarray(RHS))
    assert not bool(solved.ok)
    np.testing.assert_array_equal(solved.x, 0.0)


@each_solver
def test_a_nan_right_hand_side_is_flagged(solver):
    rhs = jnp.asarray(RHS).at[1, 40, 2].set(jnp.nan)
    solved = compiled(linear_model(solver), CONFIGURATION, REST, rhs)
    assert not bool(solved.ok)
    np.testing.assert_array_equal(solved.x, 0.0)


@each_solver
def test_a_body_that_nothing_holds_is_singular(solver):
    model = linear_model(solver)
    loose = eqx.tree_at(
        lambda c: c.fixed, CONFIGURATION, jnp.zeros(MESH.points.shape, bool)
    )
    solved = compiled(model, loose, REST, jnp.asarray(RHS))
    # Rounding may hide the singularity; then the solution is huge, not plausible: a
    # held beam answers these forces with displacements of about 1 m.
    assert not bool(solved.ok) or float(jnp.max(jnp.abs(solved.x))) > 1e6


SINGULAR = {
    # A chain that nothing holds, of whole numbers, so that its last pivot is zero.
    "loose": [[1.0, -1.0, 0.0], [-1.0, 2.0, -1.0], [0.0, -1.0, 1.0]],
    "indefinite": [[0.0, 1.0, 1.0], [1.0, 0.0, 1.0], [1.0, 1.0, 2.0]],
    "one row": [[1.0, 0.5, 0.0], [0.5, 1.0, 0.0], [0.0, 0.0, 0.0]],
    "zero": np.zeros((3, 3)),
    "tiny": np.full((3, 3), 1e-310),
    "nan": np.full((3, 3), np.nan),
}


@pytest.mark.parametrize("solver", ["pardiso", "klu"])
def test_singular_matrices_are_flagged_in_their_lanes_alone(solver):
    """In one batch with regular ones, definite and indefinite, of any unit."""
    pytest.importorskip(PACKAGES[solver], reason="not installed on this platform")
    held = np.array([[2.0, -1.0, 0.0], [-1.0, 2.0, -1.0], [0.0, -1.0, 2.0]])
    regular = [held, -1e-9 * held, 1e9 * (held - np.eye(3))]
    pattern = from_entries(*np.indices((3, 3)).reshape(2, -1), 3, symmetric=True)
    matrices = np.stack([*regular, *SINGULAR.values()])
    values = jnp.asarray(matrices[:, pattern.rows, pattern.indices])
    analysed = SOLVERS[solver].analyse(pattern)
    rhs = jnp.array([[1.0, 2.0, -3.0], [1.0, 1.0, -2.0]])
    no_row, no_gap = jnp.zeros((0, 3)), jnp.zeros((2, 0))

    @jax.jit
    @jax.vmap
    def solve_all(values):
        system = System(values, no_row, jnp.zeros(0, bool))
        return system.solve(analysed, rhs, no_gap)

    solution = solve_all(values)
    n = len(regular)
    np.testing.assert_array_equal(solution.ok, [True] * n + [False] * len(SINGULAR))
    np.testing.assert_array_equal(solution.x[n:], 0.0)
    exact = np.linalg.solve(np.stack(regular), rhs.T).swapaxes(1, 2)
    size = np.abs(exact).max(axis=(1, 2), keepdims=True)
    np.testing.assert_allclose(solution.x[:n] / size, exact / size, rtol=0, atol=1e-12)


def test_no_singular_matrix_of_whole_numbers_makes_klu_raise():
    """Most have a pivot of exactly zero; those without symmetry are moved farther."""
    pytest.importorskip(PACKAGES["klu"], reason="not installed on this platform")
    random, n = np.random.default_rng(0), 5
    U = random.integers(-3, 4, (1000, n, n - 1)).astype(float)
    V = random.integers(-3, 4, (1000, n - 1, n)).astype(float)
    D = random.choice([-1.0, 1.0], (1000, 1, n - 1))
    for symmetric, K in {True: (U * D) @ U.swapaxes(1, 2), False: U @ V}.items():
        pattern = from_entries(
            *np.indices((n, n)).reshape(2, -1), n, symmetric=symmetric
        )
        solver = Klu.analyse(pattern)
        values = jnp.asarray(K[:, pattern.rows, pattern.indices])
        one = lambda values, solver=solver: solver.factor_solve(
            values, jnp.ones((1, n))
        )
        solution = jax.jit(lambda values, one=one: jax.lax.map(one, values))(values)
        assert not bool(jnp.any(solution.ok))


@pytest.mark.parametrize("solver", ["pardiso", "klu", "pardiso-host"])
def test_the_same_equilibrium(solver):
    """Solved to rounding, since the two walk different paths; KLU's is strict."""
    pytest.importorskip(PACKAGES[solver], reason="not installed on this platform")
    lanes = small_lanes(hanging())
    ours = solve(small_model(solver), lanes, TIGHT)
    default = solve(small_model(), lanes, TIGHT)
    assert bool(jnp.all(ours.converged))
    scale = float(jnp.max(jnp.abs(default.displacement)))
    np.testing.assert_allclose(
        ours.displacement, default.displacement, rtol=0, atol=1e-9 * scale
    )


def test_unknown_solver():
    mesh = beam(1.0, 1.0, 1.0, (1, 1, 1))
    with pytest.raises(ValueError, match=r"\['klu', .*'pardiso-host'\].*'mumps'"):
        build_model(mesh, NeoHookean(1.0, 0.3), density=1.0, solver="mumps")


@pytest.mark.parametrize(("solver", "package"), PACKAGES.items())
def test_a_solver_that_is_not_installed(solver, package, monkeypatch):
    there = lambda name: None if name == package else name
    monkeypatch.setattr(_solver_choice, "find_spec", there)
    mesh = beam(1.0, 1.0, 1.0, (1, 1, 1))
    message = rf"solver='{solver}' needs {package.replace('_', '-')}: .pip install"
    with pytest.raises(ImportError, match=message):
        build_model(mesh, NeoHookean(1.0, 0.3), density=1.0, solver=solver)


@pytest.mark.parametrize("solver", ["pardiso", "klu"])
def test_solvers_of_the_cpu_have_a_clear_error_on_a_gpu(solver, monkeypatch):
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    message = rf"'{solver}'.*'gpu'.*pardiso-host.*JAX_PLATFORMS=cpu"
    with pytest.raises(ValueError, match=message):
        linear_model(solver)


def test_others_in_the_process_do_not_change_the_threads_of_pardiso():
    """As `torch.set_num_threads` would, between an analysis and its factorization."""
    linear_model("pardiso")
    from pardiso_mkl_jax._mkl_loader import libmkl_rt

    threads = lambda: libmkl_rt.MKL_Domain_Get_Max_Threads(_MKL_DOMAIN_PARDISO)
    before, for_all = threads(), libmkl_rt.MKL_Get_Max_Threads()
    libmkl_rt.MKL_Set_Num_Threads(before + 1)
    try:
        assert threads() == before
    finally:
        libmkl_rt.MKL_Set_Num_Threads(for_all)


def test_float32_has_a_clear_error():
    needed = r'float64, .*float32.*config\.update\("jax_enable_x64", True\)'
    with jax.enable_x64(False), pytest.raises(ValueError, match=needed):
        build_model(beam(1.0, 1.0, 1.0, (1, 1, 1)), NeoHookean(1.0, 0.3), density=1.0)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"density": -1.0}, r"density .*\[kg/m3\], got -1"),
        ({"density": np.nan}, r"density .*\[kg/m3\], got nan"),
        ({"density": [1, 2, 3, np.inf, 5, 6]}, r"density .*\[kg/m3\], got inf"),
        ({"density": np.ones(5)}, r"density .*\(6,\), got shape \(5,\)"),
        ({"law": NeoHookean(np.ones(4), 0.3)}, r"\.E has shape \(4,\).* 6 tets"),
        ({"formulation": "selective"}, "formulation .*'selective'"),
    ],
)
@pytest.mark.usefixtures("unchecked")
def test_bad_models(changed, message):
    settings = {"law": NeoHookean(1.0, 0.3), "density": 1.0} | changed
    mesh = beam(1.0, 1.0, 1.0, (1, 1, 1))
    with pytest.raises(ValueError, match=message):
        build_model(mesh, **settings)


def test_with_law_checks_its_fields():
    model = build_model(
        beam(1.0, 1.0, 1.0, (1, 1, 1)), NeoHookean(1.0, 0.3), density=1.0
    )
    changed = model.with_law(NeoHookean(np.arange(1.0, 7.0), 0.3))
    np.testing.assert_array_equal(changed.law.E, np.arange(1.0, 7.0))
    with pytest.raises(ValueError, match=r"law\.nu has shape \(7,\)"):
        model.with_law(NeoHookean(1.0, np.full(7, 0.3)))


@pytest.mark.parametrize(
    ("cells", "order"), [((30, 1, 1), "degree"), ((6, 6, 6), "nested")]
)
def test_pardiso_takes_the_order_that_leaves_less_work(cells, order):
    """Minimum degree for a slender beam, nested dissection for a cube."""
    pytest.importorskip(PACKAGES["pardiso"], reason="not installed on this platform")
    mesh = beam(*(0.1 * n for n in cells), cells, order=2)
    law = Corotational(Isotropic(YOUNG, POISSON))
    solver = build_model(mesh, law, density=DENSITY, solver="pardiso").solver
    assert (solver.spare is None) == (order == "nested")
    # The spare of a solver is of the other order, and gives the same.
    random = np.random.default_rng(0)
    values = 0.01 * random.normal(size=solver.sparsity.nnz)
    values[solver.sparsity.diagonal] = 1.0
    rhs = random.normal(size=(2, solver.sparsity.n_dof))
    other = Pardiso._of(
        solver.sparsity, _MINIMUM_DEGREE if order == "nested" else _NESTED, 1
    )
    assert 0 < solver.work <= other.work
    x, other = (by_factors(s, values, rhs) for s in (solver, other))
    assert bool(x.ok)
    assert int(x.n_negative) == int(other.n_negative)
    np.testing.assert_allclose(x.x, other.x, rtol=0, atol=1e-12)


def test_a_zero_pivot_of_minimum_degree_is_no_singular_matrix():
    """A bar beyond its limit point, of cells that are all alike."""
    pytest.importorskip(PACKAGES["pardiso"], reason="not installed on this platform")
    model = build_model(
        beam(4.0, 1.0, 1.0, (4, 1, 1)),
        StVenantKirchhoff(Isotropic(1.0, 0.0)),
        density=1.0,
        solver="pardiso",
    )
    solver = model.solver
    assert solver.spare is not None
    # Pressed to half its length: indefinite, but far from singular.
    pressed = jnp.asarray(model.mesh.points * np.array([-0.5, 0.0, 0.0]))
    held = np.ones(solver.sparsity.n_dof, bool)
    held.reshape(-1, 3)[model.mesh.points[:, 0] > 0.0, 0] = False
    held.reshape(-1, 3)[model.mesh.points[:, 0] == 4.0] = True
    K, _ = jax.jit(
        lambda model, u: mask_supports(
            solver.sparsity, tangent_values(model, u), jnp.asarray(held)
        )
    )(model, pressed)
    dense = stiffness(model, pressed)[np.ix_(~held, ~held)]
    eigenvalues = np.linalg.eigvalsh(dense)
    assert np.min(np.abs(eigenvalues)) > 0.01
    rhs = np.where(held, 0.0, np.random.default_rng(0).normal(size=held.size))
    x = by_factors(solver, K, rhs[None])
    assert bool(x.ok)
    assert int(x.n_negative) == int(np.sum(eigenvalues < 0.0)) > 0
    np.testing.assert_allclose(
        x.x[0][~held], np.linalg.solve(dense, rhs[~held]), rtol=0, atol=1e-10
    )
    # Alone, the order of the solver would have called it singular.
    alone = eqx.tree_at(lambda s: s.spare, solver, None)
    assert not bool(by_factors(alone, K, x.x).ok)


def test_a_matrix_near_the_last_is_solved_by_its_factors():
    """By refinement, to rounding if exactly; one that is far is factorized.

    Of opposite right-hand sides the residuals cancel in a sum, and of one that is large
    beside another they drown it: each is judged by itself.
    """
    pytest.importorskip(PACKAGES["pardiso"], reason="not installed on this platform")
    solver = small_model("pardiso").solver
    random, sparsity = np.random.default_rng(0), solver.sparsity
    values = 0.01 * random.normal(size=sparsity.nnz)
    values[sparsity.diagonal] = 1.0
    rhs = random.normal(size=(2, sparsity.n_dof))
    opposite = np.stack([rhs[0], -rhs[0]])
    uneven = rhs * np.array([[1e6], [1.0]])
    change = random.normal(size=sparsity.nnz)

    @jax.jit
    def one_by_one(values, other, rhs):
        first = solver.factor_solve(values, rhs)
        x = solver.solve_near(other, rhs + 0.0 * first.x)  # not before the first
        left = jax.vmap(lambda row: product(sparsity, other, row))(x.x) - rhs
        return first.ok & x.ok, x.n_negative, jnp.linalg.norm(left, axis=1)

    exactly = jax.jit(partial(solver.solve_near, exact=True))
    for size, factorized in ((1e-4, False), (0.3, True)):
        near = jnp.asarray(values + size * change)
        by_factors(solver, jnp.asarray(values), jnp.asarray(rhs)).x.block_until_ready()
        exact = jax.block_until_ready(exactly(near, rhs))
        expected = by_factors(solver, near, jnp.asarray(rhs))
        np.testing.assert_allclose(exact.x, expected.x, rtol=0, atol=1e-14)
        assert (int(exact.n_negative) >= 0) == factorized
        for rows in (rhs, opposite, uneven):
            ok, n_negative, left = one_by_one(values, values + size * change, rows)
            assert bool(ok)
            assert (int(n_negative) >= 0) == factorized
            assert np.all(left <= REFINED * np.linalg.norm(rows, axis=1))


def test_a_matrix_is_factorized_where_that_takes_less_time_than_refining():
    """It is refined if a factorization takes the time of many solves."""
    pytest.importorskip(PACKAGES["pardiso"], reason="not installed on this platform")
    solver = small_model("pardiso").solver
    random, sparsity = np.random.default_rng(0), solver.sparsity
    values = 0.01 * random.normal(size=sparsity.nnz)
    values[sparsity.diagonal] = 1.0
    other = jnp.asarray(values + 1e-3 * random.normal(size=sparsity.nnz))
    rhs = random.normal(size=(2, sparsity.n_dof))

    @jax.jit
    def solved_with(work, values, other, rhs):
        costly = eqx.tree_at(lambda s: s.work, solver, work)
        first = costly.factor_solve(values, rhs)
        return costly.solve_near(other, rhs + 0.0 * first.x)

    operations = 1e-6 * _PER_SOLVE * float(solver.entries)  # in the time of a solve
    for solves, factorized in ((0.2, True), (20.0, False)):
        solved = solved_with(jnp.asarray(solves * operations), values, other, rhs)
        assert bool(solved.ok)
        assert (int(solved.n_negative) >= 0) == factorized, solves
        left = jax.vmap(lambda row: product(sparsity, other, row))(solved.x) - rhs
        assert np.all(np.abs(left) <= 1e-5)


class Counted(AbstractLinearSolver):
    """A solver that counts its factorizations; `spoiled` factors are of another."""

    sparsity: Sparsity
    real: AbstractLinearSolver
    spoiled: Float[Array, ""]
    name: ClassVar[str] = "counted"
    keeps_factors: ClassVar[bool] = True
    factorizations: ClassVar[list[int]] = []

    @property
    def solves_per_factor(self):
        return self.real.solves_per_factor

    @classmethod
    def analyse(cls, sparsity):
        return cls(sparsity, small_model("pardiso").solver, jnp.ones(()))

    def _factor_solve(self, values, rhs):
        def count(x):
            self.factorizations.append(len(x))
            return x

        x, n_negative, ok = self.real._factor_solve(values, rhs)
        return jax.pure_callback(count, x, x), n_negative, ok

    def solve_again(self, values, rhs):
        return self.spoiled * self.real.solve_again(values, rhs)


def test_derivatives_are_solved_to_rounding():
    """Also with the factors of a state that is only near."""
    pytest.importorskip(PACKAGES["pardiso"], reason="not installed on this platform")
    model = small_model("pardiso")
    hanging_lane = lane(small_lanes(hanging()), 0)
    u = solve_equilibrium(model, hanging_lane).displacement
    force = jnp.asarray(
        np.random.default_rng(0).normal(size=(2, model.solver.sparsity.n_dof))
    )
    gap = jnp.zeros((2, 0))

    @partial(jax.jit, static_argnames="differentiable")
    def after_another(model, u, *, differentiable):
        other = linearise(model, hanging_lane, (1.0 + 1e-5) * u).solve(force, gap)
        u = u + 0.0 * jnp.sum(other.x)  # not before the other
        how = {"differentiable": differentiable}
        return linearise(model, hanging_lane, u, **how).solve(force, gap).x

    exact, expected = (
        after_another(model, u, differentiable=flag) for flag in (True, False)
    )
    scale = float(jnp.max(jnp.abs(expected)))
    # Rounding, times the condition of a slender body.
    np.testing.assert_allclose(exact, expected, rtol=0, atol=1e-10 * scale)


@pytest.mark.slow
def test_products_with_the_hessian_factorize_nothing():
    """Both solves take factors that are there, or new ones if those are of another."""
    pytest.importorskip(PACKAGES["pardiso"], reason="not installed on this platform")
    model = small_model("pardiso")
    solver = Counted.analyse(model.solver.sparsity)
    model = eqx.tree_at(lambda m: m.solver, model, solver)
    hanging_lane = lane(small_lanes(hanging()), 0)
    along = jnp.asarray(np.random.default_rng(0).normal(size=(4, model.mesh.n_tets)))

    @jax.jit
    def products(E, along, spoiled):
        of_another = eqx.tree_at(lambda m: m.solver.spoiled, model, spoiled)

        def energy(E):
            body = set_field(of_another, "E", E)
            found = solve_equilibrium(body, hanging_lane, settings=TIGHT)
            return jnp.sum(found.displacement**2)

        slope, product_with = jax.linearize(jax.grad(energy), E)
        return slope, jax.lax.map(product_with, along)

    E = jnp.full(model.mesh.n_tets, YOUNG)
    counts, found = [], []
    for n, spoiled in ((1, 1.0), (4, 1.0), (1, 2.0), (4, 2.0)):
        Counted.factorizations.clear()
        slope, of_along = jax.block_until_ready(products(E, along[:n], spoiled))
        counts.append(len(Counted.factorizations))
        found.append((slope, of_along[0]))
    assert counts[0] == counts[1]
    assert counts[3] - counts[2] == 3 * 2
    for actual in found[1:]:
        for value, expected in zip(actual, found[0], strict=True):
            scale = float(jnp.max(jnp.abs(expected)))
            np.testing.assert_allclose(value, expected, rtol=0, atol=1e-9 * scale)


def test_a_factorization_takes_the_time_of_more_solves_in_a_bulky_body():
    """As counted by PARDISO; of thin ones, factors are hardly larger than matrices."""
    pytest.importorskip(PACKAGES["pardiso"], reason="not installed on this platform")

    def solves(cells):
        mesh, law = beam(1.0, 1.0, 1.0, cells), NeoHookean(1e5, 0.4)
        model = build_model(mesh, law, density=0.0, solver="pardiso")
        return float(model.solver.solves_per_factor)

    thin, bulky = solves((24, 24, 1)), solves((12, 12, 12))
    assert 1.0 < thin < 0.3 * bulky
