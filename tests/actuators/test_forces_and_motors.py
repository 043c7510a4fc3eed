import jax.numpy as jnp
import numpy as np
import pytest
from actuator_programs import (
    TURN,
    actuator_displacements,
    actuator_rows,
    arrays_of,
    bent,
    with_frames,
)
from scipy.spatial.transform import Rotation

from softcal_jax.actuators import (
    ForceActuator,
    Motor,
    SurfaceForceActuator,
    actuator_arrays,
)
from softcal_jax.configurations import PointForce, SurfaceForce
from softcal_jax.mesh import beam

each_order = pytest.mark.parametrize("order", [1, 2])
POINT, DIRECTION = (0.11, 0.2, 0.03), (1.0, -2.0, 0.5)
UNIT = np.array(DIRECTION) / np.linalg.norm(DIRECTION)
ORIGIN = np.array([0.2, 0.0, 0.1])


def body(order=1):
    return beam(0.4, 0.3, 0.2, (3, 2, 2), order=order)


@each_order
@pytest.mark.parametrize(
    ("actuator", "load"),
    [
        (ForceActuator("f", POINT, DIRECTION), PointForce(POINT, tuple(UNIT))),
        (
            SurfaceForceActuator("f", "x_max", DIRECTION),
            SurfaceForce("x_max", tuple(UNIT)),
        ),
    ],
)
def test_row_is_the_dead_load_of_unit_size(actuator, load, order):
    mesh = body(order)
    arrays = arrays_of(mesh, actuator)
    row = actuator_rows(arrays, jnp.asarray(bent(mesh.points)))[0]
    np.testing.assert_allclose(row, load.nodal_forces(mesh), rtol=0, atol=1e-15)
    assert arrays.clique_nodes() == ()


@each_order
def test_displacement_of_a_point_and_of_a_surface(order):
    """Under u = G X: G X_point, and G X at the centre of the surface."""
    mesh = body(order)
    arrays = arrays_of(
        mesh,
        ForceActuator("p", POINT, DIRECTION),
        SurfaceForceActuator("s", "x_max", DIRECTION),
    )
    G = np.array([[0.3, 0.2, -0.1], [0.0, -0.1, 0.4], [0.3, -0.2, 0.1]])
    delta = actuator_displacements(arrays, jnp.asarray(mesh.points @ (np.eye(3) + G).T))
    places = np.array([POINT, (0.4, 0.15, 0.1)])
    np.testing.assert_allclose(delta, places @ G.T @ UNIT, rtol=1e-12)


@pytest.mark.parametrize("angle", [-3.0, -0.5, 0.0, 1.0, 3.0])
def test_motor_angle(angle):
    """A body that turns about its third axis and goes anywhere shows the angle."""
    mesh = body()
    points = with_frames(mesh, (ORIGIN, np.eye(3)), (ORIGIN, TURN))
    arrays = actuator_arrays(mesh, points, (Motor("m", "hub"),), {"base": 0, "hub": 1})
    R = Rotation.from_rotvec(angle * TURN[2]).as_matrix()
    x = points.copy()
    x[-4:] = (points[-4:] - ORIGIN) @ R.T + ORIGIN + [1.0, 2.0, 3.0]
    delta = actuator_displacements(arrays, jnp.asarray(x))
    np.testing.assert_allclose(delta, [angle], rtol=0, atol=1e-14)


def test_motor_torque():
    """The nodal forces are a couple: the unit torque about the third axis."""
    mesh = body()
    points = with_frames(mesh, (ORIGIN, TURN))
    arrays = actuator_arrays(mesh, points, (Motor("m", "hub"),), {"hub": 0})
    row = np.asarray(actuator_rows(arrays, jnp.asarray(points)))[0]
    np.testing.assert_allclose(row.sum(axis=0), 0.0, rtol=0, atol=1e-14)
    np.testing.assert_allclose(np.cross(points, row).sum(axis=0), TURN[2], rtol=1e-12)
    assert arrays.kinds[0].force_unit == "N m"


def test_unknown_body_is_suggested():
    mesh = body()
    points = with_frames(mesh, (ORIGIN, TURN))
    with pytest.raises(ValueError, match=r"motor 'm' 'hup'.* 'hub'\?"):
        actuator_arrays(mesh, points, (Motor("m", "hup"),), {"hub": 0})


@pytest.mark.parametrize(
    "make",
    [
        lambda d: ForceActuator("f", POINT, d),
        lambda d: SurfaceForceActuator("f", "x_max", d),
    ],
)
def test_bad_direction(make, unchecked):
    with pytest.raises(ValueError, match=r"'f': direction .* all zero"):
        make((0.0, 0.0, 0.0))
    with pytest.raises(ValueError, match=r"'f': direction .*finite.* inf"):
        make((0.0, np.inf, 0.0))


def test_bad_point(unchecked):
    with pytest.raises(ValueError, match=r"'f': point .*finite"):
        ForceActuator("f", (0.0, 1.0), DIRECTION)
    with pytest.raises(ValueError, match=r"'f' at .* 600 mm"):
        arrays_of(body(), ForceActuator("f", (1.0, 0.1, 0.1), DIRECTION))
