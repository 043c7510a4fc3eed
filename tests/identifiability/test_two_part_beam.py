"""Identifiability of a real body, before anything is measured on it."""

from dataclasses import replace
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from problems import lane_of
from two_part_beam import (
    HANG,
    OTHER_END,
    PULL,
    ROOT,
    SPACE,
    STD,
    SWAP,
    TIGHT,
    TIP,
    crushed,
    pose,
    two_part_beam,
)
from wording import says

from softcal_jax.calibration import build_problem, evaluate
from softcal_jax.configurations import (
    Configuration,
    Markers,
    Support,
    SupportReaction,
    configuration_arrays,
)
from softcal_jax.equilibrium import energy_and_force, gravity_load, solve_equilibrium
from softcal_jax.fields import Parameter, exactly_known
from softcal_jax.identifiability import identify as identify_with
from softcal_jax.sensitivity import energy_compliance

START = SPACE.start()
identify = partial(identify_with, uncertain=exactly_known())


@pytest.fixture(scope="module")
def lanes():
    """Hanging, pulled aside and clamped at the other end, as arrays."""
    mesh = two_part_beam().mesh
    posed = [
        eqx.tree_at(
            lambda c: c.measured, c, c.markers.positions, is_leaf=lambda v: v is None
        )
        for c in (HANG, PULL, SWAP)
    ]
    return configuration_arrays(mesh, posed)


def solved(model, lane, z):
    changed = SPACE.model_at(model, z)
    return solve_equilibrium(changed, lane, settings=TIGHT).displacement


@jax.jit
def potential(model, lane, z, u):
    """Pi = strain energy - f_ext . u [J]."""
    changed = SPACE.model_at(model, z)
    f_ext = lane.dead_loads + gravity_load(changed, lane.acceleration)
    return energy_and_force(changed, u)[0] - jnp.sum(f_ext * u)


def compliance(model, lane, z, u):
    return energy_compliance(model, lane, u, SPACE, z)


def curvature(function, direction, h):
    """Second difference along a direction."""
    at = lambda share: function(START + share * h * np.asarray(direction))
    return (at(1.0) - 2.0 * at(0.0) + at(-1.0)) / h**2


def curvature_matrix(function, h):
    """Hessian of a function of two variables, by second differences."""
    a, b, both = (curvature(function, d, h) for d in ([1.0, 0], [0, 1.0], [1.0, 1.0]))
    mixed = 0.5 * (both - a - b)
    return np.array([[a, mixed], [mixed, b]])


@pytest.mark.parametrize("index", range(3), ids=["hang", "pull", "swap"])
def test_w_pp_is_what_relaxation_takes_off_the_curvature_of_the_energy(lanes, index):
    """W_pp = d2 Pi / dz2 at fixed u minus d2 (min_u Pi) / dz2, from energies alone."""
    model, lane = two_part_beam(), lane_of(lanes, index)
    u = solved(model, lane, START)
    computed = compliance(model, lane, START, u)
    fixed = lambda z: float(potential(model, lane, z, u))
    least = lambda z: float(potential(model, lane, z, solved(model, lane, z)))
    W = np.asarray(computed.W_pp)
    error = [
        np.max(np.abs(curvature_matrix(fixed, h) - curvature_matrix(least, h) - W))
        for h in (4e-2, 2e-2)
    ]
    # Half the step leaves a quarter of the error, up to terms of fourth order.
    np.testing.assert_allclose(error[0] / error[1], 4.0, rtol=0.05)
    assert error[1] < 1e-3 * np.max(W)
    np.testing.assert_array_equal(W, W.T)
    assert np.all(np.linalg.eigvalsh(W) > 0.0)
    assert bool(computed.ok)


def tip_of(model, lane, z):
    u = solved(model, lane, z)
    weights = np.asarray(lane.effectors.weights)[:, :, None]
    return np.sum(weights * np.asarray(u)[lane.effectors.nodes], axis=1).ravel()


