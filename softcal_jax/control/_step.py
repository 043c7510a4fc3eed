"""One step of inverse control: settings, QP at an equilibrium (Eq. 6), acceptance."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._module import Module
from softcal_jax._typing import Array, Float, HostArray
from softcal_jax.calibration import KKT_TOLERANCE, QPStep, bounded_step
from softcal_jax.configurations import (
    Configuration,
    ConfigurationArrays,
    EffectorRecord,
)
from softcal_jax.control._goals import LimitArrays
from softcal_jax.control._inputs import ActuatorCompliance, ActuatorReadings
from softcal_jax.equilibrium import Model, NewtonSettings

ROUNDING = 1e-6
"""Violation of a limit that is ignored, relative to the size of the robot [-]."""

ENDED = 1e-3
"""Step without an equilibrium at which these count as ended, as `step_tol` [-]."""

FLAT_COSINE = 1e-2
"""Cosine between error and step below which a refused step means a minimum [-]."""


class ControlSettings(Module):
    """Settings of inverse control.

    Attributes:
        tol: Error of every effector coordinate at which a goal is met, in units of its
            standard deviation [-].
        step_tol: Step of the inputs at which the search ends, as the largest
            displacement of a node, relative to the size of the robot [-].
        max_steps: Number of steps after which the search gives up.
        step_bound: First bound on the step of every input, measured as `step_tol` [-].
        max_step_bound: Largest value of that bound [-].
        epsilon: Weight of the energy of the actuators, Eq. (6), relative to the effect
            of the inputs on the effectors [-]. It determines inputs that the goals
            leave open, such as co-contraction, at the price of missing the goals by
            about as much. With 0 the search ends as soon as the goals are met.
        other_starts: Number of other starts to try, and after them a continuation of
            the goals, before the search says that a goal cannot be met. With 0 the
            first local optimum counts.
        newton: Settings of the equilibria.
    """

    tol: float = 1e-2
    step_tol: float = 1e-6
    max_steps: int = 50
    step_bound: float = 0.1
    max_step_bound: float = 0.5
    epsilon: float = 0.0
    other_starts: int = 24
    newton: NewtonSettings = eqx.field(default_factory=NewtonSettings)

    def __check_init__(self):
        for name in ("tol", "step_tol", "step_bound", "max_step_bound"):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"{name} must be positive, got {getattr(self, name)}.")
        if self.max_steps < 1:
            raise ValueError(f"max_steps must be at least 1, got {self.max_steps}.")
        for name in ("other_starts", "epsilon"):
            if not getattr(self, name) >= 0.0:
                value = getattr(self, name)
                raise ValueError(f"{name} must not be negative, got {value}.")


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

    Limits are lower <= y <= upper and A y <= b [-]. A y is the change of the quantities
    that are not imposed: first with a minus sign, for their lower limits, actuator by
    actuator, then for their upper limits.

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
    length: Float[HostArray, " n_a"]
    lower: Float[HostArray, " n_a"]
    upper: Float[HostArray, " n_a"]
    A: Float[HostArray, "n_rows n_a"]
    b: Float[HostArray, " n_rows"]


@jax.jit
def limited_step(linear: Linear, radius: Float[Array, ""]) -> QPStep:
    """Minimise ||W y + error|| within the limits; `radius` bounds every entry of y."""
    moves = linear.upper > linear.lower
    A = jnp.where(moves[None], linear.A, 0.0)
    # A violated row is reduced only as far as the trust region allows.
    reach = 0.9 * radius * jnp.sum(jnp.abs(A), axis=1)
    return bounded_step(
        jnp.where(moves[None], linear.W, 0.0),
        jnp.asarray(linear.error),
        jnp.maximum(linear.lower, -radius),
        jnp.minimum(linear.upper, radius),
        A=A,
        b=jnp.maximum(linear.b, -reach),
    )


class Decision(NamedTuple):
    """Consequences of a step that was tried.

    Attributes:
        step_bound: Bound on the next step [-].
        accepted: Whether the step is kept.
        penalty: Weight of violated limits beside the cost [-].
        vanished: Whether no step helps any more.
        stalled: Whether even the smallest step was refused, away from a minimum.
        ended: Whether even a short step led to no equilibrium.
    """

    step_bound: float
    accepted: bool = True
    penalty: float = 1.0
    vanished: bool = False
    stalled: bool = False
    ended: bool = False


def decide(
    linear: Linear,
    qp: QPStep,
    tried: Float[HostArray, "2"],
    before: Decision,
    settings: ControlSettings,
) -> Decision:
    """Accept a step that lowers the weighted sum of the parts, and adapt the bound.

    `tried` are the `parts` at the true equilibrium, inf without one. Their sum is an
    exact penalty function: the weight of violated limits is raised until the sum is
    expected to fall along the step that the QP found (Nocedal and Wright, Numerical
    Optimization, 2006, Eq. 18.36).
    """
    error, step, floor = linear.error, np.asarray(qp.lambda_p), (ROUNDING, 0.0)
    change, size = linear.W @ step, float(np.abs(step).max())
    expected = parts(linear.b - linear.A @ step, error + change)
    now = np.maximum(parts(linear.b, error), floor)
    penalty, (closer, cheaper) = before.penalty, now - np.maximum(expected, floor)
    if closer > np.finfo(float).tiny:
        penalty = max(penalty, -2.0 * float(cheaper / closer))
    weights = np.array([penalty, 1.0])
    hoped = weights @ (closer, cheaper)
    drop = weights @ (now - np.maximum(tried, floor))
    converged = bool(np.isfinite(tried).all())
    at_bound = size >= 0.99 * before.step_bound
    kept_limits = now[0] <= 10.0 * ROUNDING
    # A vanished step ends the search even if it is refused: its expected gain may lie
    # below the residual of the equilibria.
    vanished = converged and kept_limits and float(qp.kkt_residual) <= KKT_TOLERANCE
    vanished = vanished and size <= settings.step_tol and not at_bound
    accepted = bool(converged and hoped > 0.0 and drop >= 1e-4 * hoped)
    bound = before.step_bound if accepted else 0.25 * size
    if accepted and at_bound and drop > 0.75 * hoped:
        bound = min(2.0 * bound, settings.max_step_bound)
    ended = not accepted and not converged and bound < ENDED
    collapsed = not accepted and bound < settings.step_tol
    # The cosine between the errors and their expected reduction.
    lengths = max(np.sum(change**2) * np.sum(error**2), np.finfo(float).tiny)
    flat = -np.sum(change * error) / np.sqrt(lengths) <= FLAT_COSINE
    # At a fold of the only error a motion of the size of the robot gains nothing.
    flat |= np.linalg.norm(change) <= FLAT_COSINE * size * np.linalg.norm(error)
    flat = flat and converged and kept_limits
    return Decision(
        accepted=accepted,
        step_bound=bound,
        penalty=penalty,
        vanished=bool(vanished or (collapsed and flat)),
        stalled=bool(collapsed and not flat),
        ended=ended,
    )


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
        length=length,
        lower=(lower - value) / scale,
        upper=(upper - value) / scale,
        A=np.where(limited[:, None], A, 0.0),
        b=np.where(limited, b, 1.0),
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
