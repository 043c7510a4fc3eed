"""Searches from many starts: their optima, mirror images, and when they end."""

from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from printed_beam import BEAM
from wording import says

from benchmarks._compilations import Compilations
from softcal_jax.calibration import (
    FROM_ANYWHERE,
    Evaluator,
    MultiStartResult,
    Optimum,
    Run,
    build_problem,
    calibrate,
    evaluate,
    images_of,
    initial_state,
    multi_start,
    run_start,
)
from softcal_jax.calibration._checkpoint import Journal
from softcal_jax.calibration._runs import Basin, better, leads_to, not_begun, wanted
from softcal_jax.calibration._starts import _optima, search
from softcal_jax.equilibrium import Workers
from softcal_jax.fields import (
    ControlPointParameters,
    ControlPoints,
    Parameter,
    ParameterSpace,
    default_starts,
    exactly_known,
    motor_zero,
    random_starts,
)
from softcal_jax.robots import AnisotropicBeam, anisotropic_beam, synthetic_measurements
from softcal_jax.unknowns import Problem

# Columns: E_t, E_l and theta, at both control points each.
E_T, E_L, THETA = slice(0, 2), slice(2, 4), slice(4, 6)


class Measured(NamedTuple):
    """A beam, its synthetic measurements, and three starts; the last ends wrong."""

    beam: AnisotropicBeam
    data: tuple
    problem: Problem
    starts: jax.Array


@pytest.fixture(scope="module")
def measured():
    """Two poses across the print plane and out of it; of the beam itself."""
    beam = anisotropic_beam(**BEAM)
    data = synthetic_measurements(
        beam.model, beam.space, beam.configurations, beam.target
    )
    others = random_starts(beam.space, 30, seed=1)
    starts = jnp.stack([beam.space.start(), others[0], others[1]])
    return Measured(beam, data, build_problem(beam.model, beam.space, data), starts)


@pytest.fixture(scope="module")
def plain(measured):
    return multi_start(measured.problem, measured.starts, mirror=False)


@pytest.fixture(scope="module")
def mirrored(measured):
    return multi_start(measured.problem, measured.starts)


def target(measured):
    return np.array([measured.beam.target[n] for n in measured.beam.space.names])


def test_a_start_in_the_basin_finds_the_target(measured, plain):
    assert plain.converged[0]
    np.testing.assert_allclose(plain.values[0], target(measured), rtol=1e-5)
    np.testing.assert_allclose(
        plain.starts, jax.vmap(measured.beam.space.from_scaled)(measured.starts)
    )


def test_a_run_is_that_of_calibrate(measured, plain):
    """The same loop step by step, and its errors."""
    beam = measured.beam
    alone = calibrate(
        beam.model,
        beam.space,
        measured.data,
        starts=1,
        intervals=None,
        uncertain=exactly_known(),
    )
    assert alone.intervals == ()
    assert plain.steps[0] == len(alone.history) - 1
    np.testing.assert_allclose(plain.z[0], alone.z, rtol=0, atol=1e-8)
    errors = [np.sqrt(2.0 * entry.cost) for entry in alone.history]
    # Down to the rounding of equilibria, 1e-8 of some hundred noise units.
    trace = plain.errors[0][: len(errors)]
    np.testing.assert_allclose(trace, errors, rtol=1e-5, atol=1e-6)
    assert np.isnan(plain.errors[0][len(errors) :]).all()


def test_errors_go_from_the_start_to_the_end(measured, plain):
    assert plain.errors.shape == (3, FROM_ANYWHERE.max_steps + 1)
    for i, start in enumerate(measured.starts):
        first = evaluate(measured.problem, start)
        steps = plain.steps[i]
        np.testing.assert_allclose(
            plain.errors[i, 0], np.sqrt(2.0 * first.cost), rtol=1e-6
        )
        end = np.sqrt(2.0 * plain.cost[i])
        if i == 1:  # it saw that the first start leads to its end
            assert plain.errors[i, steps] > end
        else:
            np.testing.assert_allclose(plain.errors[i, steps], end, rtol=1e-12)
        assert np.isfinite(plain.errors[i]).sum() == steps + 1


