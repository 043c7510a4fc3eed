"""What errors of printing do to a design, to first order."""

from typing import NamedTuple

import numpy as np

from softcal_jax._module import Module
from softcal_jax._typing import Float, HostArray
from softcal_jax.calibration import CalibrationResult, ConfigurationResult
from softcal_jax.control import GoalFit
from softcal_jax.designs._result import LEVEL, DesignGoal
from softcal_jax.fields import ControlPointParameters, ParameterSpace, kind_of
from softcal_jax.materials import ANGLE, UNREMARKABLE

DRAWS = 4000  # prints that an interval is taken from


class Printing(Module):
    """Errors of printing at each control point, as standard deviations.

    The defaults are those with which the printed robots of the paper were found again.

    Attributes:
        moduli: Of each modulus, relative [-]. Ratios and the density are known.
        angle: Of the axis [rad].
    """

    moduli: float = 0.3
    angle: float = float(np.deg2rad(20.0))

    def __check_init__(self):
        for name, value in vars(self).items():
            if not 0.0 <= value < np.inf:
                raise ValueError(
                    f"printing: {name} must be finite and not negative, got {value}."
                )

    def deviations(self, result: CalibrationResult) -> Float[HostArray, " n_p"]:
        """Return the standard deviation of each scaled parameter; 0 if known [-]."""
        space, values = result.space, [p.value for p in result.parameters]
        sets = space.sets_fields
        std = np.zeros(len(values))
        for k, (q, value) in enumerate(zip(space.parameters, values, strict=True)):
            if not sets[k]:
                continue
            kind = kind_of(result.model, q.field)
            if kind == ANGLE:
                std[k] = self.angle / float(q.unit_step)
            elif kind == UNREMARKABLE:
                size = 1.0 if q.scale == "log" else value / float(q.unit_step)
                std[k] = self.moduli * size
        return std


class _Printed(NamedTuple):
    """Errors of printing: one column of `moves` per parameter, and random prints."""

    std: Float[HostArray, " n_p"]
    draws: Float[HostArray, "n_draws n_p"]
    owners: tuple[str, ...]


def design_goals(
    result: CalibrationResult, printing: Printing
) -> tuple[DesignGoal, ...]:
    """Say what each goal comes to, as ordered and as printed."""
    std = printing.deviations(result)
    draws = std * np.random.default_rng(0).standard_normal((DRAWS, len(std)))
    printed = _Printed(std, draws, _owners(result.space))
    return tuple(
        _goal(pose, GoalFit(effector), printed)
        for pose in result.configurations
        for effector in pose.effectors
        if effector.seen.any()
    )


def _owners(space: ParameterSpace) -> tuple[str, ...]:
    """Name the control point of each parameter, or the parameter where it has none."""
    owners = {q.name: q.name for q in space.parameters}
    for entry in space.entries:
        if isinstance(entry, ControlPointParameters):
            for point in entry.control_points.names:
                owners[entry.parameter_name(point)] = point
    return tuple(owners[name] for name in space.names)


def _goal(pose: ConfigurationResult, fit: GoalFit, printed: _Printed) -> DesignGoal:
    """Say what a goal comes to."""
    effector, seen = fit.effector, fit.effector.seen
    assert pose.W_ep is not None
    W = pose.W_ep[effector.index, : len(effector.std)][seen]
    residual = fit.residual[seen]
    errors = np.linalg.norm(residual + printed.draws @ W.T, axis=1)
    tail = 0.5 * (1.0 - LEVEL)
    low, high = np.quantile(errors, [tail, 1.0 - tail])
    variances = np.sum((W * printed.std) ** 2, axis=0)
    total = float(variances.sum())
    by_owner = dict.fromkeys(printed.owners, 0.0)
    for owner, variance in zip(printed.owners, variances, strict=True):
        by_owner[owner] += float(variance)
    strongest = max(by_owner, key=by_owner.__getitem__)
    return DesignGoal(
        effector,
        configuration=pose.name,
        met=bool(np.all(np.abs(fit.in_std) <= 1.0)),
        expected=float(np.sqrt(residual @ residual + total)),
        interval=(float(low), float(high)),
        hangs_on=strongest if total > 0.0 else "",
        share=by_owner[strongest] / total if total > 0.0 else 0.0,
    )