def test_singular_values_are_those_of_measured_sensitivities(lanes):
    """W_ep by differences of solved positions, in units of the markers' noise."""
    model, h = two_part_beam(), 1e-3
    W = np.concatenate(
        [
            np.stack(
                [
                    (
                        tip_of(model, lane_of(lanes, i), START + h * d)
                        - tip_of(model, lane_of(lanes, i), START - h * d)
                    )
                    / (2 * h)
                    for d in jnp.eye(2)
                ],
                axis=1,
            )
            for i in range(3)
        ]
    )
    outlook = identify(model, SPACE, [HANG, PULL, SWAP])
    numbers = outlook.conditioning
    singular = np.linalg.svd(W / STD, compute_uv=False)
    # Differences err by their third derivative times h^2 / 6, and rtol of Newton.
    np.testing.assert_allclose(numbers.singular_values, singular, rtol=1e-5)
    W_pp = sum(
        np.asarray(compliance(model, lane, START, solved(model, lane, START)).W_pp)
        for lane in (lane_of(lanes, i) for i in range(3))
    )
    np.testing.assert_allclose(numbers.condition_W_ep, np.linalg.cond(W), rtol=1e-5)
    np.testing.assert_allclose(
        numbers.condition_W_ep_W_pp, np.linalg.cond(W @ np.linalg.inv(W_pp)), rtol=1e-5
    )
    assert outlook.n_data == 9


def test_a_marker_near_the_clamp_cannot_see_the_tip():
    outlook = identify(two_part_beam(), SPACE, pose("near", ROOT, std=3e-5))
    root, tip = outlook.parameters
    assert outlook.verdict == tip.verdict == "not identifiable"
    assert root.verdict != "not identifiable"
    assert [d.words for d in outlook.blind] == ["E of tip"]
    assert tip.prior is None


def test_both_clamps_see_both_halves():
    outlook = identify(two_part_beam(), SPACE, [HANG, SWAP])
    assert outlook.verdict == "identifiable"
    assert outlook.blind == ()
    # The two poses mirror each other, and so do the halves.
    root, tip = outlook.parameters
    assert root.standard_error == pytest.approx(tip.standard_error, rel=0.05)


def test_one_pose_sees_a_mixture():
    """A tip that sags by one number cannot tell two moduli apart."""
    outlook = identify(two_part_beam(), SPACE, pose("hang", TIP, axes="z"))
    assert outlook.n_data == 1
    assert outlook.verdict == "not identifiable"
    assert outlook.conditioning.condition_weighted == np.inf
    assert all(p.data_only == np.inf for p in outlook.parameters)
    assert says(outlook, "lack at least 1 measured coordinate")


def test_measurements_are_not_looked_at():
    elsewhere = pose("hang", TIP, measured=np.array(TIP) + 0.3)
    there, none = (identify(two_part_beam(), SPACE, c) for c in (elsewhere, HANG))
    assert str(there) == str(none)


def test_it_is_what_a_calibration_sees_at_its_start():
    posed = pose("hang", ROOT + TIP, measured=np.array(ROOT + TIP))
    problem = build_problem(two_part_beam(), SPACE, posed)
    W = evaluate(problem, START).rows.W
    judged = identify(two_part_beam(), SPACE, pose("hang", ROOT + TIP))
    singular = np.linalg.svd(np.asarray(W), compute_uv=False)
    np.testing.assert_allclose(judged.conditioning.singular_values, singular, rtol=1e-6)


def test_noise_and_place_can_be_chosen():
    model = two_part_beam()
    stated = identify(model, SPACE, HANG).conditioning
    finer = identify(model, SPACE, HANG, noise=STD / 4).conditioning
    ratio = finer.singular_values / stated.singular_values
    np.testing.assert_allclose(ratio, 4.0, rtol=1e-12)
    assert finer.condition_W_ep == stated.condition_W_ep
    stiff = identify(model, SPACE, HANG, at=START + 1.0)
    assert stiff.parameters[0].value == pytest.approx(1e5 * np.e)
    # Small deflections: the sag goes with 1/E, and so does its slope in ln E.
    weaker = stiff.conditioning.singular_values[0] / stated.singular_values[0]
    assert 1 / np.e < weaker < 0.6


