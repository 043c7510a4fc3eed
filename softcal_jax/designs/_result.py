"""What a design returns, its verdict, and what holds goals that it missed."""

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np

from softcal_jax._module import Module, Result
from softcal_jax._typing import Float, HostArray, Int
from softcal_jax.calibration import CalibrationResult, bounded_step
from softcal_jax.configurations import Configuration, EffectorRecord
from softcal_jax.control import strongest_limits
from softcal_jax.designs._foam import FoamTable
from softcal_jax.designs._peaks import Peak, limits_reached
from softcal_jax.fields import ParameterSpace

LEVEL = 0.95
"""Share of the prints whose error lies in the interval of a goal [-]."""


class DesignGoal(Module):
    """A goal of a design: how close it comes as ordered, and as it is printed.

    Attributes:
        effector: The effector, with the goal in `measured`, and what is reached.
        configuration: The configuration of the goal.
        met: Whether every coordinate is within its tolerance, as ordered.
        expected: Root mean square of the error of prints, in the unit of the effector:
            to first order, or over the specimens of a robust design.
        expected_in_std: The same of each coordinate with a goal, in tolerances [-].
        interval: Ends of the interval that has the error of `LEVEL` of all prints.
        hangs_on: The control point whose errors of printing count most; empty where
            none counts.
        share: Its share of the variance [-].
    """

    effector: EffectorRecord
    configuration: str
    met: bool
    expected: float
    expected_in_std: Float[HostArray, " k"]
    interval: tuple[float, float]
    hangs_on: str
    share: float

    @property
    def label(self) -> str:
        """Name of the effector and of the configuration."""
        return f"{self.effector.name!r} in {self.configuration!r}"

    @property
    def reached(self) -> Float[HostArray, " k"]:
        """Coordinates reached as ordered; for a turn, counted from the goal."""
        return self.effector.simulated

    @property
    def error(self) -> float:
        """Size of the error as ordered, in the unit of the effector."""
        return self.effector.distance(self.effector.simulated)


class Trade(Module):
    """What another goal pays where a missed one is to come closer.

    Attributes:
        goal: The missed goal.
        other: The goal that loses most.
        loss: How much farther off that one is per unit that the missed one comes
            closer, both in their tolerances [-].
    """

    goal: str
    other: str
    loss: float

    def __str__(self) -> str:
        return (
            f"{self.goal} competes with {self.other}: a tolerance closer costs that "
            f"one {self.loss:.2g} of its tolerances"
        )


class Alternative(Module):
    """The same goals with less that may be designed.

    Attributes:
        name: What it is.
        error: Root mean square of the errors over all goals, in tolerances [-].
        expected: The same as printed; nan where its material is not that of a design.
        result: Its fit.
    """

    name: str
    error: float
    expected: float
    result: CalibrationResult


class DesignResult(Result):
    """A design: fields and actuation for all goals.

    Attributes:
        goals: What each goal comes to.
        fit: The fit of the goals; its parameters are the fields and the commands.
        configurations: The configurations with the actuation found.
        held_by: Limits that keep missed goals away, in words, the strongest first.
        trades: Goals that compete.
        alternatives: The design of least nominal error if this one is robust, the best
            homogeneous material, and actuation alone.
        peaks: What is largest in the body at each goal, where it has a limit.
        robust: Whether it has the least expected error, not the least nominal one.
        lost: Why a robust design was not found; empty otherwise.
        foam: The foam that limits the moduli; None without.
        material: Names of the parameters of the material, in the order of the fit.
    """

    goals: tuple[DesignGoal, ...]
    fit: CalibrationResult
    configurations: tuple[Configuration, ...]
    held_by: tuple[str, ...]
    trades: tuple[Trade, ...]
    alternatives: tuple[Alternative, ...]
    peaks: tuple[Peak, ...]
    robust: bool
    lost: str
    foam: FoamTable | None
    material: tuple[str, ...]

    @property
    def met(self) -> bool:
        """Whether the search ended at an optimum that meets all goals in all limits."""
        good = all(goal.met for goal in self.goals) and all(p.kept for p in self.peaks)
        return self.fit.converged and good and not self.lost

    @property
    def unmet(self) -> tuple[DesignGoal, ...]:
        """Goals that are missed, the farthest first, in their tolerances."""
        missed = [goal for goal in self.goals if not goal.met]
        worst = lambda goal: goal.effector.worst
        return tuple(sorted(missed, key=worst, reverse=True))

    @property
    def error(self) -> float:
        """Root mean square of the errors over all goals, in tolerances [-]."""
        return error_of([goal.effector for goal in self.goals])

    @property
    def expected(self) -> float:
        """The same as printed, see `DesignGoal.expected` [-]."""
        return expected_of(self.goals)

    @property
    def values(self) -> dict[str, float]:
        """Values of the material as ordered, by parameter, in SI units."""
        return {name: self.fit.value(name) for name in self.material}


def expected_of(goals: Sequence[DesignGoal]) -> float:
    """Return the root mean square of all errors as printed, in tolerances [-]."""
    squares = sum(float(np.sum(goal.expected_in_std**2)) for goal in goals)
    return float(np.sqrt(squares / sum(goal.effector.seen.sum() for goal in goals)))


def error_of(goals: Sequence[EffectorRecord]) -> float:
    """Return the root mean square of all errors, in tolerances [-]."""
    errors = np.concatenate([goal.in_std[goal.seen] for goal in goals])
    return float(np.sqrt(np.mean(errors**2)))


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
        r.append(e.in_std[e.seen])
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
