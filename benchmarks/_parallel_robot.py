"""The parallel robot of Sec. VI of the paper, as a calibration problem."""

from collections.abc import Mapping, Sequence

import numpy as np

from benchmarks._parallel_robot_geometry import ParallelRobotGeometry
from softcal_jax._module import Module
from softcal_jax._typing import Float, HostArray
from softcal_jax.actuators import Motor
from softcal_jax.bodies import Pose, RigidBody, hinge_axes
from softcal_jax.configurations import BodyFrame, Configuration, ImposedDisplacement
from softcal_jax.equilibrium import Model, build_model
from softcal_jax.fields import (
    ControlPointParameters,
    ParameterSpace,
    SetupParameter,
    motor_zero,
    mounting,
)
from softcal_jax.materials import Corotational, Fibre, ReducedTransverseIsotropic

EFFECTOR = "rod"
"""Name of the rigid rod, and of the 6-D sensor at its middle."""

CORE = 0.1
"""Core of the defects of the fibre between control points [-].

Without it, kinks that defects leave in the cost slow a calibration down.
"""

PRIOR = {"E_t": 0.3, "E_l": 0.3, "theta": float(np.deg2rad(20.0))}
"""Prior standard deviations of a printed field: 30 % and 20 degrees."""

SETUP = {"motor_zero": float(np.deg2rad(0.5)), "mounting": 0.5e-3}
"""Standard deviations of errors of the setup that are calibrated too [rad, m]."""

BOUNDS = {"E_t": (200e3, 6e6), "E_l": (50e3, 3e6)}
"""Bounds of the moduli [Pa]."""

CALIBRATION_ANGLES = (
    (45.0, 45.0, 45.0, 45.0, 45.0, 45.0),
    (25.0, 45.0, 45.0, 45.0, 45.0, 45.0),
    (45.0, 65.0, 45.0, 45.0, 45.0, 45.0),
    (45.0, 45.0, 25.0, 45.0, 45.0, 45.0),
    (45.0, 45.0, 45.0, 65.0, 45.0, 45.0),
    (45.0, 45.0, 45.0, 45.0, 25.0, 45.0),
    (45.0, 45.0, 45.0, 45.0, 45.0, 65.0),
)
"""Angles of the six motors in the seven calibration poses, ours [degrees].

The working point, then each motor in turn at an end of its range.
"""

VALIDATION_ANGLES = (
    (65.0, 45.0, 45.0, 45.0, 45.0, 45.0),
    (45.0, 45.0, 65.0, 45.0, 45.0, 45.0),
    (45.0, 45.0, 45.0, 45.0, 65.0, 45.0),
    (30.0, 45.0, 45.0, 60.0, 45.0, 45.0),
    (45.0, 60.0, 45.0, 45.0, 30.0, 45.0),
    (30.0, 30.0, 30.0, 55.0, 55.0, 55.0),
    (55.0, 40.0, 50.0, 35.0, 50.0, 40.0),
)
"""Angles of the six motors in the seven test poses, ours [degrees]."""


class ParallelRobot(Module):
    """The robot, its parameters and its poses, before anything is measured.

    Attributes:
        model: Two sheets, six arms with motors, and the rod.
        space: {E_t, E_l, theta} at twelve control points that both sheets share.
        configurations: The seven calibration poses.
        validation: Seven other poses.
        geometry: Its dimensions.
    """

    model: Model
    space: ParameterSpace
    configurations: tuple[Configuration, ...]
    validation: tuple[Configuration, ...]
    geometry: ParallelRobotGeometry


def parallel_robot(
    geometry: ParallelRobotGeometry | None = None,
    *,
    size: float = 0.005,
    prior: Mapping[str, float] | None = PRIOR,
    setup: Mapping[str, float] | None = SETUP,
    std: float = 0.76e-3,
    std_angle: float = float(np.deg2rad(0.15)),
) -> ParallelRobot:
    """Build two soft tripod sheets on six motors, joined by a rod with a 6-D sensor.

    Sec. VI of the paper, with the authors' published dimensions; arms, control points,
    poses and start field are ours (see `ParallelRobotGeometry`).

    Args:
        geometry: Dimensions; the published ones by default.
        size: Edge length of the (quadratic) tets in the plane of a sheet [m].
        prior: Prior standard deviations of E_t and E_l (relative) and theta [rad], or
            None. Without them, directions that the data do not see drift.
        setup: Standard deviations of "motor_zero" [rad] and "mounting" [m] if they are
            calibrated together with the material, or None.
        std: Standard deviation of the sensor's position [m].
        std_angle: Standard deviation of its orientation [rad].
    """
    geometry = geometry or ParallelRobotGeometry()
    mesh = geometry.mesh(size=size)
    law = Corotational(
        ReducedTransverseIsotropic(
            geometry.E_t, geometry.E_l, geometry.nu, Fibre(0.0, plane="xz")
        )
    )
    bodies, motors = mechanism(geometry)
    model = build_model(
        mesh, law, density=geometry.density, bodies=bodies, actuators=motors
    )
    poses = lambda name, angles: tuple(
        pose(geometry, f"{name} {k}", row, std=std, std_angle=std_angle)
        for k, row in enumerate(angles, start=1)
    )
    space = _space(geometry, prior or {}, setup or {})
    return ParallelRobot(
        model=space.model_at(model, space.start()),
        space=space,
        configurations=poses("pose", CALIBRATION_ANGLES),
        validation=poses("test", VALIDATION_ANGLES),
        geometry=geometry,
    )


