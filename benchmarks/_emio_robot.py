"""The robot Emio in Python: legs, centre part and motors, with any mesh of the legs."""

import tempfile
from pathlib import Path

import numpy as np

import softcal_jax as sc
from benchmarks import _emio_mesh as legs
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
