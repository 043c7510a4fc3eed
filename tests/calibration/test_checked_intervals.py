"""Intervals that a calibration prints: of first order where that holds, or profiles."""

from dataclasses import replace
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest
from light_beam import MODEL, STD, measured, relative_error, unknowns
from scipy.optimize import brentq
from scipy.stats import norm
from watching import only
from wording import says

from softcal_jax.calibration import (
    CalibrationResult,
    Evaluation,
    Evaluator,
    LowerCostFound,
    MultiStartResult,
    Optimum,
    ParameterEstimate,
    ParameterInterval,
    build_problem,
    calibrate,
)
from softcal_jax.calibration._checked_intervals import (
    CURVED,
    MOST_RETURNS,
    Fitted,
    ProfileEnd,
    _by_profile,
    _considered_error,
    _end_holds,
    _none,
    interval_between,
    with_intervals,
)
from softcal_jax.fields import Parameter, ParameterSpace, exactly_known
from softcal_jax.inference import ErrorColumns, Whitened, independent

EXACTLY = {"noise": "stated", "uncertain": exactly_known()}
CLOSE = 3e-3
"""An end is off by 0.5 % of its distance, which is about half of the value [-]."""


@pytest.fixture(scope="module")
def poses():
    return measured()


@pytest.fixture(scope="module")
def result(poses):
    return calibrate(MODEL, unknowns(), poses, **EXACTLY)


def cost_along(result):
    """Twice the least cost for each E: the tip sinks by density / E, and is pushed."""
    E, rho = result.value("E"), result.value("density")
    points = [fit.points[0] for fit in result.configurations]
    sunk, both = (p.simulated - p.at_rest for p in points)
    seen = np.ravel([p.measured - p.at_rest for p in points])

    def cost(other):
        push = np.append(0.0 * sunk, (both - sunk) * E / other)
        weight = np.append(sunk, sunk) * E / (rho * other)
        density = weight @ (seen - push) / (weight @ weight)
        return np.sum((push + density * weight - seen) ** 2) / STD**2

    return cost


def test_where_first_order_is_wrong_the_profile_is_printed(result):
    """Its ends are those of a scan of the same cost; those of +- are far off."""
    interval = result.parameters[0].interval
    assert interval.kind == "profile"
    cost, E = cost_along(result), result.value("E")
    higher = lambda other: cost(other) - cost(E) - norm.ppf(0.975) ** 2
    ends = [brentq(higher, 0.2 * E, E), brentq(higher, E, 5.0 * E)]
    np.testing.assert_allclose([interval.lower, interval.upper], ends, rtol=CLOSE)
    reach = 1.96 * result.parameters[0].standard_error
    assert np.max(np.abs(np.array([E - reach, E + reach]) - ends)) > 0.1 * E
    assert "±" not in str(result.parameters[0])
    assert str(interval) in str(result)
    assert "±" not in str(result).split("\n")[0]


@pytest.mark.parametrize(
    ("error", "ends", "text"),
    [
        (1e4, (0.82, 1.22), "100 ± 10 kPa"),
        (1e4, None, "100 ± 10 kPa"),
        (np.nan, None, "100 kPa"),
        # Symmetric in the logarithm: a value +- 36 % would leave out what it holds.
        (3.6e4, (0.5, 2.0), "100 kPa (50 to 200 kPa)"),
    ],
)
def test_an_error_is_printed_where_it_holds(error, ends, text):
    interval = None
    if ends is not None:
        low, high = (1e5 * end for end in ends)
        both = {"lower_end": "likelihood", "upper_end": "likelihood"}
        common = {"name": "E", "unit": "Pa", "level": 0.95, "kind": "first-order"}
        interval = ParameterInterval(lower=low, upper=high, **common, **both)
    estimate = ParameterEstimate(
        name="E",
        value=1e5,
        standard_error=error,
        start=1e5,
        lower=1e4,
        upper=1e6,
        unit="Pa",
        at_bound=False,
        interval=interval,
    )
    assert str(estimate) == text
    given = replace(estimate, given=("nu",))
    assert says(given, text, "nu on a bound")


def test_where_it_is_right_it_stays(monkeypatch):
    """At a hundredth of the noise; two evaluations for each parameter."""
    counted, real = [], Evaluator.__call__

    def count(evaluate, *args):
        counted.append(evaluate)
        return real(evaluate, *args)

    monkeypatch.setattr(Evaluator, "__call__", count)
    precise = measured(noise=5e-3, std=1e-2 * STD)
    calibrate(MODEL, unknowns(), precise, intervals=None, **EXACTLY)
    alone = len(counted)
    result = calibrate(MODEL, unknowns(), precise, **EXACTLY)
    assert len(counted) == 2 * alone + 2 * 2
    interval = result.parameters[0].interval
    assert [i.kind for i in result.intervals] == ["first-order"] * 2
    s = 1e-2 * relative_error(result)
    ends = result.value("E") * np.exp(1.959964 * s * np.array([-1.0, 1.0]))
    np.testing.assert_allclose([interval.lower, interval.upper], ends, rtol=1e-5)
    assert "±" in str(result.parameters[0])


