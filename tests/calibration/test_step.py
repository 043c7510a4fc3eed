"""One step of the outer loop: bounds, order, the way out of a trap, acceptance."""

from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from printed_beam import BEAM

from softcal_jax.calibration import (
    CalibrationSettings,
    Evaluator,
    build_problem,
    calibrate,
    decide,
    descend,
    evaluate,
    initial_state,
    propose,
)
from softcal_jax.equilibrium import Workers
from softcal_jax.fields import exactly_known
from softcal_jax.robots import anisotropic_beam, synthetic_measurements
from softcal_jax.unknowns import ReadingLimits

CELLS = (2, 1, 1)
# Columns: E_t, E_l and theta, at both control points each.
E_T, E_L, THETA = slice(0, 2), slice(2, 4), slice(4, 6)
PAPER = {"scaling": "paper", "interpolation": "linear", "tensor_steps": False}


@pytest.fixture(scope="module")
def tensor():
    """Steps as tensors, as by default."""
    return anisotropic_beam(**BEAM)


@pytest.fixture(scope="module")
def quadratic():
    """The same of quadratic tets, for slow tests: programs of its own."""
    return anisotropic_beam(cells=CELLS)


def of_target(beam):
    return synthetic_measurements(
        beam.model, beam.space, beam.configurations, beam.target
    )


@pytest.fixture(scope="module")
def measured(tensor):
    return of_target(tensor)


@pytest.fixture(scope="module")
def problem(tensor, measured):
    return build_problem(tensor.model, tensor.space, measured)


@pytest.fixture(scope="module")
def evaluation(problem):
    z = problem.space.start()
    return evaluate(problem, z)


def random_state(problem, evaluation, seed, settings=None):
    """Any admissible parameters, any errors, any compliances."""
    random = np.random.default_rng(seed)
    space = problem.space
    low, high = np.asarray(space.lower()), np.asarray(space.upper())
    z = random.uniform(low, high)
    z[E_T], z[E_L] = np.maximum(z[E_T], z[E_L]), np.minimum(z[E_T], z[E_L])
    z = space.admissible(jnp.asarray(z))
    n_e, n_p = evaluation.rows.W.shape
    evaluation = eqx.tree_at(
        lambda e: (e.z, e.rows.W, e.rows.error),
        evaluation,
        (
            z,
            jnp.asarray(random.normal(size=(n_e, n_p))),
            jnp.asarray(10.0 ** random.uniform(-2, 1) * random.normal(size=n_e)),
        ),
    )
    return initial_state(settings or CalibrationSettings(step_bound=1.0), evaluation)


def test_tensor_step_keeps_bounds_and_order(problem, evaluation):
    """Wherever it starts and whatever the data say; and it does use its room."""
    low, high = problem.space.lower(), problem.space.upper()
    on_a_bound = on_the_step_bound = 0
    for seed in range(60):
        state = random_state(problem, evaluation, seed)
        proposal = propose(problem.space, CalibrationSettings(), state)
        z = np.asarray(proposal.z)
        assert np.all(z >= low - 1e-12)
        assert np.all(z <= high + 1e-12)
        assert np.all(z[E_L] < z[E_T])
        assert proposal.qp.kkt_residual < 1e-8
        size = np.max(np.abs(proposal.qp.lambda_p))
        assert size <= 1.0 + 1e-12
        on_the_step_bound += size > 1.0 - 1e-9
        moduli = np.r_[z[E_T] - high[E_T], z[E_L] - low[E_L]]
        on_a_bound += np.any(np.abs(moduli) < 1e-9)
    assert on_a_bound > 5
    assert 5 < on_the_step_bound < 60


def test_linear_model_of_a_tensor_step_is_that_of_the_parameters(problem, evaluation):
    """For a short step: the same cost as with W_ep and the change of z itself."""
    state = random_state(problem, evaluation, seed=3)
    # The angle's derivative is that of a regular tensor, not of an isotropic one.
    assert np.min(state.z[E_T] - state.z[E_L]) > 0.05
    short = eqx.tree_at(lambda s: s.step_bound, state, jnp.asarray(1e-5, float))
    proposal = propose(problem.space, CalibrationSettings(), short)
    now = state.evaluation
    change = problem.space.wrap(proposal.z) - state.z
    linear = 0.5 * jnp.sum((now.rows.W @ change + now.rows.error) ** 2)
    fall = now.cost - linear
    assert fall > 0.0
    np.testing.assert_allclose(now.cost - proposal.cost, fall, rtol=1e-3)


