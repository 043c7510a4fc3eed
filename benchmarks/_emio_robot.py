"""The robot Emio in Python: legs, centre part and motors, with any mesh of the legs."""

import tempfile
from pathlib import Path

import numpy as np

import softcal_jax as sc
from benchmarks import _emio_leg, _emio_mesh as legs
from softcal_jax.bodies import hinge_axes
from softcal_jax.equilibrium import Model

MOTORS = ("motor 1", "motor 2", "motor 3", "motor 4")

CENTRE_KG = 4.06e-3
"""Mass of the centre part [kg]: the volume of bluepart.stl at the density of the legs,
less that of its block in the mesh."""


def robot(
    leg: legs.Leg, cells: int, *, across: tuple[int, int] = (2, 1), E: float = 35e6
) -> Model:
    """The robot with the dimensions of a leg, as the authors state its material."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "emio.msh"
        legs.emio(leg, cells, across).write(file, file_format="gmsh22", binary=False)
        mesh = sc.read_mesh(file, length_unit="mm", order=2, parts="linked")
    home, sensor = 1e-3 * legs.HOME, 1e-3 * legs.SENSOR
    to_home = sc.Pose(home - sensor)
    bodies = [
        sc.RigidBody("centre", "centre", home, mass=CENTRE_KG),
        sc.RigidBody("sensor", "sensor", sensor, mounting=to_home, tied_to="centre"),
    ]
    for motor, name, azimuth in zip(MOTORS, legs.LEGS, legs.AZIMUTHS, strict=True):
        out, up, axis = legs.axes(azimuth)
        origin, hinge = 1e-3 * leg.circle * out, hinge_axes(tuple(axis))
        bodies.append(sc.RigidBody(motor, f"{name}/motor", origin, hinge))
        origin = (leg.circle + leg.radius) * out - leg.clamped * up
        mounted = legs.HOME + leg.inside * out + leg.above * up
        motion = sc.Pose(1e-3 * (mounted - origin), -0.5 * np.pi * axis)
        group = f"{name}/tip"
        tip = sc.RigidBody(
            group, group, 1e-3 * origin, mounting=motion, tied_to="centre"
        )
        bodies.append(tip)
    return sc.build_model(
        mesh,
        sc.Corotational(sc.Isotropic(E, 0.45)),
        density=1220.0,
        bodies=bodies,
        actuators=[sc.Motor(motor, motor) for motor in MOTORS],
    )


def robot_of_linear_tets() -> Model:
    """The authors' scene with their own tets (`blueleg.vtk`), and 0.2 times their E.

    The scene holds the nodes of its boxes, and brings the middle of those at the far
    end of a leg to where the ends of its beams are.
    """
    leg = _emio_leg.authors_mesh()
    motor, tip = _emio_leg.held(leg)
    cube, of_cube = legs.bricks((1, 1, 1))
    middle = 1e3 * leg.points[tip].mean(axis=0)
    blocks = [b + legs.BLOCK * (2.0 * cube - 1.0) for b in (legs.HOME, legs.SENSOR)]
    points, tets = [*blocks], [of_cube, of_cube + len(cube)]
    home, sensor = 1e-3 * legs.HOME, 1e-3 * legs.SENSOR
    first, second = np.arange(len(cube)), np.arange(len(cube)) + len(cube)
    bodies = [
        sc.RigidBody("centre", first, home, mass=CENTRE_KG),
        sc.RigidBody(
            "sensor",
            second,
            sensor,
            mounting=sc.Pose(home - sensor),
            tied_to="centre",
        ),
    ]
    for k, azimuth in enumerate(legs.AZIMUTHS):
        out, up, axis = legs.axes(azimuth)
        start = sum(map(len, points))
        points.append(legs.place(legs.SCENE, azimuth, 1e3 * leg.points))
        tets.append(leg.tets + start)
        (origin,) = legs.place(legs.SCENE, azimuth, middle[None])
        mounted = legs.HOME + legs.SCENE.inside * out + legs.SCENE.above * up
        hinge = hinge_axes(tuple(axis))
        at = 1e-3 * legs.SCENE.circle * out
        motion = sc.Pose(1e-3 * (mounted - origin), -0.5 * np.pi * axis)
        bodies += [
            sc.RigidBody(MOTORS[k], motor + start, at, hinge),
            sc.RigidBody(
                f"tip {k + 1}",
                tip + start,
                1e-3 * origin,
                mounting=motion,
                tied_to="centre",
            ),
        ]
    all_points = 1e-3 * np.concatenate(points)
    mesh = sc.TetMesh(all_points, legs.oriented(all_points, np.concatenate(tets)))
    return sc.build_model(
        mesh,
        sc.Corotational(sc.Isotropic(7e6, 0.45)),
        density=1220.0,
        bodies=bodies,
        actuators=[sc.Motor(motor, motor) for motor in MOTORS],
    )


def pose(name: str, angles: np.ndarray) -> sc.Configuration:
    """A configuration with the motors at some angles [rad]."""
    return sc.Configuration(
        name,
        gravity=(0.0, -9.81, 0.0),
        effectors=[sc.BodyFrame("sensor", "sensor")],
        actuation={
            motor: sc.ImposedDisplacement(float(angle))
            for motor, angle in zip(MOTORS, angles, strict=True)
        },
    )