def test_at_a_bound_one_side_is_known(poses):
    """The lower limit, where the cost has risen above that at the bound."""
    result = calibrate(MODEL, unknowns(upper=300e3), poses, **EXACTLY)
    E = result.parameters[0]
    assert E.at_bound
    assert E.interval.kind == "one-sided"
    assert (E.interval.lower_end, E.interval.upper_end) == ("likelihood", "bound")
    cost = cost_along(result)
    higher = lambda other: cost(other) - cost(300e3) - norm.ppf(0.975) ** 2
    np.testing.assert_allclose(
        [E.interval.lower, E.interval.upper],
        [brentq(higher, 60e3, 300e3), 300e3],
        rtol=CLOSE,
    )


def within(factor):
    """Bounds that far on either side of values close to those of the fit."""
    sides = {"E": 400e3, "density": 1.0}
    return [
        replace(q, lower=jnp.asarray(v / factor), upper=jnp.asarray(v * factor))
        for q, v in zip(unknowns(), sides.values(), strict=True)
    ]


def test_what_the_linear_model_leaves_open_is_checked_at_its_bounds(monkeypatch):
    """Not by a profile; no fit there goes on once the bound is known to be allowed."""
    counted, real = [], Evaluator.__call__

    def count(evaluate, *args):
        counted.append(evaluate)
        return real(evaluate, *args)

    monkeypatch.setattr(Evaluator, "__call__", count)
    rough = measured(std=30.0 * STD)
    calibrate(MODEL, within(1.8), rough, intervals=None, **EXACTLY)
    alone, said = len(counted), []
    result = calibrate(
        MODEL, within(1.8), rough, watch=only(str, said.append), **EXACTLY
    )
    assert all("exclude no value" in str(i) for i in result.intervals)
    assert says(said, "allow the bounds of", "E")
    assert not any("profile" in text for text in said)
    assert len(counted) - 2 * alone <= 4  # the first point of each fit tells


def profiled(result, poses, monkeypatch, linear, ends):
    """Intervals of both parameters, and which were asked for, with given `ends`."""
    asked = []

    def profile_ends(self, level, which, only_bounds=False, ended=None):
        for column in which:
            asked.append((column, only_bounds))
            if ended is not None:
                ended(column, ends[column])
        return [ends[column] for column in which]

    monkeypatch.setattr(Fitted, "profile_ends", profile_ends)
    fitted = of_problem(result, poses)
    intervals = _none(fitted, 0.95, "-")
    _by_profile(fitted, 0.95, [0, 1], linear, intervals, lambda _: None)
    return intervals, asked


def ends_at(distance, why="likelihood"):
    return (ProfileEnd(distance, why),) * 2


@pytest.mark.parametrize(("off", "agrees"), [(0.9, True), (1.1, False)])
def test_no_more_profiles_are_made_once_they_agree(
    result, poses, monkeypatch, off, agrees
):
    monkeypatch.setattr("softcal_jax.calibration._checked_intervals.PAIR", 1)
    linear = {0: ends_at(0.1), 1: ends_at(0.2)}
    found = {0: ends_at(0.1 * (1.0 + off * CURVED)), 1: ends_at(0.3)}
    intervals, asked = profiled(result, poses, monkeypatch, linear, found)
    assert asked == ([(0, False)] if agrees else [(0, False), (1, False)])
    assert intervals[0].kind == "profile"
    assert intervals[1].kind == ("first-order" if agrees else "profile")
    distance = 0.2 if agrees else 0.3
    expected = result.value("density") * np.exp(distance)
    np.testing.assert_allclose(intervals[1].upper, expected, rtol=1e-6)


def test_a_bound_that_is_allowed_is_named(result, poses, monkeypatch):
    rooms = room_of(result, 0), room_of(result, 1)
    linear = {c: tuple(ProfileEnd(r, "bound") for r in rooms[c]) for c in (0, 1)}
    low, high = rooms[0]
    excluded = (ProfileEnd(low, "likelihood"), ProfileEnd(high, "bound"))
    found = {0: excluded, 1: linear[1]}
    intervals, asked = profiled(result, poses, monkeypatch, linear, found)
    assert asked == [(0, True), (1, True)]
    assert [i.kind for i in intervals] == ["none", "none"]
    assert says(intervals[0], "hardly determine", "allow 100 MPa")
    assert says(intervals[1], "exclude no value")
    # Where the data exclude both, they know more than the linear model says.
    found = {0: tuple(ProfileEnd(r, "likelihood") for r in rooms[0]), 1: linear[1]}
    intervals, asked = profiled(result, poses, monkeypatch, linear, found)
    assert asked == [(0, True), (1, True), (0, False)]