def test_starts_of_one_group_change_nothing_for_each_other(measured, mirrored):
    """Bit for bit, whichever thread takes a lane; a lost one too."""
    lost = jnp.full_like(measured.starts[0], jnp.nan)
    starts = jnp.stack([measured.starts[0], measured.starts[2], lost])
    again = multi_start(measured.problem, starts)
    for name in ("z", "cost", "steps", "converged", "errors"):
        for ours, theirs in ((0, 0), (1, 2)):
            np.testing.assert_array_equal(
                getattr(again, name)[ours], getattr(mirrored, name)[theirs]
            )


def test_order_of_the_starts_changes_no_optimum(measured, mirrored):
    """Nor does a lost one; the first to reach an optimum runs to its end there."""
    lost = jnp.full_like(measured.starts[0], jnp.nan)
    starts = jnp.stack([measured.starts[2], lost, measured.starts[0]])
    again = multi_start(measured.problem, starts)
    for ours, theirs in ((0, 2), (2, 0)):
        np.testing.assert_allclose(again.z[ours], mirrored.z[theirs], atol=1e-7)
    assert again.converged.tolist() == [True, False, True]
    assert again.cost[1] == np.inf
    assert again.steps[1] == 1
    assert again.best in (0, 2)
    assert all(1 not in optimum.starts for optimum in again.optima)
    assert says(again, "1 without equilibrium")


def test_a_search_does_not_depend_on_the_number_of_cores(measured, mirrored):
    """In the thread of the caller, with all cores for each solve; images included."""
    with Workers(measured.beam.model, 2, 1) as workers:
        alone = search(
            Evaluator(measured.problem, workers),
            FROM_ANYWHERE,
            measured.starts,
            mirror=True,
            journal=Journal(measured.problem, FROM_ANYWHERE),
        )
    np.testing.assert_array_equal(alone.steps, mirrored.steps)
    np.testing.assert_allclose(alone.z, mirrored.z, rtol=0, atol=1e-8)
    np.testing.assert_allclose(alone.errors, mirrored.errors, rtol=1e-5, atol=1e-6)


def test_runs_that_have_ended_cost_nothing_more(measured, monkeypatch):
    """However unlike their lengths; the first alone, and the others less than that."""
    counted, real = [], Evaluator.__call__

    def count(evaluate, *args):
        counted.append(evaluate)
        return real(evaluate, *args)

    monkeypatch.setattr(Evaluator, "__call__", count)
    result = multi_start(measured.problem, measured.starts, mirror=False)
    together = len(counted)
    alone = [
        multi_start(measured.problem, start[None], mirror=False).steps[0]
        for start in measured.starts
    ]
    assert result.steps[0] == alone[0]
    assert result.steps[1] < alone[1]  # it leads to the end of the first
    assert result.steps[2] == alone[2]  # to another one
    # One for each start and step, but for the last of a run, which only confirms.
    assert together <= len(result.steps) + result.steps.sum()


def test_a_search_ends_once_enough_starts_agree(measured):
    """Five of eight: w (w + 1) / (n (n - 1)) is 0.1 for 5 starts at 1 optimum."""
    starts = jnp.repeat(measured.starts[:1], 8, axis=0)
    few, every = (
        multi_start(measured.problem, starts, enough=enough) for enough in (0.1, 0.0)
    )
    assert len(few.cost) == len(few.starts) == 5
    assert few.missed == pytest.approx(0.1)
    assert says(few, "5 starts", "further starts, 10 %")
    assert "further" not in str(multi_start(measured.problem, starts[:1]))
    assert len(every.cost) == 8
    assert every.missed == pytest.approx(2 / 56)
    (best,) = [optimum for optimum in every.optima if optimum.starts]
    assert best.starts == tuple(range(8))


def test_share_of_starts_that_lead_elsewhere():
    """Two optima of four starts; one that has not converged is a third."""
    assert ends([10.0], [1.0]).missed == 1.0
    four = [10.0, 20.0, 10.0, 10.0], [1.0, 2.0, 1.0, 1.0]
    assert ends(*four).missed == pytest.approx(2 * 3 / (4 * 3))
    assert ends(*four, [True, True, True, False]).missed == 1.0
    lost = ends([10.0] * 4, [1.0, 1.0, 1.0, np.inf], [True, True, True, False])
    assert lost.missed == pytest.approx(1 * 2 / (3 * 2))