@pytest.mark.parametrize(("std", "information"), [(1.0, 2.0), ((1.0, 2.0), 1.25)])
def test_markers_have_noise_of_their_own(std, information):
    """Two markers at one place are a finer one: their informations add up."""
    model = two_part_beam()
    finer = pose("a", TIP, std=STD / np.sqrt(information))
    one = identify(model, SPACE, finer)
    two = identify(model, SPACE, pose("a", TIP + TIP, std=STD * np.array(std)))
    np.testing.assert_allclose(one.covariance, two.covariance, rtol=1e-9)


@pytest.mark.parametrize(
    "configurations",
    [(), Configuration("bare", (Support("x_min"),))],
    ids=["no configuration", "no markers"],
)
def test_no_data_is_a_verdict(configurations):
    outlook = identify(two_part_beam(), SPACE, configurations)
    assert outlook.verdict == "not identifiable"
    assert outlook.n_data == 0
    assert len(outlook.blind) == 2
    assert "Nothing is measured" in str(outlook)
    assert "nan" not in str(outlook)


def test_noise_of_points_is_not_that_of_forces():
    """It is in metres: the load cell under the clamp keeps its own, in newtons."""
    cell = SupportReaction("cell", "x_min", std=1e-3)
    ends = Support("x_min"), Support("x_max")
    hang = replace(pose("hang", ROOT), supports=ends, effectors=(cell,))
    finer = replace(hang, markers=Markers(("m0",), ROOT, std=STD / 3.0))
    model = two_part_beam()
    given = identify(model, SPACE, hang, noise=STD / 3.0)
    np.testing.assert_allclose(
        given.spread.errors(), identify(model, SPACE, finer).spread.errors(), rtol=1e-9
    )


def test_one_parameter():
    E = Parameter("E", "E", 1e5, 3e4, 1e6, unit="Pa")
    outlook = identify(two_part_beam(), E, HANG)
    assert outlook.verdict == "identifiable"
    assert outlook.conditioning.condition_W_ep_W_pp == pytest.approx(1.0)


def test_wrong_calls():
    call = partial(identify, two_part_beam(), SPACE)
    with pytest.raises(RuntimeError, match=r"configuration 'crushed'.*Newton steps"):
        call([HANG, crushed()])
    with pytest.raises(ValueError, match="2 finite scaled values"):
        call(HANG, at=jnp.zeros(3))
    with pytest.raises(ValueError, match="2 finite scaled values"):
        call(HANG, at=np.array([np.nan, 0.0]))
    with pytest.raises(ValueError, match=r"noise.*positive"):
        call(HANG, noise=-1e-3)
    with pytest.raises(ValueError, match="named more than once"):
        call([pose("a", ROOT), pose("a", TIP)])
    with pytest.raises(ValueError, match="'side'"):
        identify(two_part_beam(), Parameter("side", "side", 1.0, 0.5, 2.0), HANG)


def test_weight_and_moduli_are_in_proportion():
    """A share of the density that nobody knows is one of both moduli, together."""
    share = 0.05
    only_density = replace(exactly_known(), density=share)
    outlook = identify(two_part_beam(), SPACE, [HANG, SWAP], uncertain=only_density)
    alone = identify(two_part_beam(), SPACE, [HANG, SWAP])
    np.testing.assert_allclose(
        outlook.covariance, alone.covariance + share**2, rtol=1e-2, atol=0
    )


def test_by_default_not_everything_is_known():
    poses = pose("a", ROOT + TIP), pose("b", OTHER_END + ROOT, clamp="x_max")
    outlook = identify_with(two_part_beam(), SPACE, poses)
    alone = identify(two_part_beam(), SPACE, poses)
    for parameter, exact in zip(outlook.parameters, alone.parameters, strict=True):
        assert parameter.relative > 1.5 * exact.relative
