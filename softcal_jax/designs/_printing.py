"""What errors of printing do to the goals of a design."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from softcal_jax._typing import Float, HostArray
from softcal_jax.calibration import CalibrationResult, ConfigurationResult
from softcal_jax.control import GoalFit
from softcal_jax.designs._deviations import Printing
from softcal_jax.designs._peaks import aimed
from softcal_jax.designs._result import LEVEL, DesignGoal
from softcal_jax.fields import ControlPointParameters, ParameterSpace

DRAWS = 4000  # prints that an interval is taken from


def design_goals(
    result: CalibrationResult, printing: Printing
) -> tuple[DesignGoal, ...]:
    """Say what each goal comes to, as ordered and as printed."""
    std = printing.deviations(result)
    draws = std * np.random.default_rng(0).standard_normal((DRAWS, len(std)))
    owners = _owners(result.space)
    return tuple(
        _goal(pose, GoalFit(effector), std=std, draws=draws, owners=owners)
        for pose in result.configurations
        for effector in aimed(pose)
    )


def over_specimens(
    goals: tuple[DesignGoal, ...],
    poses: Sequence[ConfigurationResult],
    n: int,
    *,
    before: bool = False,
) -> tuple[DesignGoal, ...]:
    """Take what is expected of each goal from the specimens that were solved.

    There are `n` poses of each specimen; `before` takes them at the start of the fit.
    """
    errors: dict[tuple, list[HostArray]] = {}
    for c, pose in enumerate(poses):
        for e in aimed(pose):
            key = poses[c % n].name, e.name, e.quantity
            values = e.simulated_before if before else e.simulated
            errors.setdefault(key, []).append(e.error(values)[e.seen])
    found = []
    for goal in goals:
        e = goal.effector
        of_goal = errors[goal.configuration, e.name, e.quantity]
        rms = np.sqrt(np.mean(np.square(of_goal), axis=0))
        in_std, size = rms / e.std[e.seen], float(np.linalg.norm(rms))
        found.append(replace(goal, expected=size, expected_in_std=in_std))
    return tuple(found)


def _owners(space: ParameterSpace) -> tuple[str, ...]:
    """Name the control point of each parameter, or the parameter where it has none."""
    owners = {q.name: q.name for q in space.parameters}
    for entry in space.entries:
        if isinstance(entry, ControlPointParameters):
            for point in entry.control_points.names:
                owners[entry.parameter_name(point)] = point
    return tuple(owners[name] for name in space.names)


def _goal(
    pose: ConfigurationResult,
    fit: GoalFit,
    *,
    std: Float[HostArray, " n_p"],
    draws: Float[HostArray, "n_draws n_p"],
    owners: tuple[str, ...],
) -> DesignGoal:
    """Say what a goal comes to, by errors of parameters and random prints of them."""
    effector, seen = fit.effector, fit.effector.seen
    assert pose.W_ep is not None
    W = pose.W_ep[effector.index, : len(effector.std)][seen]
    residual = fit.residual[seen]
    errors = np.linalg.norm(residual + draws @ W.T, axis=1)
    tail = 0.5 * (1.0 - LEVEL)
    low, high = np.quantile(errors, [tail, 1.0 - tail])
    variances = np.sum((W * std) ** 2, axis=0)
    total = float(variances.sum())
    by_owner = dict.fromkeys(owners, 0.0)
    for owner, variance in zip(owners, variances, strict=True):
        by_owner[owner] += float(variance)
    strongest = max(by_owner, key=by_owner.__getitem__)
    return DesignGoal(
        effector,
        configuration=pose.name,
        met=bool(np.all(np.abs(fit.in_std) <= 1.0)),
        expected=float(np.sqrt(residual @ residual + total)),
        expected_in_std=np.hypot(residual, np.linalg.norm(W * std, axis=1))
        / effector.std[seen],
        interval=(float(low), float(high)),
        hangs_on=strongest if total > 0.0 else "",
        share=by_owner[strongest] / total if total > 0.0 else 0.0,
    )
