"""PARDISO behind a callback, as programs for a GPU use it."""

from importlib.util import find_spec
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
    YOUNG,
    factor_solve,
    hanging,
    lane,
    stiffness,
)

from softcal_jax.calibration import (
    CalibrationSettings,
    build_problem,
    initial_state,
    propose,
)
from softcal_jax.calibration._evaluation import weighed
from softcal_jax.configurations import configuration_arrays
from softcal_jax.equilibrium import build_model
from softcal_jax.equilibrium._linear_solver import AbstractLinearSolver
from softcal_jax.equilibrium._solver_choice import HostPardiso
from softcal_jax.equilibrium._sparsity import Sparsity
from softcal_jax.materials import ClassicalCorotational, Corotational, Isotropic
from softcal_jax.mesh import beam
from softcal_jax.robots import anisotropic_beam, synthetic_measurements
from softcal_jax.sensitivity import equilibrium_response

pytestmark = pytest.mark.skipif(
    find_spec("pypardiso") is None, reason="not installed on this platform"
)
compiled = jax.jit(factor_solve)
LAW = Corotational(Isotropic(YOUNG, POISSON))
SOFT = jnp.asarray(1e3, float)


def built(cells, law=LAW, solver="pardiso-host"):
    mesh = beam(LENGTH, SIDE, SIDE, cells)
    model = build_model(mesh, law, density=DENSITY, solver=solver)
    return model, lane(configuration_arrays(mesh, [hanging()]), 0)


def solved(model, configuration, seed):
    """Solutions at rest, and the largest error that is left in their equations."""
    shape = (2, *model.mesh.points.shape)
    rhs = jnp.asarray(np.random.default_rng(seed).normal(size=shape))
    solution = compiled(model, configuration, jnp.zeros(shape[1:]), rhs)
    free = ~np.asarray(configuration.fixed).ravel()
    K = stiffness(model, jnp.zeros(shape[1:]))[np.ix_(free, free)]
    x, b = (np.asarray(a).reshape(2, -1)[:, free] for a in (solution.x, rhs))
    return solution, np.abs(x @ K.T - b).max()


def test_two_patterns_in_turn_and_values_that_change():
    """One set of factors serves them all, and is never taken for that of another."""
    short, long = built((4, 1, 1)), built((8, 2, 2))
    softer = eqx.tree_at(
        lambda m: m.law.elasticity.E, short[0], jnp.asarray(1e3, float)
    )
    for seed, (model, configuration) in enumerate(
        [short, (softer, short[1]), long, short, short, long]
    ):
        solution, left = solved(model, configuration, seed)
        assert bool(solution.ok)
        assert int(solution.n_negative) == 0
        assert left < 1e-8


def test_a_tangent_that_is_not_symmetric_and_one_that_is_in_turn():
    other = built((4, 1, 1), ClassicalCorotational(Isotropic(YOUNG, POISSON)))
    for model, configuration in (built((4, 1, 1)), other, built((4, 1, 1))):
        solution, left = solved(model, configuration, 0)
        assert bool(solution.ok)
        assert int(solution.n_negative) == (0 if model.conservative else -1)
        assert left < 1e-8


def test_another_set_of_right_hand_sides_takes_no_factorization(monkeypatch):
    phases = []
    import pypardiso  # which searches the environment for its library

    call = pypardiso.PyPardisoSolver._call_pardiso
    monkeypatch.setattr(
        pypardiso.PyPardisoSolver,
        "_call_pardiso",
        lambda self, A, b: (phases.append(self.phase), call(self, A, b))[1],
    )
    model, configuration = built((8, 2, 2))
    softer = eqx.tree_at(lambda m: m.law.elasticity.E, model, SOFT)
    for body, seed in ((model, 0), (model, 1), (softer, 2)):
        solved(body, configuration, seed)
    assert phases == [12, 33, 33, 12, 33]


def test_each_lane_of_a_batch_has_its_matrix():
    model, _ = built((1, 1, 1))
    sparsity = model.solver.sparsity
    values = np.zeros((3, sparsity.nnz))
    values[:, sparsity.diagonal] = np.array([[1.0], [2.0], [0.0]])
    rhs = jnp.ones((2, sparsity.n_dof))
    lanes = jax.vmap(lambda values: model.solver.factor_solve(values, rhs))(values)
    np.testing.assert_array_equal(lanes.ok, [True, True, False])
    np.testing.assert_allclose(lanes.x[:, 1, 5], [1.0, 0.5, 0.0], rtol=1e-15)


def test_it_is_what_a_gpu_gets(monkeypatch):
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    model, _ = built((1, 1, 1), solver=None)
    assert isinstance(model.solver, HostPardiso)
    assert "host" in model.solver.name


def test_without_its_package(monkeypatch):
    monkeypatch.setattr(
        "softcal_jax.equilibrium._solver_choice.find_spec", lambda name: None
    )
    with pytest.raises(ImportError, match=r"softcal-jax\[gpu\]"):
        built((1, 1, 1))


@pytest.fixture(scope="module")
def calibration():
    robot = anisotropic_beam(cells=(2, 1, 1))
    measured = synthetic_measurements(
        robot.model, robot.space, robot.configurations, robot.target
    )
    return build_problem(robot.model, robot.space, measured)


class OnAnyPlatform(AbstractLinearSolver):
    """Stands for a solver, so that what is around it can be lowered."""

    sparsity: Sparsity
    name: ClassVar[str] = "diagonal"

    @classmethod
    def analyse(cls, sparsity):
        return cls(sparsity)

    def _factor_solve(self, values, rhs):
        x = rhs / values[self.sparsity.diagonal][None]
        return x, jnp.zeros((), jnp.int32), jnp.ones((), bool)

    def solve_again(self, values, rhs):
        return self._factor_solve(values, rhs)[0]


def test_what_is_around_the_solver_lowers_for_cuda(calibration):
    """A step of a calibration: nothing in its programs is of the CPU alone."""
    model = calibration.model
    solver = OnAnyPlatform(model.solver.sparsity)
    problem = eqx.tree_at(lambda p: p.model.solver, calibration, solver)
    settings = CalibrationSettings()

    def step(z, guess):
        of_all = problem.model, problem.space, problem.newton, z
        lane = lambda c, u: equilibrium_response(*of_all, c, u)
        lanes = jax.vmap(lane)(problem.configurations, guess)
        state = initial_state(settings, weighed(problem, z, lanes))
        return propose(problem.space, settings, state).z

    z, n_c = problem.space.start(), len(problem.configurations)
    traced = jax.jit(step).trace(z, jnp.zeros((n_c, model.n_points, 3)))
    program = traced.lower(lowering_platforms=("cuda",)).as_text()
    assert "lapack" not in program
    assert "pardiso" not in program.lower()