def test_which_runs_lead_to_a_known_optimum(measured, plain):
    """Near it one does; far from it, below it, or at another one it does not."""
    space = measured.beam.space
    best = Basin(plain.z[0], float(plain.cost[0]))
    other = Basin(plain.z[2], float(plain.cost[2]))

    def at(z):
        now = evaluate(measured.problem, jnp.asarray(z))
        return initial_state(FROM_ANYWHERE, now)

    near = best.z + 1e-3 * np.array([1.0, -1.0, 1.0, 1.0, -1.0, 1.0])
    assert leads_to(space, at(near), best)
    assert not leads_to(space, at(near), other)
    assert not leads_to(space, at(measured.starts[2]), best)
    assert not leads_to(space, at(other.z), other)
    # One that is lower than the model finds anywhere, or higher than it foretells.
    for cost in (0.5 * float(at(near).evaluation.cost), -1.0):
        assert not leads_to(space, at(near), best._replace(cost=cost))


def test_an_axis_at_zero_is_its_own_mirror_image(measured):
    """Its start is run once, and not again for each of its images."""
    beam, tried = measured.beam, []
    noisy = synthetic_measurements(
        beam.model, beam.space, beam.configurations, beam.target, noise=True
    )
    problem = build_problem(beam.model, beam.space, noisy)
    for theta in (0.0, 0.3):
        images = set()
        with Workers(beam.model, 2) as workers:
            run_start(
                Evaluator(problem, workers),
                FROM_ANYWHERE,
                measured.starts[0].at[THETA].set(theta),
                images=images_of(beam.space, True),
                note_step=lambda image, _, images=images: images.add(image),
            )
        tried.append(images)
    assert tried[0] >= {0, 1, 5}
    assert tried[0].isdisjoint({2, 3, 4})
    assert tried[1] >= {0, 1, 2, 3, 4, 5}


def test_other_starts_and_data_are_the_same_program(measured, mirrored):
    """Any number of starts, any data, any names of the control points."""
    renamed = with_other_points(measured.beam.space, ["left", "right"])
    names = dict(zip(measured.beam.space.names, renamed.names, strict=True))
    target = {names[name]: 0.9 * v for name, v in measured.beam.target.items()}
    data = synthetic_measurements(
        measured.beam.model, renamed, measured.beam.configurations, target
    )
    problem = build_problem(measured.beam.model, renamed, data)
    with Compilations() as seen:
        result = multi_start(problem, 2, seed=3)
    assert seen.programs == []
    assert result.names == tuple(renamed.names)
    assert "E_t of left" in result.optima[0].values


def with_other_points(space, names):
    """The same control points by other names."""
    points = space.entries[0].control_points
    other = ControlPoints(points.positions, names=names)
    entries = [
        eqx.tree_at(lambda e: e.control_points, entry, other) for entry in space.entries
    ]
    return ParameterSpace(entries, order=space.order, axes=space.axes)


def test_without_any_equilibrium_it_is_an_error(measured):
    lost = jnp.full_like(measured.starts, jnp.nan)
    with pytest.raises(RuntimeError, match="none of 3 starts"):
        multi_start(measured.problem, lost)