def mechanism(
    geometry: ParallelRobotGeometry,
) -> tuple[tuple[RigidBody, ...], tuple[Motor, ...]]:
    """Build arms, rod and upper cap as rigid bodies, and the six motors.

    The rod is the body of the lower centre, with its frame at the middle of the rod.
    The upper centre is tied to it one rod length above; this pulls the sheets together.
    """
    arms = tuple(
        RigidBody(
            arm.name,
            arm.end,
            origin=arm.axis_point - arm.mounting.translation,
            axes=hinge_axes(arm.axis_direction),
            mounting=arm.mounting,
        )
        for arm in geometry.arms()
    )
    # The middle of the rod, on the flat sheets.
    middle = np.array([0.0, -geometry.rod_pull, 0.0])
    rod = RigidBody(EFFECTOR, "lower/centre", origin=middle)
    tie = {"tied_to": EFFECTOR, "mounting": Pose(2.0 * middle)}
    cap = RigidBody("cap", "upper/centre", origin=-middle, **tie)
    return (*arms, rod, cap), tuple(Motor(arm.name, arm.name) for arm in arms)


def _space(
    geometry: ParallelRobotGeometry,
    prior: Mapping[str, float],
    setup: Mapping[str, float],
) -> ParameterSpace:
    """Build {E_t, E_l, theta} as tensors with prior, then the errors of the setup."""
    points = geometry.control_points()
    moduli = [
        ControlPointParameters(
            field,
            points,
            start=start,
            lower=BOUNDS[field][0],
            upper=BOUNDS[field][1],
            unit="Pa",
            interpolation="log",
            prior_std=prior.get(field),
        )
        for field, start in (("E_t", geometry.E_t), ("E_l", geometry.E_l))
    ]
    half = np.pi / 2
    theta = ControlPointParameters(
        "theta",
        points,
        start=np.mod(geometry.start_angles() + half, np.pi) - half,
        lower=-half,
        upper=half,
        unit="rad",
        scale="linear",
        S=1.0,
        interpolation="director",
        prior_std=prior.get("theta"),
        core=CORE,
    )
    unknown = set(setup) - {"motor_zero", "mounting"}
    if unknown:
        raise ValueError(
            f'setup knows "motor_zero" and "mounting", got {sorted(unknown)}.'
        )
    errors: list[SetupParameter] = []
    arms, zero, shift = geometry.arms(), setup.get("motor_zero"), setup.get("mounting")
    if zero is not None:
        known = {"limit": 6.0 * zero, "prior_std": zero}
        errors += [motor_zero(arm.name, **known) for arm in arms]
    if shift is not None:
        known = {"limit": 6.0 * shift, "prior_std": shift}
        for arm in arms:
            errors += mounting(arm.name, arm.mounting.translation, **known)
    return ParameterSpace((*moduli, theta, *errors), axes=[("E_l", "E_t", "theta")])


def pose(
    geometry: ParallelRobotGeometry,
    name: str,
    angles: Sequence[float] | Float[HostArray, "6"],
    *,
    std: float,
    std_angle: float,
) -> Configuration:
    """Build a pose of the robot from the angles of its motors.

    Args:
        geometry: Dimensions of the robot.
        name: Name of the configuration.
        angles: Angles of "lower 1" to "upper 3" [degrees].
        std: Standard deviation of the sensor's position [m].
        std_angle: Standard deviation of its orientation [rad].
    """
    return Configuration(
        name,
        gravity=(0.0, 0.0, -geometry.gravity),
        effectors=(BodyFrame(EFFECTOR, EFFECTOR, std=std, std_angle=std_angle),),
        actuation={
            arm.name: ImposedDisplacement(float(np.deg2rad(angle)))
            for arm, angle in zip(geometry.arms(), angles, strict=True)
        },
    )
