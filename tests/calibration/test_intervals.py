"""Intervals by profile likelihood: closed forms, bounds, lower costs, bad input."""

import pickle
from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from light_beam import MODEL, STD, measured, relative_error, unknowns
from scipy.stats import t

from softcal_jax.calibration import (
    LowerCostFound,
    ParameterInterval,
    build_problem,
    calibrate as calibrate_with,
    profile_ends,
    profile_intervals,
)
from softcal_jax.calibration._profile import NotFound, _end, bracket, root
from softcal_jax.calibration._runs import minimise
from softcal_jax.fields import ParameterSpace, Pin, exactly_known
from softcal_jax.inference import ErrorColumns
from softcal_jax.robots import anisotropic_beam, synthetic_measurements

calibrate = partial(calibrate_with, uncertain=exactly_known(), intervals=None)

CLOSE = 3e-3
"""An end is off by 0.5 % of its distance, which is about half of the value [-]."""


@pytest.fixture(scope="module")
def poses():
    return measured()


@pytest.fixture(scope="module")
def result(poses):
    return calibrate(MODEL, unknowns(), poses, noise="stated")


def test_of_a_compliance_it_is_symmetric_in_its_inverse(result):
    """1 / E_end = (1 +- 1.96 s) / E, where s knows nothing of the density."""
    (interval,) = profile_intervals(result, parameters="E")
    s = relative_error(result)
    assert 0.1 < s < 0.4  # far from where a first-order interval would hold
    expected = result.value("E") / (1.0 + np.array([1.0, -1.0]) * 1.959964 * s)
    np.testing.assert_allclose([interval.lower, interval.upper], expected, rtol=CLOSE)
    assert (interval.lower_end, interval.upper_end) == ("likelihood", "likelihood")
    assert (interval.name, interval.level, interval.unit) == ("E", 0.95, "Pa")


def test_level_widens_it(result):
    (interval,) = profile_intervals(result, parameters=["E"], level=0.6826895)
    s = relative_error(result)
    expected = result.value("E") / (1.0 + np.array([1.0, -1.0]) * s)
    np.testing.assert_allclose([interval.lower, interval.upper], expected, rtol=CLOSE)


def test_what_is_held_fixed_widens_it(result):
    """In squares on either side; ln E is off by 0.3, or by more than it has room."""
    (plain,) = profile_intervals(result, parameters="E")
    fitted = np.log(result.value("E"))
    low, high = (abs(np.log(end) - fitted) for end in (plain.lower, plain.upper))

    def with_error(size):
        W_c = result.linear.W @ np.array([[size], [0.0]])
        considered = ErrorColumns(W_c, ("loads",), ("load",))
        known = replace(result, linear=replace(result.linear, considered=considered))
        (interval,) = profile_intervals(known, parameters="E")
        return interval

    wider = with_error(0.3)
    reach = 1.959964 * 0.3
    ends = [-np.hypot(low, reach), np.hypot(high, reach)]
    np.testing.assert_allclose(np.log([wider.lower, wider.upper]) - fitted, ends, 1e-4)
    open_ = with_error(5.0)
    assert (open_.lower_end, open_.upper_end) == ("bound", "bound")
    np.testing.assert_allclose([open_.lower, open_.upper], [1e3, 1e8], rtol=1e-9)


@pytest.mark.parametrize("factor", [1.0, 1e3])
def test_estimated_noise_takes_the_law_of_student(factor):
    """Six coordinates and two parameters leave four; only ratios of `std` count."""
    poses = measured(std=factor * STD)
    result = calibrate(MODEL, unknowns(), poses)
    (interval,) = profile_intervals(result, parameters="E")
    scale = factor * result.uncertainty.noise_scale
    reach = t.ppf(0.975, 4) * scale * relative_error(result)
    expected = result.value("E") / (1.0 + np.array([1.0, -1.0]) * reach)
    np.testing.assert_allclose([interval.lower, interval.upper], expected, rtol=CLOSE)


@pytest.mark.slow  # with a prior it is another program
def test_prior_counts_as_a_datum(poses):
    """One that leaves the data nothing to say: 1.96 of its own standard deviations."""
    result = calibrate(MODEL, unknowns(1e-3), poses, noise="stated")
    (interval,) = profile_intervals(result, parameters="E")
    ends = np.log([interval.lower, interval.upper]) - np.log(result.value("E"))
    np.testing.assert_allclose(ends, [-1.96e-3, 1.96e-3], rtol=1e-2)