def test_images_of_the_end_and_of_the_start(measured):
    problem, space = measured.problem, measured.beam.space
    images = images_of(space, True)
    both, none, one, other = [-1, -1], [1, 1], [-1, 1], [1, -1]
    signs = np.array([image.signs for image in images])
    np.testing.assert_array_equal(
        signs[:, THETA], [none, both, both, one, other, none, none, none]
    )
    # Moduli are kept, but for the axes of the end with the moduli of the space.
    kept = np.delete(signs, [4, 5], axis=1)
    np.testing.assert_array_equal(kept, [[1.0] * 4] * 5 + [[0.0] * 4] + [[1.0] * 4] * 2)
    middle = np.asarray(space.start())
    start, end = middle - 0.1, middle + 0.1
    errors = not_begun(FROM_ANYWHERE, jnp.asarray(end), 1).best.errors
    run = lambda cost, converged: Run(
        z=end, cost=cost, steps=3, converged=converged, errors=errors
    )
    of_start = [False, False, True, True, True, False, False, False]
    for row, from_start in enumerate(of_start):
        image = images[row]
        begin = image.origin(run(1.0, True), start)
        wished = signs[row] * (start if from_start else end)
        if row == 5:
            wished = np.concatenate([middle[:4], end[4:]])
        np.testing.assert_array_equal(begin, wished)
        # With an error left, converged or not; unfinished runs are finished.
        elsewhere = 1 <= row <= 5
        assert wanted(problem, run(1.0, True), image) == elsewhere
        assert wanted(problem, run(1.0, False), image)
        assert not wanted(problem, run(0.0, True), image)


def test_which_of_two_ends_counts():
    """The lower one, converged or not; at the same place the converged one."""

    def end(cost, converged):
        return Run(
            z=np.full(1, cost),
            cost=cost,
            steps=3,
            converged=converged,
            errors=np.full(2, cost),
        )

    done, almost = end(2.0, True), end(2.0 - 1e-9, False)
    for first, second in ((done, almost), (almost, done)):
        chosen = better(first, second)
        assert chosen.converged
        assert chosen.cost == 2.0
        assert chosen.steps == 6
        np.testing.assert_array_equal(chosen.errors, first.errors)
    # It shows that the other is not the best optimum, and is continued.
    lower = end(1.0, False)
    for first, second in ((done, lower), (lower, done)):
        assert better(first, second).cost == 1.0
    nothing = not_begun(FROM_ANYWHERE, jnp.zeros(1), 1).best
    assert better(nothing, done).cost == 2.0


def test_mirror_images_find_the_better_optimum(measured, plain, mirrored):
    """The last start ends beside the target, unless it goes on from its reflection."""
    assert plain.converged[2]
    assert plain.cost[2] > 1e-3
    assert np.max(np.abs(plain.values[2] / target(measured) - 1.0)) > 0.1
    assert mirrored.converged.all()
    # The other one was passed on the way, and is kept as the second-best.
    best, *others = mirrored.optima
    assert best.starts == (0, 1, 2)
    assert others[0] is mirrored.second_best
    assert {o.starts for o in others} == {()}
    passed = [o.cost for o in others]
    assert passed == sorted(passed)
    assert np.isclose(passed, plain.cost[2], rtol=1e-6).any()
    np.testing.assert_allclose(mirrored.values[2], target(measured), rtol=1e-5)
    # The steps of all images, the errors of the first run.
    assert mirrored.steps[2] > plain.steps[2]
    np.testing.assert_array_equal(mirrored.errors[2], plain.errors[2])
    # Where nothing is left to explain no other optimum is looked for.
    np.testing.assert_array_equal(mirrored.steps[:1], plain.steps[:1])


def test_calibrate_goes_on_from_the_best_of_several_starts(measured, monkeypatch):
    """The user's start is the one that ends wrong; several are the default."""
    monkeypatch.setattr("softcal_jax.fields._start.SEVERAL", 3)
    beam, space = measured.beam, measured.beam.space
    p = space.from_scaled(measured.starts[2])
    wrong = [p[E_T], p[E_L], p[THETA]]
    space = eqx.tree_at(lambda s: [e.start for e in s.entries], space, wrong)
    fit = partial(
        calibrate, beam.model, space, measured.data, uncertain=exactly_known()
    )
    alone = fit(starts=1, intervals=None)
    assert alone.starts is None
    assert alone.history[-1].cost > 1e-3
    result = fit(seed=5)
    assert result.converged
    # Data of the model itself show no noise, so that first order cannot be wrong.
    assert {i.kind for i in result.intervals} == {"first-order"}
    values = [result.value(name) for name in space.names]
    np.testing.assert_allclose(values, target(measured), rtol=1e-5)
    # Its own start and two random ones.
    expected = jnp.stack([space.start(), *random_starts(space, 2, seed=5)])
    np.testing.assert_allclose(
        result.starts.starts, jax.vmap(space.from_scaled)(expected), rtol=1e-12
    )
    # The history is that of the fit, which begins where the search ended.
    assert result.history[0].cost < 1e-6 * alone.history[0].cost
    assert [entry.step for entry in result.history] == list(range(len(result.history)))
    assert len(result.history) <= 4
    assert result.parameters[0].start == pytest.approx(float(p[0]))