def test_no_fit_is_made_where_other_errors_reach_both_bounds(
    result, poses, monkeypatch
):
    """Of E alone; the noise adds to these in quadrature."""
    W_c = result.linear.W @ np.array([[20.0], [0.0]])
    considered = ErrorColumns(W_c, ("loads",), ("load",))
    unsure = replace(result, linear=replace(result.linear, considered=considered))
    linear = {0: ends_at(0.1), 1: ends_at(0.2)}
    intervals, asked = profiled(unsure, poses, monkeypatch, linear, linear)
    assert asked == [(1, False)]
    assert says(intervals[0], "exclude no value")
    assert intervals[1].kind == "profile"


def room_of(result, column):
    down, up = result.space.room(result.z)
    return -float(down[column]), float(up[column])


def bare(kind, **values):
    """An object of a kind with a few of its attributes alone."""
    instance = object.__new__(kind)
    for name, value in values.items():
        object.__setattr__(instance, name, value)
    return instance


SPACE = ParameterSpace(
    [Parameter(n, n, 0.0, -50.0, 50.0, scale="linear", S=1.0) for n in "xy"]
)


@pytest.mark.parametrize("on_bound", [False, True])
def test_what_is_held_fixed_widens_on_a_bound_too(on_bound):
    """An error of the data W_c moves least squares by pinv(W) W_c, bound or not."""
    random = np.random.default_rng(0)
    W, W_c = random.standard_normal((6, 2)), random.standard_normal((6, 3))
    linear = replace(
        independent(W, ("x", "y")),
        considered=ErrorColumns(W_c, ("loads",) * 3, ("a", "b", "c")),
        held=np.array([on_bound, False]),
    )
    result = bare(CalibrationResult, linear=linear)
    expected = np.linalg.norm(np.linalg.pinv(W)[0] @ W_c)
    np.testing.assert_allclose(_considered_error(result, 0), expected, rtol=1e-12)


def holds(errors, jacobian, *, column=0, W=None, on_bound=False, space=SPACE):
    """Whether two standard errors of a column hold for errors that are known."""
    W = jacobian(0.0, 0.0) if W is None else W

    held = np.array([False, on_bound])  # the second one is held there

    def rows(z):
        return np.asarray(errors(*z), float), np.asarray(jacobian(*z), float)

    def at(z):
        return bare(
            Evaluation,
            response=SimpleNamespace(equilibrium=SimpleNamespace(displacement=None)),
            rows=Whitened(*map(jnp.asarray, rows(z))),
            ok=jnp.asarray(True),
        )

    def about(z, _):
        r, jacobian_there = rows(np.asarray(z))
        model = independent(jacobian_there, ("x", "y"), r=r)
        return replace(model, held=held)

    here = about(np.zeros(2), None)
    return _end_holds(
        column,
        1,
        evaluate=lambda z, _: at(np.asarray(z)),
        about=about,
        space=space,
        z=np.zeros(2),
        evaluation=at(np.zeros(2)),
        linear=replace(here, W=np.array(W, float)),
        quantile=2.0,
    )


def test_a_parabola_holds():
    W = [[1.0, 0.4], [0.2, 2.0]]
    linear = lambda x, y: np.array(W) @ [x, y]
    assert holds(linear, lambda x, y: W)
    assert holds(linear, lambda x, y: W, column=1)


def test_a_valley_that_bends_does_not_hold():
    """x is known to 1, but the best y goes with its square."""
    assert not holds(
        lambda x, y: [x, 5.0 * (y - x**2)],
        lambda x, y: [[1.0, 0.0], [-10.0 * x, 5.0]],
    )


def test_a_floor_that_falls_off_does_not_hold():
    """Straight ahead the cost is as it should be; beside that it is much lower."""
    assert not holds(
        lambda x, y: [x * (1.0 - y), 0.5 * y],
        lambda x, y: [[1.0 - y, -x], [0.0, 0.5]],
    )


@pytest.mark.parametrize(("slope", "good"), [(0.0, True), (0.8, False)])
def test_a_standard_error_may_not_rest_on_a_bound(slope, good):
    """As x rises y would leave its bound, and the cost be lower than it looks."""
    x, y = SPACE.parameters
    space = ParameterSpace([x, replace(y, lower=jnp.asarray(0.0))])
    J = [[1.0, -slope], [0.0, 0.6]]
    verdict = holds(
        lambda x, y: np.array(J) @ [x, y] + [0.0, 0.1],
        lambda x, y: J,
        on_bound=True,
        space=space,
    )
    assert verdict == good