def test_estimated_noise_is_weighed_against_a_prior():
    """As if the noise that was found had been stated, whatever has been."""
    by_factor = {}
    for factor in (1.0, 30.0):
        poses = measured(std=factor * STD)
        result = calibrate(MODEL, unknowns(0.1), poses)
        scale = factor * result.uncertainty.noise_scale
        (interval,) = profile_intervals(result, parameters="E")
        errors = [p.standard_error for p in result.parameters]
        by_factor[factor] = scale, result.value("E"), *errors, interval.lower
    # The noise is not followed below changes of 1 %.
    np.testing.assert_allclose(by_factor[30.0], by_factor[1.0], rtol=1e-2)
    scale, value, error, *_ = by_factor[1.0]
    stated = calibrate(MODEL, unknowns(0.1), measured(std=scale * STD), noise="stated")
    np.testing.assert_allclose(stated.value("E"), value, rtol=1e-3)
    np.testing.assert_allclose(stated.parameters[0].standard_error, error, rtol=1e-3)


def test_it_ends_at_a_bound_that_the_data_do_not_exclude(poses):
    result = calibrate(MODEL, unknowns(upper=410e3), poses, noise="stated")
    (interval,) = profile_intervals(result, parameters="E")
    assert interval.upper_end == "bound"
    np.testing.assert_allclose(interval.upper, 410e3, rtol=1e-12)
    assert interval.lower_end == "likelihood"
    assert "410 (bound) kPa" in str(interval)
    first, *others = result.parameters
    shown = replace(first, interval=interval), *others
    assert str(interval) in str(replace(result, parameters=shown))


def test_a_lower_cost_is_no_interval(result, poses):
    """The fit is told to be where it is not, up the side of its own valley."""
    problem = build_problem(result.model, result.space, poses, result.newton)
    linear = result.linear
    cost = 0.5 * linear.squares() + 4.5
    off = result.z + jnp.array([3.0 * relative_error(result), 0.0])
    with pytest.raises(LowerCostFound, match="best optimum") as caught:
        profile_ends(
            problem,
            result.settings,
            z=off,
            linear=replace(linear, r=linear.r * np.sqrt(cost / (cost - 4.5))),
            rise=1.96,
            which=[0],
        )
    assert caught.value.cost < caught.value.before
    assert caught.value.before == pytest.approx(cost)
    again = pickle.loads(pickle.dumps(caught.value))
    np.testing.assert_array_equal(again.z, caught.value.z)


def test_fits_that_do_not_converge_give_no_end(result, monkeypatch):
    """They bound the profile from above, which shows no value to be excluded."""

    def given_up(*given, **named):
        run = minimise(*given, **named)
        return replace(run, converged=False, errors=run.errors[:1])

    monkeypatch.setattr("softcal_jax.calibration._profile.minimise", given_up)
    (interval,) = profile_intervals(result, parameters="E")
    assert np.isnan([interval.lower, interval.upper]).all()
    assert (interval.lower_end, interval.upper_end) == ("not found", "not found")
    assert interval.kind == "none"
    assert "do not converge" in str(interval)


def test_an_angle_that_the_data_do_not_see():
    ends = ("bound", "bound")
    interval = ParameterInterval("theta", 0.95, -1.0, np.pi - 1.0, *ends, "rad")
    assert str(interval) == "any angle"


class Valleys:
    """A profile with its end at `end`; beyond `other`, fits from afar end too high.

    Those that begin close to an end inside stay in their valley.
    """

    def __init__(self, end, other):
        self.end, self.other, self.seen = end, other, {}
        self.calibration = SimpleNamespace(rise=2.0)
        self.reach, self.limit = 1.5, 10.0

    def value(self, distance):
        value = 2.0 * (distance / self.end - 1.0)
        return 0.0 if abs(value) < 1e-3 else value

    def excess(self, distance):
        inside = [d for d, rest in self.seen.items() if rest.excess <= 0.0]
        far = min([abs(distance - d) for d in (0.0, *inside)]) > 0.4
        high = 50.0 if distance > self.other and far else self.value(distance)
        known = self.seen.get(distance)
        value = known.excess if known else high
        self.seen[distance] = SimpleNamespace(distance=distance, excess=value)
        return value

    def follow(self, inside, distance):
        assert 0.0 < distance - inside < 0.03 * distance
        value = self.value(distance)
        self.seen[distance] = SimpleNamespace(distance=distance, excess=value)
        return value


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize(
    ("end", "other"), [(2.3, 1.0), (1.2, 1.3), (2.3, 2.0), (6.0, 1.0)]
)
def test_a_fit_in_another_valley_is_repeated_from_inside(end, other):
    reached = _end(Valleys(end, other))
    assert reached.why == "likelihood"
    np.testing.assert_allclose(reached.distance, end, rtol=1e-3)


@pytest.mark.usefixtures("unchecked")
def test_a_profile_that_jumps_ends_there():
    """Beyond 1 the cost is far too high, from wherever a fit begins."""
    jumps = Valleys(20.0, 1.0)
    jumps.value = lambda distance: 50.0 if distance > 1.0 else -1.0
    reached = _end(jumps)
    assert reached.why == "likelihood"
    np.testing.assert_allclose(reached.distance, 1.0, rtol=1e-3)


