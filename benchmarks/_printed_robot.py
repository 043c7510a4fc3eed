"""Synthetic parallel robots as they might be printed, to calibrate against.

The measured robot of the paper is not public. These differ from the calibrated model as
a real one would: by another law, a finer mesh, moduli and fibres that vary smoothly
about the ordered ones, and errors of motors, mounting and tracker.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import equinox as eqx
import numpy as np

from benchmarks._parallel_robot import mechanism
from benchmarks._parallel_robot_geometry import ParallelRobotGeometry
from softcal_jax._module import Module
from softcal_jax.configurations import AbstractEffector, BodyFrame, Configuration
from softcal_jax.equilibrium import Model, build_model
from softcal_jax.materials import (
    Corotational,
    Fibre,
    ReducedTransverseIsotropic,
    TransverseHyperelastic,
)
from softcal_jax.robots import simulated_measurements


class PrintingErrors(Module):
    """Differences between a printed robot and the ordered one.

    Attributes:
        moduli: Standard deviation of ln E_t and ln E_l over the sheets [-].
        theta: Standard deviation of the direction of the fibre [rad].
        correlation_length: Length over which these vary [m].
        motor_zero: Standard deviation of the zero of each motor [rad].
        mounting: Standard deviation of the position of each motor, per axis [m].
        position: Standard deviation of a tracker's reading, per axis [m].
        orientation: Standard deviation of the tracker's rotation, per axis [rad].
    """

    moduli: float = 0.3
    theta: float = float(np.deg2rad(20.0))
    correlation_length: float = 0.04
    motor_zero: float = float(np.deg2rad(0.5))
    mounting: float = 0.5e-3
    position: float = 0.3e-3
    orientation: float = float(np.deg2rad(0.3))


class PrintedRobot(Module):
    """A synthetic robot.

    Attributes:
        model: The robot: at large strain, finer, with all its errors.
        first: The same with the corotational law, whose equilibria serve as guesses.
        errors: Its differences from the ordered robot.
        parameters: What a calibration should find: E_t, E_l [Pa] and theta [rad] at the
            control points of the calibrated model, by the names of their parameters,
            and the zeros of the motors [rad].
    """

    model: Model
    first: Model
    errors: PrintingErrors
    parameters: dict[str, float]


def printed_robot(
    geometry: ParallelRobotGeometry | None = None,
    *,
    seed: int,
    errors: PrintingErrors | None = None,
    size: float = 0.005,
    assembly: int | None = None,
) -> PrintedRobot:
    """Build a robot with another law, and fields that vary about the ordered ones.

    Both sheets were printed alike: they share the fields, as functions of (x, z).

    Args:
        geometry: Dimensions, and the ordered field; the published ones by default.
        seed: Seed of all its errors.
        errors: The size of its errors.
        size: Edge length of its (quadratic) tets [m].
        assembly: Seed of the zeros and mountings of its motors, if another.
    """
    geometry, errors = geometry or ParallelRobotGeometry(), errors or PrintingErrors()
    random = np.random.default_rng(seed)
    mesh = geometry.mesh(size=size)
    vary = [_smooth(random, errors.correlation_length) for _ in range(3)]

    def fields(places):
        E_t = geometry.E_t * np.exp(errors.moduli * vary[0](places))
        E_l = geometry.E_l * np.exp(errors.moduli * vary[1](places))
        # The ordered spiral, which the control points of the model only interpolate.
        theta = np.arctan2(places[:, 1], places[:, 0]) + geometry.spiral_angle
        return E_t, E_l, theta + errors.theta * vary[2](places)

    E_t, E_l, theta = fields(mesh.centroids[:, [0, 2]])
    fibre = Fibre(theta, plane="xz")
    shear = np.sqrt(E_t * E_l) / (2.0 * (1.0 + geometry.nu))
    law = TransverseHyperelastic(E_t, E_l, geometry.nu, shear, fibre)
    bodies, motors = mechanism(geometry)
    if assembly is not None:
        random = np.random.default_rng(assembly)
    zero = errors.motor_zero * random.standard_normal(len(motors))
    shift = np.zeros((len(bodies), 3))
    shift[: len(motors)] = errors.mounting * random.standard_normal((len(motors), 3))
    build = lambda law: eqx.tree_at(
        lambda m: (m.mechanism.motor_zero, m.mechanism.bodies.mounting_translation),
        build_model(
            mesh, law, density=geometry.density, bodies=bodies, actuators=motors
        ),
        replace_fn=lambda old: old + (zero if old.ndim == 1 else shift),
    )
    easy = Corotational(ReducedTransverseIsotropic(E_t, E_l, geometry.nu, fibre))
    points = geometry.control_points()
    at_points = fields(np.asarray(points.positions)[:, [0, 2]])
    parameters = {
        f"{field} of {name}": float(value)
        for field, values in zip(("E_t", "E_l", "theta"), at_points, strict=True)
        for name, value in zip(points.names, values, strict=True)
    }
    zeros = {f"zero of {m.name}": float(z) for m, z in zip(motors, zero, strict=True)}
    return PrintedRobot(build(law), build(easy), errors, parameters | zeros)


def _smooth(random: np.random.Generator, length: float) -> Callable:
    """Draw a smooth random field of unit variance by random Fourier features [-].

    Its covariance is exp(-d^2 / (2 length^2)) (Rahimi and Recht, NIPS 2007).
    """
    n = 200
    waves = random.standard_normal((n, 2)) / length
    phases = random.uniform(0.0, 2.0 * np.pi, n)
    at = lambda places: np.cos(places @ waves.T + phases).sum(axis=1)
    return lambda places: np.sqrt(2.0 / n) * at(places)


def read_poses_of(
    robot: PrintedRobot,
    configurations: Sequence[Configuration],
    *,
    seed: int,
    readings: int = 1,
) -> tuple[Configuration, ...]:
    """Read the poses of a printed robot with a tracker.

    Args:
        robot: The robot.
        configurations: Poses with frames as effectors. They keep their standard
            deviations, which are those assumed in the calibration.
        seed: Seed of the readings.
        readings: How many readings of each pose are averaged.

    Raises:
        ValueError: If there is no reading.
        RuntimeError: If a pose has no equilibrium.
    """
    if readings < 1:
        raise ValueError(f"readings must be at least 1, got {readings}.")
    errors, share = robot.errors, 1.0 / np.sqrt(readings)
    tracker = BodyFrame(
        "", "", std=share * errors.position, std_angle=share * errors.orientation
    )
    as_read = [_with_stds(c, [tracker] * len(c.effectors)) for c in configurations]
    measured = simulated_measurements(
        robot.model, as_read, noise=True, seed=seed, first=robot.first
    )
    pairs = zip(measured, configurations, strict=True)
    return tuple(_with_stds(read, stated.effectors) for read, stated in pairs)


def _with_stds(
    configuration: Configuration, stated: Sequence[AbstractEffector]
) -> Configuration:
    """Give the frames of a configuration the standard deviations of other ones."""
    effectors = [
        replace(effector, std=other.std, std_angle=other.std_angle)
        if isinstance(effector, BodyFrame) and isinstance(other, BodyFrame)
        else effector
        for effector, other in zip(configuration.effectors, stated, strict=True)
    ]
    return replace(configuration, effectors=tuple(effectors))
