"""Rows and curvature of every actuator against central differences."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from actuator_programs import (
    TURN,
    actuator_displacements,
    actuator_rows,
    bent,
    curvature_entries,
    curvature_times,
    with_frames,
)
from problems import central_difference

from benchmarks._hollow import hollow_cube
from softcal_jax.actuators import (
    Cable,
    Chamber,
    ForceActuator,
    Guide,
    Motor,
    SurfaceForceActuator,
    SurfacePressure,
    actuator_arrays,
)

CABLE = Cable(
    "cable",
    (
        (0.4, 0.1, 0.2),
        (0.4, 0.2, -0.2),
        Guide((0.9, 0.5, 0.5), on="plate"),
        Guide((1.0, 2.0, 1.0), on="ground"),
    ),
)
ACTUATORS = {
    "cable": CABLE,
    "chamber": Chamber("chamber", "cavity"),
    "motor": Motor("motor", "plate"),
    "point": ForceActuator("point", (0.4, 0.1, 0.2), (1.0, 2.0, 3.0)),
    "surface": SurfaceForceActuator("surface", "outer", (0.0, 1.0, 1.0)),
    "pressure": SurfacePressure("pressure", "x_side"),
    "pressure around": SurfacePressure("pressure around", "outer"),
}
each_order = pytest.mark.parametrize("order", [1, 2])
of_displacements = pytest.mark.parametrize(
    ("name", "order"),  # a motor turns a body, whatever the order of the tets
    [("cable", 1), ("cable", 2), ("chamber", 1), ("chamber", 2), ("motor", 1)],
)


def robot(*names, order=1):
    """Arrays of some actuators, a deformed state and a direction."""
    mesh = hollow_cube(1, order)
    points = with_frames(mesh, (np.array([0.8, 0.1, 0.2]), TURN))
    chosen = [ACTUATORS[name] for name in names]
    arrays = actuator_arrays(mesh, points, chosen, {"plate": 0})
    x = bent(points)
    return arrays, x, np.random.default_rng(0).normal(size=x.shape)


def displacements(arrays, x):
    return np.asarray(actuator_displacements(arrays, jnp.asarray(x)))


def rows(arrays, x):
    return np.asarray(actuator_rows(arrays, jnp.asarray(x)))


def errors_of(function, exact, x, tangent, steps):
    difference = lambda h: central_difference(function, x, tangent, h)
    return [np.max(np.abs(difference(h) - exact)) for h in steps]


@of_displacements
def test_rows_meet_differences_at_second_order(name, order):
    arrays, x, tangent = robot(name, order=order)
    exact = np.sum(rows(arrays, x) * tangent[None], axis=(1, 2))
    function = lambda x: displacements(arrays, x)
    coarse, fine = errors_of(function, exact, x, tangent, (1e-2, 1e-3))
    # Second order: a tenfold smaller step leaves a hundredth of the error.
    np.testing.assert_allclose(coarse / fine, 100.0, rtol=0.02)


@pytest.mark.parametrize("name", ["point", "surface"])
def test_linear_rows_are_exact(name):
    arrays, x, tangent = robot(name)
    exact = np.sum(rows(arrays, x) * tangent[None], axis=(1, 2))
    function = lambda x: displacements(arrays, x)
    # No truncation error: only rounding.
    assert errors_of(function, exact, x, tangent, (1.0,))[0] < 1e-14


@pytest.mark.parametrize(("name", "order"), [("cable", 1), ("cable", 2), ("motor", 1)])
def test_curvature_meets_differences_at_second_order(name, order):
    arrays, x, tangent = robot(name, order=order)
    exact = curvature_times(arrays, x, np.array([2.5]), tangent)
    function = lambda x: 2.5 * rows(arrays, x)[0]
    coarse, fine = errors_of(function, exact, x, tangent, (1e-2, 1e-3))
    np.testing.assert_allclose(coarse / fine, 100.0, rtol=0.02)


@each_order
@pytest.mark.parametrize("name", ["chamber", "pressure"])
def test_curvature_of_pressures_is_exact(name, order):
    """Their forces are quadratic in the positions, which a difference meets exactly."""
    arrays, x, tangent = robot(name, order=order)
    exact = curvature_times(arrays, x, np.array([2.5]), tangent)
    function = lambda x: 2.5 * rows(arrays, x)[0]
    assert np.max(np.abs(exact)) > 1e-2
    assert errors_of(function, exact, x, tangent, (0.1,))[0] < 1e-14


@of_displacements
def test_curvature_of_a_potential_is_symmetric(name, order):
    arrays, x, _ = robot(name, order=order)
    lambda_a = jnp.asarray(np.array([2.5]))
    (entries,) = map(np.asarray, curvature_entries(arrays, jnp.asarray(x), lambda_a))
    np.testing.assert_allclose(entries, np.swapaxes(entries, 1, 2), rtol=0, atol=1e-13)
    assert arrays.symmetric


@each_order
@pytest.mark.parametrize(("name", "closed"), [("pressure", 0), ("pressure around", 1)])
def test_a_following_pressure_is_symmetric_only_on_a_closed_surface(
    name, closed, order
):
    arrays, x, tangent = robot(name, order=order)
    other = np.random.default_rng(1).normal(size=x.shape)
    one, two = (
        np.vdot(a, curvature_times(arrays, x, np.ones(1), b))
        for a, b in ((tangent, other), (other, tangent))
    )
    assert (abs(one - two) < 1e-13) == bool(closed)
    assert not arrays.symmetric


def test_all_together_as_alone():
    """Groups by type keep the order of the actuators."""
    names = ["pressure", "motor", "chamber", "point", "cable", "surface"]
    arrays, x, tangent = robot(*names)
    assert arrays.names == tuple(names)
    lambda_a = np.arange(1.0, 7.0)
    total = curvature_times(arrays, x, lambda_a, tangent)
    for i, name in enumerate(names):
        alone, _, _ = robot(name)
        for function in (displacements, rows):
            np.testing.assert_allclose(
                function(arrays, x)[i], function(alone, x)[0], rtol=0, atol=1e-14
            )
        total -= curvature_times(alone, x, lambda_a[i : i + 1], tangent)
    np.testing.assert_allclose(total, 0.0, rtol=0, atol=1e-13)


def test_flags_stay_on_the_host():
    """A traced robot still tells what it is made of, and lanes share it."""
    arrays, x, _ = robot("cable", "chamber")

    @eqx.filter_jit
    def both(arrays, lanes):
        assert arrays.unilateral.tolist() == [True, False]
        return jax.vmap(lambda x: arrays.displacements(x))(lanes)

    delta = np.asarray(both(arrays, jnp.asarray(np.stack([x, 2.0 * x]))))
    alone = displacements(arrays, 2.0 * x)
    np.testing.assert_allclose(delta[1], alone, rtol=0, atol=1e-14)


def test_no_actuators():
    arrays, x, _ = robot()
    x = jnp.asarray(x)
    assert arrays.names == ()
    assert arrays.symmetric
    assert actuator_displacements(arrays, x).shape == (0,)
    assert actuator_rows(arrays, x).shape == (0, *x.shape)
    assert curvature_entries(arrays, x, jnp.zeros(0)) == ()
    assert arrays.clique_nodes() == ()


def test_bad_arrays(unchecked):
    mesh = hollow_cube()
    with pytest.raises(ValueError, match=r"actuator 'cable'.*another name"):
        actuator_arrays(mesh, mesh.points, (CABLE, CABLE), {"plate": 0})
