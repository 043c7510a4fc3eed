"""What a design returns, and its verdict."""

from collections.abc import Sequence

import numpy as np

from softcal_jax._module import Module, Result
from softcal_jax._names import listed
from softcal_jax._typing import Float, HostArray
from softcal_jax.calibration import CalibrationResult
from softcal_jax.configurations import Configuration
from softcal_jax.control import GoalFit
from softcal_jax.designs._foam import FoamTable
from softcal_jax.designs._peaks import Peak

LISTED = 4  # missed goals that a message lists

LEVEL = 0.95
"""Share of the prints whose error lies in the interval of a goal [-]."""


class DesignGoal(GoalFit):
    """A goal of a design: how close it comes as ordered, and as it is printed.

    Attributes:
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
        return f"{self.name!r} in {self.configuration!r}"

    @property
    def error(self) -> float:
        """Size of the error as ordered, in the unit of the effector."""
        return float(np.linalg.norm(self.residual))


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
        worst = lambda goal: float(np.max(np.abs(goal.in_std), initial=0.0))
        missed = [goal for goal in self.goals if not goal.met]
        return tuple(sorted(missed, key=worst, reverse=True))

    @property
    def error(self) -> float:
        """Root mean square of the errors over all goals, in tolerances [-]."""
        return error_of(self.goals)

    @property
    def expected(self) -> float:
        """The same as printed, see `DesignGoal.expected` [-]."""
        return expected_of(self.goals)

    @property
    def values(self) -> dict[str, float]:
        """Values of the material as ordered, by parameter, in SI units."""
        return {name: self.fit.value(name) for name in self.material}

    @property
    def headline(self) -> str:
        """The verdict, in a sentence."""
        n, missed = len(self.goals), self.unmet
        if not self.fit.converged:
            return "Not designed: the search did not converge."
        if missed:
            return f"Not designed: {len(missed)} of {n} goals are missed."
        if self.lost:
            return "Not designed: a robust design was not found."
        if not self.met:
            return "Not designed: a limit is exceeded."
        return f"Designed: all {n} goals are met." if n > 1 else "Designed: it is met."

    @property
    def reasons(self) -> tuple[str, ...]:
        """What goals are off by, and what holds them there, one sentence each."""
        reasons = [f"{g.label} is off by {g.off}." for g in self.unmet[:LISTED]]
        if len(self.unmet) > LISTED:
            reasons.append(f"{len(self.unmet) - LISTED} more are off by less.")
        if self.lost:
            reasons.append(f"This is the one of least error as ordered: {self.lost}")
        if self.robust and self.unmet:
            reasons.append("As ordered it is farther off, to be closer as printed.")
        reasons += [f"{peak}." for peak in self.peaks if not peak.kept]
        if self.held_by:
            reasons.append(f"They are held by {listed(self.held_by)}.")
        return (*reasons, *(f"{trade}." for trade in self.trades))

    @property
    def worth(self) -> tuple[str, ...]:
        """What the design is worth, one sentence for each alternative."""

        def sentence(a: Alternative) -> str:
            missed, error = f"{a.error:.3g} tolerances off", f"{self.error:.3g}"
            if np.isfinite(a.expected):
                missed += f", {a.expected:.3g} as printed"
                error += f" and {self.expected:.3g}"
            if not a.result.converged:
                missed += " or less (its search did not converge)"
            return f"With {a.name} the goals are {missed}, with this design {error}."

        return tuple(map(sentence, self.alternatives))

    def _words(self) -> str:
        return self.headline


def expected_of(goals: Sequence[DesignGoal]) -> float:
    """Return the root mean square of all errors as printed, in tolerances [-]."""
    squares = sum(float(np.sum(goal.expected_in_std**2)) for goal in goals)
    return float(np.sqrt(squares / sum(goal.effector.seen.sum() for goal in goals)))


def error_of(goals: tuple[GoalFit, ...]) -> float:
    """Return the root mean square of all errors, in tolerances [-]."""
    parts: list[Float[HostArray, " k"]] = [g.in_std[g.effector.seen] for g in goals]
    return float(np.sqrt(np.mean(np.concatenate(parts) ** 2)))