def test_guess_follows_the_tangents_of_the_parameters(problem, evaluation):
    """A warm start to first order: u + du/dz dz, with dz from the tensor."""
    state = initial_state(CalibrationSettings(), evaluation)
    state = eqx.tree_at(lambda s: s.step_bound, state, jnp.asarray(1e-5, float))
    proposal = propose(problem.space, CalibrationSettings(), state)
    dz = proposal.z - state.z
    assert np.max(np.abs(dz)) > 1e-6
    expected = jnp.einsum("p,cpni->cni", dz, evaluation.response.displacement)
    moved = proposal.guess - evaluation.equilibrium.displacement
    size = float(jnp.max(jnp.abs(expected)))
    np.testing.assert_allclose(moved, expected, rtol=0, atol=1e-3 * size)


def trapped(beam, measured):
    """Isotropic, and both axes a quarter turn wrong."""
    E = 600e3
    wrong = [np.deg2rad(20.0 - 90.0), np.deg2rad(-35.0 + 90.0)]
    starts = [jnp.full(2, E), jnp.full(2, E * (1.0 - 1e-6)), jnp.asarray(wrong)]
    space = eqx.tree_at(lambda s: [e.start for e in s.entries], beam.space, starts)
    exact = exactly_known()
    return calibrate(
        beam.model, space, measured, uncertain=exact, starts=1, intervals=None
    )


def test_tensor_steps_find_the_way_out_of_the_trap(tensor, measured):
    result = trapped(tensor, measured)
    assert result.converged
    # Down to the tolerance of lambda_p, of measurements solved to Newton's.
    for name, value in tensor.target.items():
        assert result.value(name) == pytest.approx(value, rel=1e-4)


@pytest.mark.slow
def test_a_fit_ends_where_a_body_is_isotropic(quadratic):
    """Noise puts the optimum where both moduli of CP 2 meet; tensors do not end there.

    Neither another angle nor a little contrast, either way, lowers the cost there.
    """
    target = {**quadratic.target, "E_l of CP 2": 150e3}
    target |= {"E_t of CP 1": 600e3, "E_l of CP 1": 599.94e3, "E_t of CP 2": 600e3}
    poses = synthetic_measurements(
        quadratic.model, quadratic.space, quadratic.configurations, target
    )
    random = np.random.default_rng(4)
    noisy = lambda c: c.measured + 1e-3 * random.standard_normal(c.measured.shape)
    poses = [replace(c, measured=noisy(c)) for c in poses]
    result = calibrate(
        quadratic.model,
        quadratic.space,
        poses,
        uncertain=exactly_known(),
        starts=1,
        intervals=None,
    )
    assert result.converged
    value = {n: result.value(f"{n} of CP 2") for n in ("E_t", "E_l")}
    assert value["E_l"] == pytest.approx(value["E_t"], rel=1e-6)
    problem = build_problem(quadratic.model, quadratic.space, poses)
    for turn in np.deg2rad([-60.0, -30.0, 0.0, 30.0, 60.0, 90.0]):
        z = result.z.at[5].add(turn) + jnp.array([0.0, 5e-3, 0.0, -5e-3, 0.0, 0.0])
        cost = float(evaluate(problem, problem.space.wrap(z)).cost)
        assert cost >= result.history[-1].cost, np.rad2deg(turn)


@pytest.mark.slow  # it compiles a calibration of its own
def test_without_them_the_same_start_stays_isotropic(quadratic):
    """The trap: E_l = E_t hides the angle, and the order keeps it so."""
    plain = anisotropic_beam(cells=CELLS, tensor_steps=False, ordered=True)
    result = trapped(plain, of_target(quadratic))
    for point in ("CP 1", "CP 2"):
        ratio = result.value(f"E_l of {point}") / result.value(f"E_t of {point}")
        assert ratio == pytest.approx(1.0, abs=1e-4)
    # Half the sum of squares in noise units; it is zero at the target.
    assert result.history[-1].cost > 100.0


def untangled(evaluation):
    """Without the tangents, for a space that they do not belong to."""
    return eqx.tree_at(lambda e: e.response.displacement, evaluation, None)


