"""Errors of printing, change between neighbours, and what both do to goals."""

from collections.abc import Sequence
from dataclasses import replace

import jax.numpy as jnp
import numpy as np

from softcal_jax._module import Module
from softcal_jax._typing import Float, HostArray
from softcal_jax.calibration import CalibrationResult, ConfigurationResult
from softcal_jax.configurations import EffectorRecord
from softcal_jax.designs._peaks import aimed
from softcal_jax.designs._result import LEVEL, DesignGoal
from softcal_jax.equilibrium import Model
from softcal_jax.fields import ControlPointParameters, Likeness, ParameterSpace, kind_of
from softcal_jax.materials import ANGLE, UNREMARKABLE


class Deviations(Module):
    """Standard deviations of fields of the material at a control point.

    Attributes:
        moduli: Of each modulus, relative [-]. Ratios and the density have none.
        angle: Of the axis [rad].
    """

    moduli: float
    angle: float

    def scaled(
        self, model: Model, space: ParameterSpace, values: Sequence[float]
    ) -> Float[HostArray, " n_p"]:
        """Return those of the scaled parameters at some values; 0 where none [-]."""
        std = np.zeros(len(values))
        fields = zip(space.parameters, values, space.sets_fields, strict=True)
        for k, (q, value, of_field) in enumerate(fields):
            if not of_field:
                continue
            kind = kind_of(model, q.field)
            if kind == ANGLE:
                std[k] = self.angle / float(q.unit_step)
            elif kind == UNREMARKABLE:
                size = 1.0 if q.scale == "log" else value / float(q.unit_step)
                std[k] = self.moduli * size
        return std


class Printing(Deviations):
    """Errors of printing at each control point, as standard deviations.

    The defaults are those with which the printed robots of the paper were found again.
    """

    moduli: float = 0.3
    angle: float = float(np.deg2rad(20.0))

    def __check_init__(self):
        for name, value in vars(self).items():
            if not 0.0 <= value < np.inf:
                raise ValueError(
                    f"printing: {name} must be finite and not negative, got {value}."
                )

    def touches(self, model: Model, space: ParameterSpace) -> bool:
        """Return whether any parameter has errors of printing."""
        starts = [float(q.start) for q in space.parameters]
        return bool(np.any(self.scaled(model, space, starts) > 0.0))

    def deviations(self, result: CalibrationResult) -> Float[HostArray, " n_p"]:
        """Return the standard deviation of each scaled parameter; 0 if known [-]."""
        values = [p.value for p in result.parameters]
        return self.scaled(result.model, result.space, values)


class Change(Deviations):
    """Change between neighbouring control points that costs as much as a tolerance.

    Neighbours are the two control points that are the nearest to some tet.
    """

    moduli: float = np.inf
    angle: float = np.inf

    def __check_init__(self):
        for name, value in vars(self).items():
            if not value > 0.0:
                raise ValueError(f"change: {name} must be positive, got {value:g}.")

    def likeness(self, model: Model, space: ParameterSpace) -> Likeness:
        """Make rows of all pairs of neighbours, each beside the goals.

        Raises:
            ValueError: If no field has two control points with such a change.
        """
        names, n_p = space.names, len(space.names)
        std = self.scaled(model, space, [float(q.start) for q in space.parameters])
        rows = []
        for entry in space.entries:
            if not (isinstance(entry, ControlPointParameters) and entry.parameters):
                continue
            for pair in entry.neighbours(model.mesh):
                row, known, column = np.zeros(n_p), 0.0, -1
                for sign, point in zip((1.0, -1.0), pair, strict=True):
                    if point in entry.fixed:
                        value = entry.fixed[point]
                        known -= sign * float(entry.parameters[0].to_scaled(value))
                    else:
                        column = names.index(entry.parameter_name(point))
                        row[column] += sign
                if np.any(row) and 0.0 < std[column] < np.inf:
                    q = space.parameters[column]
                    turn = np.pi / float(q.unit_step) if q.periodic else np.inf
                    rows.append((row, known, turn, std[column]))
        if not rows:
            raise ValueError(
                "change: no field has two control points whose moduli or angles are "
                "designed; leave it out."
            )
        A, b, turns, std = (np.array(part) for part in zip(*rows, strict=True))
        return Likeness(*map(jnp.asarray, (A, b, turns, std)))


def specimens(
    std: Float[HostArray, " n_p"], seed: int
) -> Float[HostArray, "n_specimens n_p"]:
    """Return deviations of few prints with the mean and the covariance of all.

    The first is as ordered; the others are a simplex around it, turned at random
    (spherical simplex sigma points; Julier, Proc. Am. Control Conf., 2003). Their mean
    is zero and their covariance diag(std^2), so that the mean of squared errors over
    them is that over all prints, to second order of the deviations.
    """
    uncertain = np.flatnonzero(std > 0.0)
    n = len(uncertain)
    random = np.random.default_rng(seed).standard_normal((n + 1, n))
    basis, _ = np.linalg.qr(np.column_stack([np.ones(n + 1), random]))
    deviations = np.zeros((n + 2, len(std)))
    deviations[1:, uncertain] = np.sqrt(n + 2.0) * basis[:, 1:] * std[uncertain]
    return deviations


DRAWS = 4000  # prints that an interval is taken from


def design_goals(
    result: CalibrationResult, printing: Printing
) -> tuple[DesignGoal, ...]:
    """Say what each goal comes to, as ordered and as printed."""
    std = printing.deviations(result)
    draws = std * np.random.default_rng(0).standard_normal((DRAWS, len(std)))
    owners = _owners(result.space)
    return tuple(
        _goal(pose, effector, std=std, draws=draws, owners=owners)
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
    effector: EffectorRecord,
    *,
    std: Float[HostArray, " n_p"],
    draws: Float[HostArray, "n_draws n_p"],
    owners: tuple[str, ...],
) -> DesignGoal:
    """Say what a goal comes to, by errors of parameters and random prints of them."""
    seen = effector.seen
    assert pose.W_ep is not None
    W = pose.W_ep[effector.index, : len(effector.std)][seen]
    residual = effector.residual[seen]
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
        met=effector.worst <= 1.0,
        expected=float(np.sqrt(residual @ residual + total)),
        expected_in_std=np.hypot(residual, np.linalg.norm(W * std, axis=1))
        / effector.std[seen],
        interval=(float(low), float(high)),
        hangs_on=strongest if total > 0.0 else "",
        share=by_owner[strongest] / total if total > 0.0 else 0.0,
    )
