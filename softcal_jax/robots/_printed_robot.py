"""Synthetic parallel robots as they might come out of a printer, to calibrate against.

The measured robot of the paper is not public. These have what a calibration meets:
another law, a finer mesh, moduli and fibres that vary smoothly about what was ordered,
and errors of motors, mounting and tracker. Never the calibrated model itself.
"""

from collections.abc import Sequence
from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from softcal_jax._typing import Float, HostArray
from softcal_jax.configurations import BodyFrame, Configuration
from softcal_jax.equilibrium import Model, build_model
from softcal_jax.materials import Fibre, FibreReinforced
from softcal_jax.robots._parallel_robot import mechanism
from softcal_jax.robots._parallel_robot_geometry import ParallelRobotGeometry


class PrintingErrors(eqx.Module):
    """How far a printed robot is from the one that was ordered.

    Attributes:
        moduli: Standard deviation of ln E_t and ln E_l over the sheets [-].
        theta: Standard deviation of the direction of the fibre [rad].
        correlation_length: Over which these vary [m].
        motor_zero: Standard deviation of the zero of each motor [rad].
        mounting: Standard deviation of the place of each motor, per axis [m].
        position: Standard deviation of the tracker's position, per axis [m].
        orientation: Standard deviation of the tracker's rotation vector, per axis [rad].
    """

    moduli: float = 0.3
    theta: float = float(np.deg2rad(20.0))
    correlation_length: float = 0.04
    motor_zero: float = float(np.deg2rad(0.5))
    mounting: float = 0.5e-3
    position: float = 0.3e-3
    orientation: float = float(np.deg2rad(0.3))


def printed_robot(
    geometry: ParallelRobotGeometry | None = None,
    *,
    seed: int,
    errors: PrintingErrors | None = None,
    size: float = 0.005,
    layers: int = 1,
) -> Model:
    """A robot with the fibre-reinforced law and fields that vary about the ordered ones.

    Both sheets were printed alike: they share the fields, as functions of (x, z).

    Args:
        geometry: Dimensions, and the ordered field; the published ones by default.
        seed: Seed of all its errors.
        errors: How large they are.
        size: Edge length of its (quadratic) tets [m].
        layers: Layers of tets through the thickness.

    Returns:
        The robot, to be measured by `simulated_measurements` with poses of `as_read`.
    """
    geometry, errors = geometry or ParallelRobotGeometry(), errors or PrintingErrors()
    random = np.random.default_rng(seed)
    mesh = geometry.mesh(size=size, layers=layers)
    places = mesh.points[mesh.tets[:, :4]].mean(axis=1)[:, [0, 2]]
    vary = lambda: _smooth(random, places, errors.correlation_length)
    E_t = geometry.E_t * np.exp(errors.moduli * vary())
    E_l = geometry.E_l * np.exp(errors.moduli * vary())
    # The ordered spiral, which the control points of the model only interpolate.
    theta = np.arctan2(places[:, 1], places[:, 0]) + geometry.spiral_angle
    theta = theta + errors.theta * vary()
    shear = np.sqrt(E_t * E_l) / (2.0 * (1.0 + geometry.nu))
    law = FibreReinforced(E_t, E_l, geometry.nu, shear, Fibre(theta, plane="xz"))
    bodies, motors = mechanism(geometry)
    model = build_model(
        mesh, law, density=geometry.density, bodies=bodies, actuators=motors
    )
    n_motors, n_bodies = len(motors), len(bodies)
    zero = errors.motor_zero * random.standard_normal(n_motors)
    shift = np.zeros((n_bodies, 3))
    shift[:n_motors] = errors.mounting * random.standard_normal((n_motors, 3))
    return eqx.tree_at(
        lambda m: (m.mechanism.motor_zero, m.mechanism.bodies.mounting_translation),
        model,
        (jnp.asarray(zero), model.mechanism.bodies.mounting_translation + shift),
    )


def _smooth(
    random: np.random.Generator, places: Float[HostArray, "n 2"], length: float
) -> Float[HostArray, " n"]:
    """A smooth random field of unit variance, by random Fourier features [-].

    Its covariance is exp(-d^2 / (2 length^2)) (Rahimi and Recht, NIPS 2007).
    """
    n = 200
    waves = random.standard_normal((n, 2)) / length
    phases = random.uniform(0.0, 2.0 * np.pi, n)
    return np.sqrt(2.0 / n) * np.cos(places @ waves.T + phases).sum(axis=1)


def as_read(
    configurations: Sequence[Configuration], errors: PrintingErrors | None = None
) -> tuple[Configuration, ...]:
    """Poses whose sensors have the tracker's own noise, to be measured with.

    Args:
        configurations: Poses with frames as effectors.
        errors: How far readings are off.
    """
    errors = errors or PrintingErrors()
    return tuple(
        with_stated(c, std=errors.position, std_angle=errors.orientation)
        for c in configurations
    )


def with_stated(
    configuration: Configuration, *, std: float, std_angle: float
) -> Configuration:
    """A configuration whose frames state other standard deviations.

    Args:
        configuration: The configuration.
        std: Of the positions [m].
        std_angle: Of the orientations [rad].
    """
    effectors = [
        replace(e, std=std, std_angle=std_angle) if isinstance(e, BodyFrame) else e
        for e in configuration.effectors
    ]
    return replace(configuration, effectors=tuple(effectors))