def test_paper_mode_limits_every_step(measured, evaluation):
    """1 % of S = 1 MPa and 0.005 rad, whatever the QP would like."""
    beam = anisotropic_beam(**BEAM, **PAPER)
    paper = build_problem(beam.model, beam.space, measured)
    settings = CalibrationSettings(adapt=False)
    limits = np.array([1e4, 1e4, 1e4, 1e4, 0.005, 0.005])
    longest = np.zeros(6)
    for seed in range(30):
        state = random_state(paper, untangled(evaluation), seed, settings)
        proposal = propose(paper.space, settings, state)
        moves = np.abs(paper.space.from_scaled(proposal.z - state.z)) / limits
        assert np.all(moves <= 1.0 + 1e-9)
        assert np.all(proposal.z[E_L] <= proposal.z[E_T] + 1e-12)
        longest = np.maximum(longest, moves)
        after = decide(paper.space, settings, state, proposal, state.evaluation)
        assert float(after.step_bound) == settings.step_bound
    np.testing.assert_allclose(longest, 1.0, rtol=1e-9)


def test_paper_mode_takes_a_step_that_makes_the_fit_worse(problem, evaluation):
    """With the same bound on the next one; the trust region would refuse it."""
    worse = costing(evaluation, 1e9)
    for adapt in (False, True):
        settings = CalibrationSettings(adapt=adapt)
        state = random_state(problem, evaluation, 0, settings)
        proposal = propose(problem.space, settings, state)
        there = eqx.tree_at(lambda e: e.z, worse, proposal.z)
        after = decide(problem.space, settings, state, proposal, there)
        assert bool(after.accepted) is not adapt
        if adapt:
            size = float(jnp.max(jnp.abs(proposal.qp.lambda_p)))
            np.testing.assert_allclose(after.step_bound, 0.25 * size, rtol=1e-12)
            np.testing.assert_array_equal(after.z, state.z)
        else:
            assert float(after.step_bound) == settings.step_bound
            np.testing.assert_array_equal(after.z, proposal.z)


def costing(evaluation, cost):
    """The same evaluation with another cost."""
    error = jnp.zeros_like(evaluation.rows.error).at[0].set(np.sqrt(2.0 * cost))
    return eqx.tree_at(lambda e: e.rows.error, evaluation, error)


def after_costs(problem, evaluation, costs):
    """State after steps that were kept, with these costs."""
    settings = CalibrationSettings()
    state = initial_state(settings, costing(evaluation, costs[0]))
    for cost in costs[1:]:
        state = tried(problem, state, cost)
        assert bool(state.accepted)
    return state


def tried(problem, state, cost):
    settings = CalibrationSettings()
    proposal = propose(problem.space, settings, state)
    # A model that promises next to nothing: acceptance is by the costs alone.
    proposal = eqx.tree_at(
        lambda p: p.cost, proposal, state.evaluation.cost * (1.0 - 1e-9)
    )
    here = costing(state.evaluation, cost)
    return decide(problem.space, settings, state, proposal, here)


def test_a_cost_below_one_of_the_recent_ones_is_kept(problem, evaluation):
    state = after_costs(problem, evaluation, [100.0, 10.0])
    assert bool(tried(problem, state, 99.0).accepted)
    assert not bool(tried(problem, state, 101.0).accepted)
    assert not bool(tried(problem, state, np.inf).accepted)


def test_memory_ends(problem, evaluation):
    """The highest of the last five counts, not the highest ever."""
    costs = [100.0, 10.0, 9.0, 8.0, 7.0]
    state = after_costs(problem, evaluation, costs)
    np.testing.assert_allclose(np.sort(state.recent_costs), sorted(costs))
    assert bool(tried(problem, state, 99.0).accepted)
    later = after_costs(problem, evaluation, [*costs, 6.0])
    assert not bool(tried(problem, later, 99.0).accepted)
    assert not bool(tried(problem, later, 10.1).accepted)
    assert bool(tried(problem, later, 9.9).accepted)


def test_a_refused_cost_is_not_remembered(problem, evaluation):
    state = after_costs(problem, evaluation, [10.0, 5.0])
    refused = tried(problem, state, 50.0)
    np.testing.assert_array_equal(refused.recent_costs, state.recent_costs)
    assert not bool(tried(problem, refused, 20.0).accepted)


