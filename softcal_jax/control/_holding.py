"""What keeps effectors from their goals: limits, and directions no actuator moves."""

from typing import NamedTuple

import numpy as np

from softcal_jax._typing import Float, HostArray
from softcal_jax.control._descent import Arrival
from softcal_jax.control._problem import Command, Linear, follow_room
from softcal_jax.control._result import BlindDirection, coordinate_names
from softcal_jax.control._step import FLAT_COSINE, ROUNDING

BLIND = 1e-2
"""Singular value of W_ea, relative to the largest, below which a direction is blind.

Inputs, counted as the motion of the robot that they cause, move the effectors a hundred
times less along it than along the best direction [-].
"""


class Holding(NamedTuple):
    """Why no step comes closer to the goals, as in `InverseResult`."""

    active_limits: tuple[str, ...] = ()
    held_by: tuple[str, ...] = ()
    blind: BlindDirection | None = None


def what_holds(command: Command, end: Arrival, linear: Linear) -> Holding:
    """Split what is left of the errors between limits and blind directions.

    At a minimum, the slope W^T r is balanced by the limits that are reached, W^T r +
    A^T mu = 0 with mu >= 0. A limit holds where its mu is positive. What W does not
    reach at all is blind.
    """
    reached = _reached(command, end, linear)
    active = tuple(_in_words(command, end, *limit) for limit in reached)
    off = command.residuals(end.compliance.state)
    if np.abs(off).max() <= command.settings.tol:
        return Holding(active)
    moves = linear.limits.upper > linear.limits.lower
    W, r = linear.W * moves, linear.error
    unit = np.eye(len(moves))
    # Gradients by y: at a limit that is reached, gradient @ y must not be positive.
    gradients = np.concatenate([-unit, unit, linear.limits.A]).reshape(4, *unit.shape)
    A = np.array([gradients[limit] for limit in reached])
    A = A.reshape(-1, len(moves)) * moves
    mu = _multipliers(W.T @ r, A)
    # The step that each limit forbids: the cosine between the errors and its effect.
    effect = np.linalg.norm(W @ A.T, axis=0) * np.linalg.norm(r)
    cosine = mu * (A**2).sum(axis=1) / np.where(effect > 0.0, effect, np.inf)
    strongest = [i for i in np.argsort(-cosine) if cosine[i] > FLAT_COSINE]
    return Holding(
        active_limits=active,
        held_by=tuple(active[i] for i in strongest),
        blind=_blind(command, W[: len(off)], off),
    )


def _multipliers(slope, A) -> Float[HostArray, " n_rows"]:
    """Solve slope + A^T mu = 0 for mu >= 0, by least squares."""
    # Here, so that commands which do not need it do not wait for it.
    from scipy.optimize import nnls

    return nnls(A.T, -slope)[0] if len(A) else np.zeros(0)


def _blind(
    command: Command, W: Float[HostArray, "n_e n_a"], off: Float[HostArray, " n_e"]
) -> BlindDirection | None:
    """Find the share of the errors in directions that W hardly reaches."""
    U, sizes, _ = np.linalg.svd(W, full_matrices=False)
    seen = U[:, sizes > BLIND * sizes[0]]
    share = off - seen @ (seen.T @ off)
    if np.abs(share).max() <= command.settings.tol:
        return None
    direction = share / np.linalg.norm(share)
    gain = np.linalg.norm(direction @ W) / sizes[0] if sizes[0] > 0.0 else 0.0
    weights = command.weights
    std = 1.0 / np.where(weights > 0.0, weights, np.inf)
    rows, shares = direction.reshape(std.shape), share.reshape(std.shape) * std
    parts = [
        (
            f"{name} of {record.name!r}".removeprefix(" of "),
            record.unit,
            rows[entry],
            shares[entry],
        )
        for record in command.effectors
        for k, name in enumerate(coordinate_names(record))
        if record.seen[k] and (entry := (record.index, k))
    ]
    names, units, components, offs = zip(*parts, strict=True)
    return BlindDirection(
        coordinates=names,
        units=units,
        direction=np.array(components),
        off=np.array(offs),
        gain=float(gain),
    )


def _reached(command: Command, end: Arrival, linear: Linear) -> list[tuple[int, int]]:
    """List the limits that are reached by kind and actuator, actuator by actuator.

    Kinds 0 to 3: lower and upper limit of the input, then of the quantity that follows.
    """
    lower, upper = command.box()
    of_inputs = [end.value - lower, upper - end.value] / linear.scale
    of_others = follow_room(command, end.compliance.state, linear.length)
    room = np.concatenate([of_inputs, of_others.reshape(2, -1)])
    active = (room <= 10.0 * ROUNDING) & (upper > lower)
    return [(int(kind), int(a)) for a, kind in np.argwhere(active.T)]


def _in_words(command: Command, end: Arrival, kind: int, a: int) -> str:
    of_input, side = kind < 2, ("lower", "upper")[kind % 2]
    by_displacement = bool(np.asarray(command.lane.actuation.by_displacement)[a])
    what = "displacement" if by_displacement == of_input else "force"
    step = command.limits.step[a] * (1.0 - 1e-12)
    if of_input and np.abs(end.value[a] - command.start[a]) >= step:
        what, side = f"step of the {what}", "longest"
    actuators = command.model.mechanism.actuators
    noun, name = actuators.kinds[a].noun, actuators.names[a]
    return f"{what} of {noun} {name!r} at its {side} limit"
