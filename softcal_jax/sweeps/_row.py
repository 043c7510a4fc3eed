"""Rows of trials, how a trial always ends in one, and the progress that they make."""

import math
import os
import socket
import time
import traceback
import warnings
from collections import Counter, deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any, Literal

import jax
import numpy as np

from softcal_jax._compilation_cache import throw_away_damaged
from softcal_jax._process import Clock, ends_at
from softcal_jax.sweeps._trial import Trial, shown

State = Literal["converged", "not converged", "failed"]

Figure = bool | float | int | str | None

TO_TRUTH = "distance to truth [-]"  # a figure of trials to which the truth applies
ON_BOUND = "on a bound"  # a figure in words: parameters that ended on one of theirs
OUT_OF_RANGE = "out of range"  # a figure that no sweep writes, like 1e400
WINDOW = 50  # number of recent trials over which the rate is averaged


@dataclass(frozen=True)
class Outcome:
    """What a trial found.

    Attributes:
        figures: Numbers or words by name; nan and None mean that there is none. A name
            may end with its SI unit in brackets, "fit rms [m]": tables then show
            readable units.
        converged: Whether the figures can be used; if not, means leave them out.
        reason: Why the trial did not converge.
        notes: What a user should know before using the figures.
    """

    figures: Mapping[str, Any]
    converged: bool = True
    reason: str = ""
    notes: Sequence[str] = ()


_OF_ROW = ("state", "reason", "seconds", "compile_seconds", "worker", "ended")
"""Columns of a table of rows between axes and figures."""

TrialFunction = Callable[[Trial], Outcome | Mapping[str, Any]]


@dataclass(frozen=True)
class TrialRow:
    """How a trial ended: a row of the database.

    Attributes:
        key: Name of the trial.
        point: Its value on each axis.
        state: "converged", "not converged" or "failed".
        reason: Why it did not converge, or failed.
        figures: What it found; nothing if it failed.
        notes: What a user should know before using the figures.
        seconds: Wall time [s].
        compile_seconds: Part of it that JAX spent tracing and compiling, or reading
            compiled programs [s].
        worker: Machine and process that ran it.
        ended: When it ended, in UTC.
        traceback: Where it failed.
    """

    key: str
    point: Mapping[str, Any]
    state: State
    reason: str = ""
    figures: Mapping[str, Figure] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    seconds: float = 0.0
    compile_seconds: float = 0.0
    worker: str = ""
    ended: str = ""
    traceback: str = ""


def run_trial(function: TrialFunction, trial: Trial) -> TrialRow:
    """Run a trial, and return a row even if it raises."""
    outcome, reason, trace = Outcome({}), "", ""
    with warnings.catch_warnings(record=True) as caught, Clock() as clock:
        warnings.simplefilter("always")
        warnings.simplefilter("ignore", DeprecationWarning)  # for developers
        try:
            outcome = _as_outcome(function(trial))
        except Exception as error:  # a trial that fails is a row with its reason
            reason = f"{type(error).__name__}: {error}"
            trace = traceback.format_exc()
    warned = [str(w.message) for w in caught]
    for text in warned:  # a killed worker leaves an incomplete program on disk
        throw_away_damaged(text)
    warned = [text for text in warned if "persistent compilation cache" not in text]
    state: State = "converged" if outcome.converged else "not converged"
    if not outcome.converged:
        reason = outcome.reason or "it did not converge"
    return TrialRow(
        key=trial.key,
        point=trial.point,
        state="failed" if trace else state,
        reason=reason,
        figures=outcome.figures,
        notes=tuple(dict.fromkeys([*outcome.notes, *warned])),
        seconds=sum(clock.seconds.values()),
        compile_seconds=clock.seconds["compile"],
        worker=f"{socket.gethostname()} {os.getpid()}",
        ended=_now(),
        traceback=trace,
    )


def failed_row(trial: Trial, reason: str) -> TrialRow:
    """Return the row of a trial whose worker could not report its end."""
    return TrialRow(trial.key, trial.point, "failed", reason, ended=_now())


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")


