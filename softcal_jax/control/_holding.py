"""What keeps effectors from their goals: limits, and directions no actuator moves."""

from typing import NamedTuple

import numpy as np

from softcal_jax._typing import Float, HostArray
from softcal_jax.control._problem import Command, Linear, follow_room
from softcal_jax.control._result import BlindDirection, coordinate_names
from softcal_jax.control._step import FLAT_COSINE, ROUNDING, Arrival

BLIND = 1e-2
"""Singular value of W_ea, relative to the largest, below which a direction is blind.

Inputs, counted as the motion of the robot that they cause, move the effectors a hundred
times less along it than along the best direction [-].
"""


class Holding(NamedTuple):
    """Why no step comes closer to the goals.

    Attributes:
        active: Limits that are reached, in words.
        limits: Those of them that hold the effectors back, the strongest first.
        blind: The share of the errors that no commanded actuator changes.
    """

    active: tuple[str, ...]
    limits: tuple[str, ...]
    blind: BlindDirection | None


class _Limit(NamedTuple):
    """One limit of an actuator.

    Attributes:
        actuator: Index of the actuator.
        of_input: Whether it limits the imposed quantity or the one that follows.
        is_upper: Whether it is the highest or the lowest value.
    """

    actuator: int
    of_input: bool
    is_upper: bool


def what_holds(command: Command, here: Arrival, linear: Linear) -> Holding:
    """Split what is left of the errors between limits and blind directions.

    At a minimum, the slope W^T r of the first level that is not met is balanced by the
    limits that are reached, W^T r + A^T mu = 0 with mu >= 0, and by earlier levels. A
    limit holds where its mu is positive. What W does not reach at all is blind.
    """
    reached = _reached(command, here, linear)
    active = tuple(_in_words(command, here, limit) for limit in reached)
    off = command.residuals(here.compliance.state)
    unmet = np.abs(off).max(axis=1) > command.settings.tol
    if not unmet.any():
        return Holding(active, (), None)
    level, n_e = int(np.argmax(unmet)), off.shape[1]
    moves = linear.limits.upper > linear.limits.lower
    W, r = linear.W[level] * moves, linear.error[level]
    A = np.array([_gradient(linear, limit) for limit in reached])
    A = A.reshape(-1, len(moves)) * moves
    mu = _multipliers(W.T @ r, A, linear.W[:level] * moves)
    # The step that each limit forbids: the cosine between the errors and its effect.
    effect = np.linalg.norm(W @ A.T, axis=0) * np.linalg.norm(r)
    cosine = mu * (A**2).sum(axis=1) / np.where(effect > 0.0, effect, np.inf)
    strongest = [i for i in np.argsort(-cosine) if cosine[i] > FLAT_COSINE]
    return Holding(
        active=active,
        limits=tuple(active[i] for i in strongest),
        blind=_blind(command, W[:n_e], off[level]),
    )


def _multipliers(slope, A, earlier) -> Float[HostArray, " n_rows"]:
    """Solve slope + A^T mu + earlier^T nu = 0 for mu >= 0, by least squares."""
    # Here, so that commands which do not need it do not wait for it.
    from scipy.optimize import nnls

    free = earlier.reshape(-1, A.shape[1])
    columns = np.concatenate([A, free, -free]).T
    if columns.shape[1] == 0:
        return np.zeros(0)
    return nnls(columns, -slope)[0][: len(A)]


def _blind(
    command: Command,
    W: Float[HostArray, "n_e n_a"],
    off: Float[HostArray, " n_e"],
) -> BlindDirection | None:
    """Find the share of the errors in directions that W hardly reaches."""
    U, sizes, _ = np.linalg.svd(W, full_matrices=False)
    seen = U[:, sizes > BLIND * sizes[0]]
    share = off - seen @ (seen.T @ off)
    if np.abs(share).max() <= command.settings.tol:
        return None
    direction = share / np.linalg.norm(share)
    gain = np.linalg.norm(direction @ W) / sizes[0] if sizes[0] > 0.0 else 0.0
    weights = np.asarray(command.levels).sum(axis=0)
    std = 1.0 / np.where(weights > 0.0, weights, np.inf)
    rows, shares = direction.reshape(std.shape), share.reshape(std.shape) * std
    parts = [
        (
            f"{name} of {record.name!r}".removeprefix(" of "),
            record.unit,
            rows[at],
            shares[at],
        )
        for record in command.effectors
        for k, name in enumerate(coordinate_names(record))
        if record.seen[k] and (at := (record.index, k))
    ]
    names, units, components, offs = zip(*parts, strict=True)
    return BlindDirection(
        coordinates=names,
        units=units,
        direction=np.array(components),
        off=np.array(offs),
        gain=float(gain),
    )


def _reached(command: Command, here: Arrival, linear: Linear) -> list[_Limit]:
    """List the limits that are reached, actuator by actuator."""
    lower, upper = command.box()
    of_inputs = [here.value - lower, upper - here.value] / linear.scale
    of_others = follow_room(command, here.compliance.state, linear.length)
    room = np.stack([of_inputs, of_others.reshape(2, -1)])
    active = (room <= 10.0 * ROUNDING) & (upper > lower)
    return [
        _Limit(int(a), of_input=other == 0, is_upper=side == 1)
        for a, other, side in np.argwhere(np.moveaxis(active, -1, 0))
    ]


def _gradient(linear: Linear, limit: _Limit) -> Float[HostArray, " n_a"]:
    """Return the change of the limited quantity by y, whose product must not grow."""
    n_a = len(linear.scale)
    if limit.of_input:
        return np.eye(n_a)[limit.actuator] * (1.0 if limit.is_upper else -1.0)
    lower, upper = np.asarray(linear.limits.A).reshape(2, n_a, n_a)
    return (upper if limit.is_upper else lower)[limit.actuator]


def _in_words(command: Command, here: Arrival, limit: _Limit) -> str:
    """Say which limit of an actuator is reached."""
    a = limit.actuator
    step = command.limits.step[a] * (1.0 - 1e-12)
    by_displacement = bool(np.asarray(command.lane.actuation.by_displacement)[a])
    what = "displacement" if by_displacement == limit.of_input else "force"
    side = "upper" if limit.is_upper else "lower"
    if limit.of_input and np.abs(here.value[a] - command.start[a]) >= step:
        what, side = f"step of the {what}", "longest"
    actuators = command.model.mechanism.actuators
    noun, name = actuators.kinds[a].noun, actuators.names[a]
    return f"{what} of {noun} {name!r} at its {side} limit"