@pytest.mark.parametrize(
    ("promised", "worse", "adapt", "ends"),
    [
        (1e-9, 0.0, True, True),
        (1e-7, 0.0, True, False),
        (1e-9, 1e-4, True, False),
        (1e-9, 0.0, False, False),  # as in the paper, until lambda_p vanishes
    ],
)
def test_a_step_that_gains_next_to_nothing_ends_the_search(
    problem, evaluation, promised, worse, adapt, ends
):
    """However long it is, if it also costs next to nothing: 1e-8 of the cost."""
    settings = CalibrationSettings(adapt=adapt)
    state = initial_state(settings, evaluation)
    W = np.asarray(evaluation.rows.W)
    left, _, _ = np.linalg.svd(W)
    # Half of the square of an error that no parameter reaches, and of the weakest one.
    error = np.sqrt(20.0) * (left[:, -1] + np.sqrt(promised) * left[:, 5])
    state = eqx.tree_at(lambda s: s.evaluation.rows.error, state, jnp.asarray(error))
    state = eqx.tree_at(lambda s: s.step_bound, state, jnp.asarray(10.0, float))
    proposal = propose(problem.space, settings, state)
    assert np.max(np.abs(proposal.qp.lambda_p)) > settings.tol
    fall = 1.0 - float(proposal.cost / state.evaluation.cost)
    assert fall == pytest.approx(promised, rel=1e-3)
    assert bool(proposal.vanishes) == (adapt and promised < 1e-8)
    now = costing(state.evaluation, float(state.evaluation.cost) * (1.0 + worse))
    after = decide(problem.space, settings, state, proposal, now)
    assert bool(after.converged) == ends
    if proposal.vanishes:  # nothing was learned from a step that was not taken
        np.testing.assert_array_equal(after.curvature.matrix, 0.0)


def test_a_step_that_vanishes_is_not_tried(tensor, measured, problem):
    """At the optimum the loop ends where it is."""
    target = jnp.asarray([tensor.target[name] for name in problem.space.names])
    z = problem.space.to_scaled(target)
    there = evaluate(problem, z)
    settings = CalibrationSettings()
    state = initial_state(settings, there)
    proposal = propose(problem.space, settings, state)
    assert bool(proposal.vanishes)
    np.testing.assert_array_equal(proposal.z, z)
    np.testing.assert_array_equal(proposal.guess, there.equilibrium.displacement)
    after = decide(problem.space, settings, state, proposal, there)
    assert bool(after.converged)
    assert int(after.step) == 1
    np.testing.assert_array_equal(after.z, z)
    # Nor is one that only the bound on the step holds short.
    away = evaluate(problem, problem.space.start())
    state = initial_state(settings, away)
    state = eqx.tree_at(lambda s: s.step_bound, state, jnp.asarray(1e-8, float))
    assert not bool(propose(problem.space, settings, state).vanishes)


def test_a_failed_equilibrium_is_refused_whatever_its_cost(problem, evaluation):
    state = after_costs(problem, evaluation, [10.0])
    proposal = propose(problem.space, CalibrationSettings(), state)
    failed = eqx.tree_at(lambda e: e.ok, costing(evaluation, 1.0), jnp.zeros((), bool))
    for adapt in (True, False):
        settings = CalibrationSettings(adapt=adapt)
        after = decide(problem.space, settings, state, proposal, failed)
        assert not bool(after.accepted)
        # Or the same step would be tried again, and fail again.
        size = float(jnp.max(jnp.abs(proposal.qp.lambda_p)))
        assert float(after.step_bound) == pytest.approx(0.25 * size)


def test_rank_deficient_fit_ends_in_finite_bounded_steps(problem, evaluation):
    """One marker, three numbers, six unknowns: the fit is exact and far from unique."""
    inverse_std = np.zeros_like(problem.configurations.effectors.inverse_std)
    inverse_std[0, 0] = 1e4  # only the first marker of the first pose is seen
    where = lambda p: p.configurations.effectors.inverse_std
    problem = eqx.tree_at(where, problem, inverse_std)
    settings = CalibrationSettings()
    z = problem.space.start()
    state = initial_state(settings, evaluate(problem, z))
    first = float(state.evaluation.cost)
    while not (state.converged or state.stalled) and state.step < 30:
        proposal = propose(problem.space, settings, state)
        now = evaluate(problem, proposal.z, proposal.guess)
        bound = float(state.step_bound)
        state = decide(problem.space, settings, state, proposal, now)
        assert np.all(np.isfinite(state.lambda_p))
        assert np.max(np.abs(state.lambda_p)) <= bound * (1.0 + 1e-9)
        assert np.all(state.z >= problem.space.lower())
        assert np.all(state.z <= problem.space.upper())
    assert bool(state.converged)
    assert np.linalg.matrix_rank(state.evaluation.rows.W) == 3
    assert float(state.evaluation.cost) < 1e-6 * first


