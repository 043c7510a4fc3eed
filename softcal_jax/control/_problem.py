"""One command, and its QP linearised at an equilibrium (paper Eq. 6)."""

from typing import NamedTuple

import numpy as np

from softcal_jax._typing import Array, Float, HostArray
from softcal_jax.configurations import (
    Configuration,
    ConfigurationArrays,
    EffectorRecord,
)
from softcal_jax.control._compliance import ActuatorCompliance, ActuatorReadings
from softcal_jax.control._limits import LimitArrays
from softcal_jax.control._step import ControlSettings, StepLimits
from softcal_jax.equilibrium import Model


class Command(NamedTuple):
    """A command as the user gave it, and as arrays.

    The actuation of `configuration` is where the command starts. `lane` is the
    configuration as arrays; its measured values are the goals. `weights` are 1 /
    standard deviation of each effector coordinate, 0 without a goal.
    """

    model: Model
    configuration: Configuration
    lane: ConfigurationArrays
    effectors: tuple[EffectorRecord, ...]
    limits: LimitArrays
    weights: Float[HostArray, "n_rows 3"]
    settings: ControlSettings

    @property
    def start(self) -> Float[HostArray, " n_a"]:
        """Inputs from which limits on steps are counted."""
        return np.asarray(self.lane.actuation.value)

    def box(self) -> Float[HostArray, "2 n_a"]:
        """Return the lowest and highest inputs, limits on steps included."""
        (lower, upper), step = self.limits.inputs, self.limits.step
        return np.stack(
            [np.maximum(lower, self.start - step), np.minimum(upper, self.start + step)]
        )

    def following(self, of_force, of_displacement) -> HostArray:
        """Select, for each actuator, the quantity that is not imposed."""
        imposed = np.asarray(self.lane.actuation.by_displacement)
        imposed = imposed.reshape(-1, *[1] * (of_force.ndim - 1))
        return np.where(imposed, of_force, of_displacement)

    def residuals(self, state: ActuatorReadings) -> Float[HostArray, " n_e"]:
        """Compute effector errors in units of std, 0 without a goal [-]."""
        goal = np.asarray(self.lane.effectors.measured)
        return np.ravel(self.weights * (np.asarray(state.effectors) - goal))


class Linear(NamedTuple):
    """A command linearised at an equilibrium, with scaled inputs y.

    Attributes:
        scale: Change of an input for y = 1, which moves some node by the size of the
            robot; this makes inputs of different units comparable.
        W: Compliances in units of std, the energy rows last; `error` likewise.
        energy: Matrix that turns forces into the energy rows.
        length: Scale of the quantities that are not imposed.
    """

    scale: Float[HostArray, " n_a"]
    W: Float[HostArray, "n_all n_a"]
    error: Float[HostArray, " n_all"]
    energy: Float[HostArray, "n_a n_a"]
    limits: StepLimits
    length: Float[HostArray, " n_a"]


def linearise(
    command: Command,
    value: Float[Array | HostArray, " n_a"],
    compliance: ActuatorCompliance,
) -> Linear:
    """Linearise the terms of the QP, Eq. (6).

    The energy term is epsilon lambda_a^T W_aa lambda_a, with lambda_a after the step.
    """
    size = np.ptp(command.model.mechanism.points, axis=0).max()
    moved = np.abs(compliance.displacement).max(axis=(1, 2))
    scale = size / np.where(moved > 0.0, moved, size)
    W = command.weights.reshape(-1, 1) * (np.asarray(compliance.W_ea) * scale)
    by_force = np.asarray(compliance.by_force) * scale
    lower, upper = command.box()
    W_aa = np.asarray(compliance.W_aa)
    energy = _energy_rows(command.settings.epsilon, W_aa, W, by_force, upper > lower)
    by_displacement = np.asarray(compliance.by_displacement) * scale
    follow = command.following(by_force, by_displacement)
    length = np.linalg.norm(follow, axis=1)
    length = np.where(length > 0.0, length, 1.0)
    b = follow_room(command, compliance.state, length)
    limited = np.isfinite(b)
    A = np.concatenate([-follow, follow]) / np.tile(length, 2)[:, None]
    return Linear(
        scale=scale,
        W=np.concatenate([W, energy @ by_force]),
        error=all_errors(command, compliance.state, energy),
        energy=energy,
        limits=StepLimits(
            (lower - value) / scale,
            (upper - value) / scale,
            np.where(limited[:, None], A, 0.0),
            np.where(limited, b, 1.0),
        ),
        length=length,
    )


def parts(room, error: HostArray) -> Float[HostArray, "2"]:
    """Compute what a step should lower: violated limits, then the cost [-]."""
    return np.array([violation(room), 0.5 * (error**2).sum()])


def violation(room) -> float:
    """Add up by how much limits are violated [-]."""
    return float(np.maximum(-room, 0.0).sum())


def all_errors(
    command: Command, state: ActuatorReadings, energy: Float[HostArray, "n_a n_a"]
) -> Float[HostArray, " n_all"]:
    """Compute the errors of the effectors, then those of the energy [-]."""
    return np.append(command.residuals(state), energy @ np.asarray(state.forces))


def follow_room(
    command: Command, state: ActuatorReadings, length: Float[HostArray, " n_a"]
) -> Float[HostArray, " 2*n_a"]:
    """Compute how far the quantities not imposed are from both their limits [-]."""
    q = command.following(state.forces, state.displacements)
    lower, upper = command.limits.following
    return np.concatenate([(q - lower) / length, (upper - q) / length])


def _energy_rows(epsilon, W_aa, W, by_force, moves) -> Float[HostArray, "n_a n_a"]:
    """Compute rows E with E^T E = epsilon |W_aa|, scaled by the ratio of W to energy.

    Where motors hold a robot in a state that would be unstable without them, W_aa has
    negative eigenvalues; their magnitude is used.
    """
    if epsilon == 0.0:
        return np.zeros_like(W_aa)
    size = np.sqrt(np.abs(np.diag(W_aa)))
    size = np.where(size > 0.0, size, 1.0)
    # Scale to a unit diagonal, so that units do not affect the eigenvalues.
    values, vectors = np.linalg.eigh(W_aa / np.outer(size, size))
    root = np.sqrt(np.abs(values))[:, None] * vectors.T * size
    energy = ((root @ by_force)[:, moves] ** 2).sum()
    ratio = (W[:, moves] ** 2).sum() / energy if energy > 0.0 else 0.0
    return np.sqrt(epsilon * ratio) * root
