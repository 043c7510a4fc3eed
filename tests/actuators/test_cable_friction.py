"""Friction of cables: the capstan equation, its limit, tangent, pictures and refusals.

Euler and Eytelwein: behind a bend by theta a tension is exp(-mu theta) of what it was.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from actuator_programs import (
    actuator_displacements,
    actuator_rows,
    arrays_of,
    bent,
    curvature_entries,
    curvature_times,
)
from problems import assert_second_order

from softcal_jax.actuators import (
    ActuatorArrays,
    Cable,
    Guide,
    actuator_geometry,
)
from softcal_jax.mesh import beam

MU, BEND, N_GUIDES = 0.3, 2.0, 9
CENTRE, RADIUS = np.array([0.5, 0.5, 0.5]), 0.3
MESH = beam(1.0, 1.0, 1.0, (2, 2, 2), order=2)
PATH = ((0.0, 0.1, 0.2), (0.3, 0.3, 0.2), (0.4, 0.8, 0.6), (1.0, 0.1, 0.9))


def displacements(arrays, x):
    return np.asarray(actuator_displacements(arrays, jnp.asarray(x)))


def forces(arrays, x):
    return np.asarray(actuator_rows(arrays, jnp.asarray(x)))


def geometric(arrays, x):
    return np.asarray(of_geometry(arrays, jnp.asarray(x)))


of_geometry = eqx.filter_jit(ActuatorArrays.displacement_rows)


def over_pulley(on):
    """A cable that bends by BEND in all, by equal angles at guides on an arc.

    Its ends stand on the ground, along the first and the last tangent of the polygon.
    """
    turn = BEND / N_GUIDES
    angles = turn * np.arange(N_GUIDES)
    arc = CENTRE + RADIUS * np.stack(
        [np.sin(angles), np.cos(angles), 0.0 * angles], axis=1
    )
    ways = -turn / 2 + turn * np.arange(N_GUIDES + 1)
    first, *_, last = np.stack([np.cos(ways), -np.sin(ways), 0.0 * ways], axis=1)
    ends = Guide(arc[0] - first, "ground"), Guide(arc[-1] + last, "ground")
    guides = (ends[0], *map(Guide, arc, on), ends[1])
    return guides, np.stack([first, last])


@pytest.mark.parametrize("pulled_from", ["first", "last"])
@pytest.mark.parametrize("releasing", [False, True])
def test_pulley_meets_the_capstan_equation(pulled_from, releasing):
    """T_0 / T_1 = exp(-mu BEND), and the force and moment on the pulley with it."""
    guides, (first, last) = over_pulley(["mesh"] * N_GUIDES)
    cable = Cable("c", guides, friction=MU, pulled_from=pulled_from)
    arrays = arrays_of(MESH, cable).moving(np.array([releasing]))
    force = forces(arrays, MESH.points)[0]
    far = np.exp((1.0 if releasing else -1.0) * MU * BEND)
    before, behind = (1.0, far) if pulled_from == "first" else (far, 1.0)
    on_pulley = behind * last - before * first
    np.testing.assert_allclose(force.sum(axis=0), on_pulley, rtol=1e-12, atol=1e-14)
    moment = np.cross(MESH.points, force).sum(axis=0)
    expected = behind * np.cross(guides[-1].point, last)
    expected -= before * np.cross(guides[0].point, first)
    np.testing.assert_allclose(moment, expected, rtol=1e-12, atol=1e-13)


@pytest.mark.parametrize("k", [0, 4, N_GUIDES - 1])
def test_each_guide_carries_the_difference_of_two_tensions(k):
    """One guide on the mesh, so that all force on it is that of this guide."""
    on = ["ground"] * N_GUIDES
    on[k] = "mesh"
    guides, _ = over_pulley(on)
    arrays = arrays_of(MESH, Cable("c", guides, friction=MU, pulled_from="first"))
    force = forces(arrays, MESH.points)[0].sum(axis=0)
    points = [guide.point for guide in guides[k : k + 3]]
    incoming, outgoing = (d / np.linalg.norm(d) for d in np.diff(points, axis=0))
    tension = np.exp(-MU * BEND / N_GUIDES * np.arange(k, k + 2))
    expected = tension[1] * outgoing - tension[0] * incoming
    np.testing.assert_allclose(force, expected, rtol=1e-12, atol=1e-14)


def test_many_guides_are_a_round_pulley():
    """The moment about its axis is that of the two tensions, times the radius."""
    guides, _ = over_pulley(["mesh"] * N_GUIDES)
    arrays = arrays_of(MESH, Cable("c", guides, friction=MU, pulled_from="first"))
    force = forces(arrays, MESH.points)[0]
    moment = np.cross(MESH.points - CENTRE, force).sum(axis=0)[2]
    # The polygon's tangents pass the centre at cos(turn / 2) of the radius.
    arm = RADIUS * np.cos(BEND / N_GUIDES / 2)
    np.testing.assert_allclose(moment, arm * (1 - np.exp(-MU * BEND)), rtol=1e-12)


@pytest.mark.parametrize("mu", [None, 0.0])
def test_without_friction_nothing_is_new(mu):
    """The same arrays, hence the same program, as of a cable that names none."""
    plain = arrays_of(MESH, Cable("c", PATH))
    other = arrays_of(MESH, Cable("c", PATH, friction=mu, pulled_from="last"))
    assert eqx.tree_equal(plain, other)
    assert plain.symmetric
    assert plain.moving(np.array([True])) is plain


@pytest.fixture(scope="module")
def robot():
    """A frictional cable beside a plain one, in a bent state."""
    cable = Cable("c", PATH, friction=MU, pulled_from="first")
    arrays = arrays_of(MESH, Cable("plain", PATH[1:]), cable)
    return arrays, bent(MESH.points)


def test_the_limit_of_no_friction_is_the_frictionless_cable(robot):
    arrays, x = robot
    plain = arrays_of(MESH, Cable("plain", PATH[1:]), Cable("c", PATH))
    np.testing.assert_allclose(
        displacements(arrays, x), displacements(plain, x), rtol=1e-13
    )
    H_a = forces(plain, x)
    np.testing.assert_allclose(geometric(arrays, x), H_a, atol=1e-14)
    gap = [
        np.max(np.abs(forces(arrays.with_friction(1, mu), x) - H_a))
        for mu in (0.0, 1e-4, 1e-5)
    ]
    assert gap[0] < 1e-14
    np.testing.assert_allclose(gap[1] / gap[2], 10.0, rtol=1e-3)


def test_the_two_rows_differ_only_where_there_is_friction(robot):
    arrays, x = robot
    F_a, H_a = forces(arrays, x), geometric(arrays, x)
    np.testing.assert_array_equal(F_a[0], H_a[0])
    assert np.max(np.abs(F_a[1] - H_a[1])) > 0.05
    assert arrays.has_friction == (False, True)
    assert not arrays.symmetric
    assert arrays.has_displacement.all()


def test_displacement_rows_meet_differences_at_second_order(robot):
    arrays, x = robot
    tangent = np.random.default_rng(0).normal(size=x.shape)
    exact = np.sum(geometric(arrays, x) * tangent[None], axis=(1, 2))
    delta = lambda x: displacements(arrays, x)
    assert_second_order(delta, x, tangent, exact, (1e-3, 1e-4), rtol=0.02)


@pytest.mark.parametrize("releasing", [False, True])
def test_tangent_meets_differences_at_second_order_and_is_not_symmetric(
    robot, releasing
):
    arrays, x = robot
    arrays = arrays.moving(np.array([False, releasing]))
    tangent = np.random.default_rng(1).normal(size=x.shape)
    lambda_a = np.array([0.7, 2.5])
    exact = curvature_times(arrays, x, lambda_a, tangent)
    force = lambda x: np.sum(lambda_a[:, None, None] * forces(arrays, x), axis=0)
    assert_second_order(force, x, tangent, exact, (1e-3, 1e-4), rtol=0.02)
    entries = curvature_entries(arrays, jnp.asarray(x), jnp.asarray(lambda_a))
    K = np.asarray(entries[1])[0]
    assert np.max(np.abs(K - K.T)) > 0.01 * np.max(np.abs(K))


def test_derivative_by_friction(robot):
    """dF_a/dmu by forward mode, against differences; of the plain cable it is zero."""
    arrays, x = robot
    force = lambda mu: forces(arrays.with_friction(1, mu), x)
    traced = lambda mu: actuator_rows(arrays.with_friction(1, mu), jnp.asarray(x))
    mu, one = jnp.asarray(np.array(MU)), jnp.asarray(np.array(1.0))
    exact = np.asarray(jax.jvp(traced, (mu,), (one,))[1])
    assert not np.any(exact[0])
    assert_second_order(force, MU, 1.0, exact, (1e-2, 1e-3), rtol=0.02)


def test_straight_cable_and_collapsed_segments_have_no_nan():
    """In line nothing is lost; folded back all of pi; a point has no direction."""
    line = tuple((x, 0.5, 0.5) for x in (0.0, 0.25, 0.75, 1.0))
    arrays = arrays_of(MESH, Cable("c", line, friction=MU, pulled_from="last"))
    plain = arrays_of(MESH, Cable("c", line))
    np.testing.assert_allclose(
        forces(arrays, MESH.points), forces(plain, MESH.points), atol=1e-13
    )
    for x in (jnp.asarray(MESH.points), jnp.asarray(0.0 * MESH.points)):
        entries = curvature_entries(arrays, x, jnp.asarray(np.ones(1)))
        for value in jax.tree.leaves((actuator_rows(arrays, x), entries)):
            assert np.all(np.isfinite(value))


def test_cables_with_other_numbers_of_guides_stand_beside_each_other():
    one = Cable("one", PATH, friction=MU, pulled_from="first")
    two = Cable("two", PATH[:3], friction=0.1, pulled_from="last")
    both = arrays_of(MESH, one, two)
    x = bent(MESH.points)
    for function in (displacements, forces):
        alone = [function(arrays_of(MESH, cable), x) for cable in (one, two)]
        np.testing.assert_allclose(
            function(both, x), np.concatenate(alone), rtol=1e-14, atol=1e-16
        )
    changed = both.with_friction(1, 0.5)
    np.testing.assert_array_equal(forces(changed, x)[0], forces(both, x)[0])
    assert np.any(forces(changed, x)[1] != forces(both, x)[1])


def test_picture_shows_every_segment():
    guides = (Guide((-1.0, 0.0, 0.0), "ground"), *PATH)
    arrays = arrays_of(MESH, Cable("c", guides, friction=MU, pulled_from="last"))
    picture = actuator_geometry(arrays, MESH.points)
    points = np.stack([[-1.0, 0.0, 0.0], *PATH])
    expected = np.stack([points[:-1], points[1:]], axis=1)
    np.testing.assert_allclose(picture.segments, expected, rtol=0, atol=1e-12)
    assert picture.segment_owner.tolist() == [0] * 4


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"friction": -0.1}, "'c' .*friction -0.1,.*not negative"),
        ({"friction": np.inf}, "'c' .*friction inf,.* finite"),
        ({"friction": np.nan}, "'c' .*friction nan,.* finite"),
        ({"pulled_from": None}, "pulled_from=None, .*'first' or 'last'"),
        ({"pulled_from": "left"}, "pulled_from='left', .*'first' or 'last'"),
        ({"guides": PATH[:2]}, "no guide .*leave the friction out"),
    ],
)
def test_bad_friction(changes, message, unchecked):
    good = {"guides": PATH, "friction": MU, "pulled_from": "first"}
    with pytest.raises(ValueError, match=message):
        Cable("c", **good | changes)


def test_a_cable_without_friction_has_no_coefficient_to_change():
    arrays = arrays_of(MESH, Cable("c", PATH))
    with pytest.raises(ValueError, match="'c' has no friction"):
        arrays.with_friction(0, 0.1)