def test_several_starts_where_there_may_be_several_optima():
    """With an axis, or a field at more than one point; not for motors and zeros."""
    points = ControlPoints(np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0]]))
    E = Parameter("E", "E", 1e5, 1e4, 1e6, unit="Pa")
    theta = Parameter("theta", "theta", 0.0, -1.0, 1.0, scale="linear", unit="rad")
    zero = motor_zero("motor", limit=0.1, prior_std=None)
    assert default_starts(ParameterSpace([E, zero])) == 1
    assert default_starts(ParameterSpace([E, theta])) == 6
    spread = ControlPointParameters("E", points, 1e5, 1e4, 1e6)
    assert default_starts(ParameterSpace([spread])) == 6
    assert default_starts(SPACE) == 6


def test_only_a_few_optima_are_listed():
    result = ends(list(range(10, 80, 10)), list(range(7)))
    text = str(result)
    assert text.count("theta of CP 1") == 5
    assert says(text, "7 distinct optima")
    assert result.second_best is result.optima[1]
    assert ends([10.0], [1.0]).second_best is None


def test_calibrate_needs_a_start(measured):
    with pytest.raises(ValueError, match=r"starts.*got 0"):
        calibrate(measured.beam.model, measured.beam.space, measured.data, starts=0)


@pytest.mark.parametrize("shape", [(0, 6), (3, 5), (6,)])
def test_starts_that_do_not_fit_the_parameters(measured, shape, unchecked):
    message = r"starts .* shape \(number, 6\).*got \("
    with pytest.raises(ValueError, match=message):
        multi_start(measured.problem, jnp.zeros(shape))


# What is made of the ends of runs, on ends made by hand.
SPACE = anisotropic_beam(cells=(1, 1, 1), order=1).space


def ends(thetas, costs, converged=None):
    """Runs that differ in the angle of CP 1 only."""
    p = np.tile([8e5, 7e5, 3e5, 2e5, 0.0, 0.4], (len(thetas), 1))
    p[:, 4] = np.deg2rad(thetas)
    z = np.array([SPACE.to_scaled(jnp.asarray(row)) for row in p])
    flags = np.ones(len(thetas), bool) if converged is None else np.array(converged)
    cost, good = np.array(costs, float), np.flatnonzero(flags).tolist()
    return MultiStartResult(
        names=tuple(SPACE.names),
        starts=p,
        values=p,
        z=z,
        cost=cost,
        steps=np.full(len(thetas), 7),
        converged=flags,
        errors=np.zeros((len(thetas), 13)),
        optima=_optima(SPACE, [(cost[i], z[i], i) for i in good]),
    )


def test_optima_on_both_sides_of_the_seam_are_one():
    """An axis at 89.99 degrees is at -89.99 degrees, almost; 88 is another."""
    optima = ends([89.99, -89.99, 88.0], [2.0, 1.0, 3.0]).optima
    assert [optimum.starts for optimum in optima] == [(0, 1), (2,)]
    # The lower of the two stands for both.
    assert optima[0].cost == 1.0
    assert optima[0].values["theta of CP 1"] == pytest.approx(np.deg2rad(-89.99))
    assert optima[0].values["E_t of CP 2"] == pytest.approx(7e5)


def test_optima_come_with_the_lowest_cost_first():
    optima = ends([10.0, 20.0, 10.01, 20.0], [5.0, 2.0, 4.0, np.inf]).optima
    assert [(o.cost, o.starts) for o in optima] == [(2.0, (1, 3)), (4.0, (0, 2))]
    assert isinstance(optima[0], Optimum)