def test_order_holds_along_the_way_without_tensors(measured, evaluation):
    """As rows of the QP: from E_l <= E_t every step ends there."""
    beam = anisotropic_beam(**BEAM, tensor_steps=False)
    plain = build_problem(beam.model, beam.space, measured)
    active = 0
    for seed in range(40):
        state = random_state(plain, untangled(evaluation), seed)
        proposal = propose(plain.space, CalibrationSettings(), state)
        slack = np.asarray(proposal.z[E_T] - proposal.z[E_L])
        assert np.all(slack > -1e-12)
        assert np.all(np.abs(proposal.qp.lambda_p) <= 1.0 + 1e-12)
        active += np.any(np.abs(slack) < 1e-9)
    assert active > 3


def test_a_fit_that_leaves_an_error_converges_by_its_curvature(problem):
    """Noise of 1 mm, which Gauss-Newton steps alone do not come to an end with."""
    effectors = problem.configurations.effectors
    noise = 1e-3 * np.random.default_rng(6).normal(size=effectors.measured.shape)
    noisy = eqx.tree_at(
        lambda p: (
            p.configurations.effectors.measured,
            p.configurations.effectors.inverse_std,
        ),
        problem,
        (effectors.measured + noise, np.full_like(effectors.inverse_std, 1e3)),
    )
    settings, z = CalibrationSettings(), problem.space.start()
    begin = initial_state(settings, evaluate(noisy, z))
    ends = []
    for learns in (True, False):
        state = begin
        while not (state.converged or state.stalled) and state.step < 30:
            if not learns:
                where = lambda s: s.curvature.used
                state = eqx.tree_at(where, state, jnp.zeros((), bool))
            proposal = propose(noisy.space, settings, state)
            now = evaluate(noisy, proposal.z, proposal.guess)
            if proposal.precise:
                now = evaluate(noisy, proposal.z, now.equilibrium.displacement)
            state = decide(noisy.space, settings, state, proposal, now)
        ends.append(state)
    curved, linear = ends
    assert bool(curved.converged)
    assert not bool(linear.converged)
    assert float(curved.evaluation.cost) <= float(linear.evaluation.cost)
    assert float(curved.evaluation.cost) > 0.01


@pytest.mark.parametrize("side", ["lower", "upper"])
def test_a_reading_stays_within_its_limit(problem, side):
    """Half way to where the data lead it; and the best fit within is on the limit."""
    settings, z = CalibrationSettings(), problem.space.start()

    def fitted(limited):
        with Workers(problem.model, len(problem.poses)) as workers:
            evaluate = Evaluator(limited, workers)
            state = initial_state(settings, evaluate.from_rest(z))
            first = np.ravel(state.evaluation.effectors)
            end = descend(evaluate, settings, state, lambda _: None)
        return first, np.ravel(end.evaluation.effectors), end

    begin, free, best = fitted(problem)
    k = int(np.nanargmax(np.abs(free - begin)))
    sign = np.sign(free[k] - begin[k]) * (1.0 if side == "upper" else -1.0)
    half = 0.5 * (begin[k] + free[k])
    # What leads up is limited from above; seen from the other side, it starts outside.
    ends = (-np.inf, half) if sign > 0.0 else (half, np.inf)
    limits = ReadingLimits([k], *np.array(ends)[:, None])
    _, held, end = fitted(replace(problem, limits=limits))
    assert bool(end.converged)
    beyond = (held[k] - half) * sign
    motion = abs(free[k] - begin[k])
    if side == "upper":
        assert abs(beyond) < 1e-5 * motion
        assert float(end.evaluation.cost) > float(best.evaluation.cost)
    else:  # it is no limit of the fit, but of its start
        np.testing.assert_allclose(held[k], free[k], atol=1e-5 * motion)
