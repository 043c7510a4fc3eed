"""The robot Emio in Python: legs, centre part and motors, with any mesh of the legs."""

import tempfile
from pathlib import Path

import numpy as np

import softcal_jax as sc
from benchmarks import _emio_mesh as legs
from softcal_jax.bodies import hinge_axes
from softcal_jax.equilibrium import Model

MOTORS = ("motor 1", "motor 2", "motor 3", "motor 4")

CENTRE_KG = 5.28e-3
"""Mass of the centre part: volume of bluepart.stl, at the density of the legs."""


def robot(
    leg: legs.Leg, cells: int, *, across: tuple[int, int] = (2, 1), E: float = 35e6
) -> Model:
    """The robot with the dimensions of a leg, as the authors state its material."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "emio.msh"
        legs.emio(leg, cells, across).write(file, file_format="gmsh22", binary=False)
        mesh = sc.read_mesh(file, length_unit="mm", order=2, parts="linked")
    home = 1e-3 * legs.HOME
    bodies = [
        sc.RigidBody("centre", centre_groups(), origin=home, mass=CENTRE_KG),
        sc.RigidBody("sensor", "sensor", origin=home, tied_to="centre"),
    ]
    for motor, name, azimuth in zip(MOTORS, legs.LEGS, legs.AZIMUTHS, strict=True):
        origin, mounted = motor_axis(leg, azimuth)
        axes = hinge_axes(tuple(legs.axes(azimuth)[2]))
        shift = sc.Pose(1e-3 * (mounted - origin))
        body = sc.RigidBody(motor, f"{name}/motor", 1e-3 * origin, axes, shift)
        bodies.append(body)
    return sc.build_model(
        mesh,
        sc.Corotational(sc.Isotropic(E, 0.45)),
        density=1220.0,
        bodies=bodies,
        actuators=[sc.Motor(motor, motor) for motor in MOTORS],
    )


def centre_groups() -> list[str]:
    """Groups of nodes that the centre part holds."""
    return [f"{name}/centre" for name in legs.LEGS]


def motor_axis(leg: legs.Leg, azimuth: float) -> tuple[np.ndarray, np.ndarray]:
    """Where a motor's axis is in the mesh, and where it is mounted [mm]."""
    out, up, _ = legs.axes(azimuth)
    distance = leg.inside + leg.clamped
    mesh = legs.HOME + distance * out + (leg.above + leg.radius) * up
    return mesh, leg.circle * out


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