def _as_outcome(returned: Any) -> Outcome:
    if isinstance(returned, Mapping):
        returned = Outcome(returned)
    if not isinstance(returned, Outcome):
        raise TypeError(
            f"the function of a sweep must return a mapping of names to numbers, or an "
            f"Outcome; got {type(returned).__name__}."
        )
    figures = {str(name): _figure(name, v) for name, v in returned.figures.items()}
    return Outcome(figures, bool(returned.converged), returned.reason, returned.notes)


def _figure(name: str, value: Any) -> Figure:
    if isinstance(value, np.ndarray | np.generic | jax.Array) and np.ndim(value) == 0:
        value = np.asarray(value).item()
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if value is None or isinstance(value, str | int):
        return value
    raise TypeError(
        f"figure {name!r} must be a number or a word, got {type(value).__name__}; give "
        "each entry of an array a name of its own."
    )


def flat_columns(
    axes: Sequence[str], rows: Sequence[TrialRow]
) -> tuple[dict[str, list[Any]], ...]:
    """Return rows as columns: of the axes, how the trials ended, figures, notes."""
    figures = dict.fromkeys(name for row in rows for name in row.figures)
    cell = lambda value: shown(value) if isinstance(value, list) else value
    return (
        {axis: [cell(row.point[axis]) for row in rows] for axis in axes},
        {name: [getattr(row, name) for row in rows] for name in _OF_ROW},
        {name: [row.figures.get(name) for row in rows] for name in figures},
        {"notes": [" ".join(row.notes) for row in rows]},
    )


@dataclass(frozen=True)
class Progress:
    """State of a sweep, after each trial.

    Attributes:
        total: Trials of the sweep.
        ended: Trials that have ended, in this run or before.
        before: Trials that had ended before this run.
        not_converged: Ended trials that did not converge.
        failed: Ended trials that failed.
        rate: Trials per second over the last ones of this run; None until a worker has
            ended its second trial, since the first one compiles.
        row: The trial that has just ended; None at the beginning.
    """

    total: int
    ended: int
    before: int
    not_converged: int
    failed: int
    rate: float | None
    row: TrialRow | None

    def __str__(self) -> str:
        """Write one line for a terminal."""
        counts = {"failed": self.failed, "not converged": self.not_converged}
        bad = [f"{n} {what}" for what, n in counts.items() if n]
        text = f"{self.ended} of {self.total} trials"
        text += f" ({', '.join(bad)})" if bad else ""
        if self.rate is None:
            return text
        left = (self.total - self.ended) / self.rate
        text += f", {3600.0 * self.rate:.1f} per hour"
        # Earlier, an estimate can be off by more than a factor of two.
        of_run = self.total - self.before, self.ended - self.before
        foreseen = left and 3 * of_run[1] >= of_run[0]
        return f"{text}, {ends_at(left)}" if foreseen else text


class Tally:
    """Counter of the trials of a run."""

    def __init__(self, total: int, states: list[str]):
        """Begin a run of `total` trials, some of which have ended in these states."""
        self._total, self._before = total, len(states)
        self._states = Counter(states)
        self._workers: set[str] = set()
        self._ends: deque[tuple[float, bool]] = deque(maxlen=WINDOW)

    def now(self, row: TrialRow | None = None) -> Progress:
        """Count a trial that has just ended, if any, and return the progress."""
        if row is not None:
            self._states[row.state] += 1
            # The first trial of a worker compiles for all of its later ones.
            counts = row.worker in self._workers
            self._workers.add(row.worker)
            self._ends.append((time.monotonic(), counts))
        # The rate counts from the end of the oldest of the recent trials.
        times, counts = zip(*self._ends, strict=True) if self._ends else ((0.0,), ())
        n, span = sum(counts[1:]), times[-1] - times[0]
        return Progress(
            total=self._total,
            ended=self._states.total(),
            before=self._before,
            not_converged=self._states["not converged"],
            failed=self._states["failed"],
            rate=n / span if n and span else None,
            row=row,
        )