@pytest.mark.usefixtures("unchecked")
def test_repeated_fits_that_hardly_change_it_are_not_repeated_for_ever():
    """They creep, and each is a thousandth of the rise better than the last one."""
    creeps, followed = Valleys(20.0, 1.0), []

    def value(distance):
        if distance <= 1.0:
            return -1.0
        followed.append(distance)
        return 50.0 - 2e-3 * len(followed)

    creeps.value = value
    follow, repeats = creeps.follow, []
    creeps.follow = lambda *span: repeats.append(span) or follow(*span)
    reached = _end(creeps)
    assert reached.why == "likelihood"
    np.testing.assert_allclose(reached.distance, 1.0, rtol=1e-3)
    assert len(repeats) == 2


@pytest.mark.parametrize(
    ("excess", "most"),
    [
        (lambda d: d - 1.2, 3),  # a parabola of the cost: the line's guess is right
        (lambda d: d**3 - 1.728, 8),
        (lambda d: np.expm1(20.0 * (d - 1.2)), 15),
    ],
    ids=["line", "cubic", "exponential"],
)
def test_an_end_is_found_in_few_fits(excess, most):
    tried = []

    def rounded(distance):
        tried.append(distance)
        value = excess(distance)
        return 0.0 if abs(value) < 1e-3 else value

    end, same = root(rounded, 0.0, 2.0)
    assert end == same
    assert rounded(end) == 0.0
    assert len(set(tried)) <= most  # a profile remembers its fits


def test_a_fit_that_is_lost_is_gone_back_from():
    """Beyond 1.4 no fit converges; the end is at 1.2, or at 1.5."""

    def excess(end):
        def of(distance):
            if distance > 1.4:
                raise NotFound
            return distance - end

        return of

    def of(end, limit):
        sizes = {"rise": end, "inside": 0.0, "reach": 2.0, "limit": limit}
        return bracket(excess(end), **sizes)

    inside, outside = of(1.2, 10.0)
    assert inside <= 1.2 <= outside <= 1.4
    with pytest.raises(NotFound):
        of(1.5, 10.0)
    assert of(1.2, 1.1) is None


def test_bad_input(result):
    with pytest.raises(ValueError, match=r"level .* 0\.01 and 0\.9999,.* got 95\."):
        profile_intervals(result, level=95.0)
    with pytest.raises(ValueError, match="unknown parameter 'EE'"):
        profile_intervals(result, parameters="EE")
    with pytest.raises(ValueError, match="did not converge"):
        profile_intervals(replace(result, converged=False))


def test_estimated_noise_needs_data(result):
    estimated = replace(result.uncertainty, noise="estimated")
    none = replace(result, uncertainty=replace(estimated, degrees_of_freedom=0))
    with pytest.raises(ValueError, match="more measured coordinates"):
        profile_intervals(none)


def with_prior(space):
    """So weak that the cost is the same."""
    return ParameterSpace([replace(q, prior_std=1e6) for q in space.parameters])


@pytest.mark.slow  # two programs of a beam with axes, each of several fits
def test_where_both_moduli_meet_an_end_is_found():
    """E_t cannot fall below E_l: beyond, the axis would turn by 90 degrees."""
    setup = anisotropic_beam(cells=(3, 1, 1), std=1e-3)
    poses = synthetic_measurements(
        setup.model, setup.space, setup.configurations, setup.target
    )
    start = jnp.asarray([setup.target[name] for name in setup.space.names])
    result = calibrate(
        setup.model,
        setup.space,
        poses,
        noise="stated",
        start=setup.space.to_scaled(start),
    )
    name = next(name for name in setup.space.names if name.startswith("E_t"))
    (interval,) = profile_intervals(result, parameters=[name])
    assert interval.lower_end == "likelihood"
    assert interval.lower < result.value(name) < interval.upper


def test_plain_steps_keep_the_order_of_the_moduli():
    setup = anisotropic_beam(cells=(2, 1, 1))
    plain = setup.space.in_plain_steps()
    assert setup.space.chart is not None
    assert plain.chart is None
    assert plain.order_names() == [
        ("E_l of CP 1", "E_t of CP 1"),
        ("E_l of CP 2", "E_t of CP 2"),
    ]
    assert plain.names == setup.space.names
    assert eqx.tree_equal(plain.entries, setup.space.entries)


def test_a_pin_takes_the_place_of_a_prior():
    """In a space without names, too."""
    space = with_prior(ParameterSpace(unknowns()))
    pin = Pin(jnp.asarray(1), jnp.asarray(0.3), jnp.asarray(20.0))
    held = ParameterSpace(space.entries, pin=pin).numbered
    np.testing.assert_allclose(held.prior_weights(), [1e-6, 20.0])
    z = space.start() + jnp.array([2.0, 0.0])
    gap = 20.0 * (float(z[1]) - 0.3)
    np.testing.assert_allclose(held.from_prior(z), [2e-6, gap], rtol=1e-12)
    assert ParameterSpace(unknowns(), pin=pin).has_prior
