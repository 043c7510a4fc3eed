"""What holds missed goals: limits, and goals that compete."""

import jax.numpy as jnp
import numpy as np

from softcal_jax._typing import Float, HostArray, Int
from softcal_jax.calibration import CalibrationResult, bounded_step
from softcal_jax.control import strongest_limits
from softcal_jax.designs._peaks import limits_reached
from softcal_jax.designs._result import DesignGoal, Trade
from softcal_jax.fields import ParameterSpace

ROOM = 1e-9  # largest distance from a limit that is reached, scaled [-]

NUDGE = 2.0  # factor on the weight of a missed goal, to see what others pay [-]

WORTH = 0.05
"""Share of its error by which a missed goal must come closer to be a trade [-]."""


def held_by(
    result: CalibrationResult, goals: tuple[DesignGoal, ...]
) -> tuple[str, ...]:
    """Name the limits that keep goals from being met, the strongest first.

    At a minimum within limits A z <= b, W^T r + A^T mu = 0 with mu >= 0.
    """
    W, r, _ = _rows(result, goals)
    A, names = _reached(result.space, np.asarray(result.z))
    slopes = limits_reached(result)
    A = np.concatenate([A, *(row[None] for row in slopes.values())])
    order, names = strongest_limits(W, r, A), [*names, *slopes]
    return tuple(dict.fromkeys(names[i] for i in order))


def trades(
    result: CalibrationResult, goals: tuple[DesignGoal, ...]
) -> tuple[Trade, ...]:
    """Say what other goals pay where a missed one counts twice as much."""
    W, r, of_goal = _rows(result, goals)
    space, z = result.space, jnp.asarray(result.z)
    A, b = space.rows()
    down, up = space.room(z)
    size = lambda rows: np.array(
        [np.linalg.norm(rows[of_goal == k]) for k in range(len(goals))]
    )
    before, found = size(r), []
    for k, goal in enumerate(goals):
        if goal.met:
            continue
        weight = np.where(of_goal == k, NUDGE, 1.0)
        step = bounded_step(
            jnp.asarray(weight[:, None] * W),
            jnp.asarray(weight * r),
            jnp.maximum(down, -1.0),
            jnp.minimum(up, 1.0),
            A=A,
            b=b - A @ z,
            damping=result.settings.damping,
        )
        change = size(r + W @ np.asarray(step.lambda_p)) - before
        closer, change[k] = -change[k], -np.inf
        other = int(change.argmax())
        if closer > WORTH * before[k] and change[other] > 0.0:
            loss = float(change[other] / closer)
            found.append(Trade(goal.label, goals[other].label, loss))
    return tuple(found)


def _rows(
    result: CalibrationResult, goals: tuple[DesignGoal, ...]
) -> tuple[Float[HostArray, "n n_p"], Float[HostArray, " n"], Int[HostArray, " n"]]:
    """Stack compliances and errors in tolerances, and the index of each row's goal.

    Differences of neighbours that count stand behind, with the index -1.
    """
    W_ep = {pose.name: pose.W_ep for pose in result.configurations}
    W, r, of_goal = [], [], []
    for k, goal in enumerate(goals):
        e, of_pose = goal.effector, W_ep[goal.configuration]
        assert of_pose is not None
        W.append((of_pose[e.index, : len(e.std)] / e.std[:, None])[e.seen])
        r.append(goal.in_std[e.seen])
        of_goal += [k] * int(e.seen.sum())
    if result.space.likeness is not None:
        differences, A = map(np.asarray, result.space.likeness.rows(result.z))
        W.append(A)
        r.append(differences)
        of_goal += [-1] * len(A)
    return np.concatenate(W), np.concatenate(r), np.array(of_goal)


def _reached(
    space: ParameterSpace, z: Float[HostArray, " n_p"]
) -> tuple[Float[HostArray, "n n_p"], list[str]]:
    """List the limits that are reached, as rows that a step must not climb."""
    low, high = np.asarray(space.lower()), np.asarray(space.upper())
    rows, names = [], []
    for k, q in enumerate(space.parameters):
        if q.periodic:
            continue
        unit = np.eye(len(z))[k]
        for reached, sign, side in (
            (z[k] - low[k] <= ROOM, -1.0, "lower"),
            (high[k] - z[k] <= ROOM, 1.0, "upper"),
        ):
            if reached:
                rows.append(sign * unit)
                names.append(f"{q.name} at its {side} limit")
    A, b = map(np.asarray, space.rows())
    for row, right, name in zip(A, b, space.row_names(), strict=True):
        if row @ z >= right - ROOM:
            rows.append(row)
            names.append(name)
    return np.array(rows).reshape(-1, len(z)), names