def test_unfinished_runs_are_no_optima_and_not_the_best():
    """However low they are; unless there is nothing else."""
    result = ends([10.0, 20.0, 30.0], [5.0, 0.1, np.inf], [True, False, False])
    assert [optimum.starts for optimum in result.optima] == [(0,)]
    assert result.best == 0
    none = ends([10.0, 20.0], [5.0, 0.1], [False, False])
    assert none.optima == ()
    assert none.best == 1


def test_report_lists_optima_unfinished_and_lost_runs():
    result = ends(
        [10.0, 20.0, 10.0, 40.0, 50.0, 60.0],
        [5.0, 2.0, 5.0, 3.25, 4.0, np.inf],
        [True, True, True, False, False, False],
    )
    values = "E_t of CP 1 8e+05, E_t of CP 2 7e+05, E_l of CP 1 3e+05, E_l of CP 2 2e"
    whole, *_, best, worse = str(result).splitlines()
    assert says(whole, "6 starts", "3 converged", "2 distinct")
    assert says(whole, "2 not converged", "3.25", "1 without equilibrium")
    assert says(best, "2 ... 1", f"{values}+05, theta of CP 1 0.3491")
    assert says(worse, "5 ... 2", f"{values}+05, theta of CP 1 0.1745")


@pytest.mark.parametrize("tensor_steps", [True, False])
def test_random_starts_fill_the_bounds_in_order(tensor_steps):
    """Uniform in SI units: means of the two sorted moduli at 1/3 and 2/3."""
    space = anisotropic_beam(
        cells=(1, 1, 1), order=1, tensor_steps=tensor_steps, interpolation="director"
    ).space
    z = np.asarray(random_starts(space, 2000, seed=3))
    assert np.all(z >= np.asarray(space.lower())[None] - 1e-12)
    assert np.all(z <= np.asarray(space.upper())[None] + 1e-12)
    assert np.all(z[:, E_L] <= z[:, E_T])
    p = np.asarray(jax.vmap(space.from_scaled)(jnp.asarray(z)))
    low, high = (
        np.asarray(space.from_scaled(z)) for z in (space.lower(), space.upper())
    )
    share = (p - low) / (high - low)
    expected = [2.0 / 3.0] * 2 + [1.0 / 3.0] * 2 + [0.5] * 2
    # Standard deviations of at most 0.29, over 2000 draws: five standard errors.
    np.testing.assert_allclose(share.mean(axis=0), expected, rtol=0, atol=0.033)
    assert np.all(share.min(axis=0) < [0.1] * 2 + [0.01] * 4)
    assert np.all(share.max(axis=0) > [0.99] * 2 + [0.9] * 2 + [0.99] * 2)
    # No two parameters move together, but for the sorted pairs.
    correlation = np.corrcoef(share.T) - np.eye(6)
    for i in range(2):
        correlation[i, i + 2] = correlation[i + 2, i] = 0.0
    assert np.max(np.abs(correlation)) < 5.0 / np.sqrt(2000)


def test_random_starts_are_those_of_their_seed():
    first, again, other = (random_starts(SPACE, 4, seed=s) for s in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert np.all(np.abs(first - other) > 1e-6)


def test_chain_of_orders_and_bounds_of_their_own():
    """a <= b <= c, where b has less room than the others."""
    bounds = {"c": (1.0, 9.0), "a": (1.0, 9.0), "b": (3.0, 5.0)}
    space = ParameterSpace(
        tuple(
            Parameter(name, name, 4.0, low, high, scale="linear", S=1.0)
            for name, (low, high) in bounds.items()
        ),
        order=(("a", "b"), ("b", "c")),
    )
    z = np.asarray(random_starts(space, 200))
    assert np.all(z[:, 1] <= z[:, 2])
    assert np.all(z[:, 2] <= z[:, 0])
    assert np.all(z >= np.asarray(space.lower())[None])
    assert np.all(z <= np.asarray(space.upper())[None])


@pytest.mark.parametrize("n", [0, -3])
def test_random_starts_are_at_least_one(n):
    with pytest.raises(ValueError, match=f"at least 1, got {n}"):
        random_starts(SPACE, n)
