"""Inverse control as arrays: goals, limits, and the linearised QP."""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp

from softcal_jax._typing import Array, Bool, Float
from softcal_jax.configurations import ConfigurationArrays
from softcal_jax.control._compliance import ActuatorCompliance, ActuatorState
from softcal_jax.control._limits import LimitArrays
from softcal_jax.control._qp import InputRows
from softcal_jax.equilibrium import Model


class ControlProblem(eqx.Module):
    """One command, as a pytree, so that one program serves all goals and models.

    Attributes:
        model: The model.
        configuration: The configuration; its measured values are the goals.
        limits: Limits of the actuators.
        start: Inputs from which limits on steps are counted.
        levels: 1 / standard deviation of each effector coordinate, level by level.
        epsilon: Weight of the energy term, see `ControlSettings` [-].
    """

    model: Model
    configuration: ConfigurationArrays
    limits: LimitArrays
    start: Float[Array, " n_a"]
    levels: Float[Array, "n_levels n_rows 3"]
    epsilon: Float[Array, ""]

    @property
    def size(self) -> Float[Array, ""]:
        """Size of the robot [m]."""
        return jnp.max(jnp.ptp(jnp.asarray(self.model.mechanism.points), axis=0))

    def box(self) -> tuple[Float[Array, " n_a"], Float[Array, " n_a"]]:
        """Return the lowest and highest inputs, limits on steps included."""
        limits = self.limits
        return (
            jnp.maximum(jnp.asarray(limits.lower), self.start - limits.step),
            jnp.minimum(jnp.asarray(limits.upper), self.start + limits.step),
        )

    def following(self, of_force, of_displacement):
        """Select, for each actuator, the quantity that is not imposed."""
        imposed = jnp.asarray(self.configuration.actuation.by_displacement)
        imposed = imposed.reshape(-1, *[1] * (of_force.ndim - 1))
        return jnp.where(imposed, of_force, of_displacement)

    def residuals(self, state: ActuatorState) -> Float[Array, "n_levels n_e"]:
        """Compute effector errors in units of std, 0 on other levels [-]."""
        goal = jnp.asarray(self.configuration.effectors.measured)
        off = self.levels * (state.effectors - goal)[None]
        return off.reshape(self.levels.shape[0], -1)


class Linear(NamedTuple):
    """The problem linearised at an equilibrium, with scaled inputs y.

    Attributes:
        scale: Change of an input for y = 1, which moves some node by the size of the
            robot; this makes inputs of different units comparable.
        W: Compliances of each level, energy included, in units of std.
        error: Errors of each level, likewise.
        energy: Matrix that turns forces into the energy rows of the last level.
        rows: Limits.
        length: Scale of the quantities that are not imposed, per row of `rows`.
    """

    scale: Float[Array, " n_a"]
    W: Float[Array, "n_levels n_all n_a"]
    error: Float[Array, "n_levels n_all"]
    energy: Float[Array, "n_a n_a"]
    rows: InputRows
    length: Float[Array, " n_a"]


def linearise(
    problem: ControlProblem,
    value: Float[Array, " n_a"],
    compliance: ActuatorCompliance,
) -> Linear:
    """Linearise the terms of the QP, Eq. (6), level by level.

    The energy term is epsilon lambda_a^T W_aa lambda_a, with lambda_a after the step.

    Args:
        problem: The command.
        value: The inputs.
        compliance: Derivatives there.
    """
    moved = jnp.max(jnp.abs(compliance.displacement), axis=(1, 2))
    scale = jnp.where(moved > 0.0, problem.size / jnp.where(moved > 0.0, moved, 1.0), 1)
    weights = problem.levels.reshape(problem.levels.shape[0], -1)
    W = weights[:, :, None] * (compliance.W_ea * scale[None])[None]
    by_force = compliance.by_force * scale[None]
    lower, upper = problem.box()
    energy = _energy_rows(problem, compliance.W_aa, W[-1], by_force, upper > lower)
    of_energy = jnp.zeros((W.shape[0], *energy.shape)).at[-1].set(energy @ by_force)
    W = jnp.concatenate([W, of_energy], axis=1)
    follow = problem.following(by_force, compliance.by_displacement * scale[None])
    length = jnp.linalg.norm(follow, axis=1)
    length = jnp.where(length > 0.0, length, 1.0)
    b = follow_room(problem, compliance.state, length)
    limited = jnp.isfinite(b)
    A = jnp.concatenate([-follow, follow]) / jnp.concatenate([length, length])[:, None]
    rows = InputRows(
        (lower - value) / scale,
        (upper - value) / scale,
        jnp.where(limited[:, None], A, 0.0),
        jnp.where(limited, b, 1.0),
    )
    error = level_errors(problem, compliance.state, energy)
    return Linear(
        scale=scale, W=W, error=error, energy=energy, rows=rows, length=length
    )


def level_errors(
    problem: ControlProblem, state: ActuatorState, energy: Float[Array, "n_a n_a"]
) -> Float[Array, "n_levels n_all"]:
    """Compute the errors of the levels, with the energy on the last one [-]."""
    off = problem.residuals(state)
    forces = jnp.zeros((off.shape[0], energy.shape[0]))
    forces = forces.at[-1].set(energy @ state.forces)
    return jnp.concatenate([off, forces], axis=1)


def follow_room(
    problem: ControlProblem, state: ActuatorState, length: Float[Array, " n_a"]
) -> Float[Array, " 2*n_a"]:
    """Compute how far the quantities not imposed are from both their limits [-]."""
    q = problem.following(state.forces, state.displacements)
    limits = problem.limits
    down = (q - jnp.asarray(limits.follow_lower)) / length
    return jnp.concatenate([down, (jnp.asarray(limits.follow_upper) - q) / length])


def _energy_rows(problem, W_aa, W, by_force, moves: Bool[Array, " n_a"]):
    """Compute rows E with E^T E = epsilon |W_aa|, scaled by the ratio of W to energy.

    Where motors hold a robot in a state that would be unstable without them, W_aa has
    negative eigenvalues; their magnitude is used.
    """
    size = jnp.sqrt(jnp.abs(jnp.diag(W_aa)))
    size = jnp.where(size > 0.0, size, 1.0)
    # Scale to a unit diagonal, so that units do not affect the eigenvalues.
    values, vectors = jnp.linalg.eigh(W_aa / (size[:, None] * size[None]))
    root = jnp.sqrt(jnp.abs(values))[:, None] * vectors.T * size[None]
    energy = jnp.where(moves, jnp.sum((root @ by_force) ** 2, axis=0), 0.0)
    seen = jnp.where(moves, jnp.sum(W**2, axis=0), 0.0)
    total = jnp.sum(energy)
    ratio = jnp.where(total > 0.0, jnp.sum(seen) / jnp.where(total > 0, total, 1.0), 0)
    return jnp.sqrt(problem.epsilon * ratio) * root