def test_a_lower_cost_is_told():
    with pytest.raises(LowerCostFound, match=r"falls from 2 to 0\.5"):
        holds(
            lambda x, y: [x - 2.0 + x * (x - 1.0) * 0.5, y],
            lambda x, y: [[1.0 if x else 0.5, 0.0], [0.0, 1.0]],
            W=[[2.0, 0.0], [0.0, 1.0]],
        )


def of_problem(result, poses):
    problem = build_problem(result.model, result.space, poses, result.newton)
    return Fitted(result, problem, None)


def never(*_):
    raise AssertionError("nothing is to be computed")


@pytest.mark.parametrize(
    ("changed", "why"),
    [
        ({"converged": False}, "did not converge"),
        ({"noise_scale": np.nan}, "too few data"),
    ],
)
def test_there_is_none_without_a_fit_or_noise(result, poses, changed, why):
    spread = replace(result.uncertainty, noise_scale=changed.get("noise_scale", 1.0))
    converged = changed.get("converged", True)
    fit = replace(result, converged=converged, uncertainty=spread)
    completed = with_intervals(of_problem(fit, poses), 0.95, never, never)
    assert {interval.kind for interval in completed.intervals} == {"none"}
    assert all(why in str(interval) for interval in completed.intervals)


@pytest.mark.parametrize("times", [1, MOST_RETURNS])
def test_a_lower_cost_is_gone_on_from(result, poses, monkeypatch, times):
    """A few times, and it is said; the first end stays as another optimum."""
    intervals = _none(of_problem(result, poses), 0.95, "-")
    lower = iter(range(times))

    def falls(*_):
        if next(lower, None) is not None:
            raise LowerCostFound(result.z, 1.0, 2.0)
        return intervals

    monkeypatch.setattr("softcal_jax.calibration._checked_intervals._intervals", falls)
    last, none = result.history[-1], np.zeros((0, 2))
    starts = MultiStartResult(
        names=tuple(result.space.names),
        starts=none,
        values=none,
        z=none,
        cost=none[:, 0],
        steps=none[:, 0].astype(int),
        converged=none[:, 0].astype(bool),
        errors=none,
        optima=(Optimum(last.cost, last.values, (0,)),),
    )
    # Nothing but the cost of an evaluation is asked for, in the same units.
    path = "softcal_jax.calibration._checked_intervals.weighed"
    monkeypatch.setattr(
        path, lambda problem, z, response: SimpleNamespace(cost=response)
    )
    at = lambda cost: SimpleNamespace(cost=cost, response=cost)
    fitted = of_problem(replace(result, starts=starts), poses)
    fitted = fitted._replace(evaluation=at(last.cost))

    def go_on(done, z):
        cost = 0.9 * done.result.history[-1].cost
        lower = replace(done.result.history[-1], cost=cost)
        return done._replace(
            result=replace(done.result, history=(lower,)),
            evaluation=at(cost),
        )

    after = with_intervals(fitted, 0.95, go_on, never)
    assert says(after.notes[-1], "lower cost", "first fit")
    costs = [optimum.cost / last.cost for optimum in after.starts.optima]
    np.testing.assert_allclose(costs, 0.9 ** np.arange(times, -1.0, -1.0))
    still = "cost still decreases" in after.intervals[0].why
    assert still == (times == MOST_RETURNS)
    # Where the way on leads nowhere, the first fit is kept.
    lower = iter(range(1))
    kept = with_intervals(fitted, 0.95, lambda done, z: done, never)
    assert kept.starts is starts
    assert "cost still decreases" in kept.intervals[0].why


def test_kinds_and_reasons():
    E = Parameter("E", "E", 2e5, 1e5, 4e5, unit="Pa")
    z = float(E.to_scaled(jnp.asarray(2e5)))
    far, bound = ProfileEnd(0.1, "likelihood"), ProfileEnd(np.log(2.0), "bound")
    lost = ProfileEnd(np.nan, "not found")
    kind = lambda *ends: interval_between(E, z, ends, level=0.95)
    assert kind(far, far).kind == "profile"
    assert interval_between(E, z, (far, far), level=0.9, kind="first-order").kind == (
        "first-order"
    )
    assert str(kind(far, bound)) == "181 to 400 (bound) kPa"
    assert kind(far, bound).kind == "one-sided"
    assert says(kind(bound, bound), "exclude no value", "bounds")
    assert says(kind(lost, far), "not converge", "above", "221 kPa")
    assert kind(lost, far).kind == "none"
