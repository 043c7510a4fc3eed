"""How a trial ends: always in a row; and how far a sweep is."""

import math
import os
import socket
import time
import traceback
import warnings
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import chain
from typing import Any

import jax
import numpy as np

from softcal_jax._compilation_cache import throw_away_damaged
from softcal_jax._process import Clock, ends_at
from softcal_jax.sweeps._result import Row, State
from softcal_jax.sweeps._trial import COLUMNS, Trial

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


TrialFunction = Callable[[Trial], Outcome | Mapping[str, Any]]


def run_trial(function: TrialFunction, trial: Trial) -> Row:
    """Run a trial, and return a row even if it raises."""
    figures, notes, state, reason, trace = {}, (), "converged", "", ""
    with warnings.catch_warnings(record=True) as caught, Clock() as clock:
        warnings.simplefilter("always")
        warnings.simplefilter("ignore", DeprecationWarning)  # for developers
        try:
            outcome = _as_outcome(function(trial))
            figures, notes = _figures(trial, outcome.figures), outcome.notes
            if not outcome.converged:
                state, reason = "not converged", outcome.reason or "it did not converge"
        except Exception as error:  # a trial that fails is a row with its reason
            state, reason = "failed", f"{type(error).__name__}: {error}"
            trace = traceback.format_exc()
    warned = [str(w.message) for w in caught]
    for text in warned:  # a killed worker leaves an incomplete program on disk
        throw_away_damaged(text)
    warned = [text for text in warned if "persistent compilation cache" not in text]
    row = _row(trial, state, reason)
    row["seconds"] = sum(clock.seconds.values())
    row["compile_seconds"] = clock.seconds["compile"]
    row["worker"] = f"{socket.gethostname()} {os.getpid()}"
    row["notes"] = [*dict.fromkeys([*notes, *warned])]
    row["traceback"] = trace
    return row | figures


def failed_row(trial: Trial, reason: str) -> Row:
    """Return the row of a trial whose worker could not report its end."""
    return _row(trial, "failed", reason)


def _row(trial: Trial, state: State, reason: str) -> Row:
    return {
        **trial.point,
        "state": state,
        "reason": reason,
        "seconds": 0.0,
        "compile_seconds": 0.0,
        "worker": "",
        "ended": datetime.now(UTC).isoformat(timespec="seconds"),
        "notes": [],
        "traceback": "",
        "point": trial.key,
    }


def _as_outcome(returned: Any) -> Outcome:
    if isinstance(returned, Mapping):
        return Outcome(returned)
    if isinstance(returned, Outcome):
        return returned
    raise TypeError(
        "the function of a sweep must return a mapping of names to numbers, or an "
        f"Outcome; got {type(returned).__name__}."
    )


def _figures(trial: Trial, figures: Mapping[str, Any]) -> Row:
    """Return figures as columns, under names that no other column has."""
    taken = {*trial.point, *COLUMNS}
    column = lambda name: f"{name} of the trial" if name in taken else name
    return {column(str(name)): _figure(name, v) for name, v in figures.items()}


def _figure(name: str, value: Any) -> bool | float | int | str | None:
    if isinstance(value, np.ndarray | np.generic | jax.Array) and np.ndim(value) == 0:
        value = np.asarray(value).item()
    if isinstance(value, int) and abs(value) >= 2**63:  # no column has larger ones
        value = float(value) if abs(value) < 2**1023 else math.inf
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if value is None or isinstance(value, str | int):
        return value
    raise TypeError(
        f"figure {name!r} must be a number or a word, got {type(value).__name__}; give "
        "each entry of an array a name of its own."
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
    row: Row | None

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


def progress_of(
    total: int, before: Sequence[str], rows: Iterable[Row]
) -> Iterator[Progress]:
    """Count the trials of a run as they end, after those that had ended before it.

    `before` holds the states of those. The first progress is that of the beginning.
    """
    states, workers = Counter(before), set()
    ends: deque[tuple[float, bool]] = deque(maxlen=WINDOW)
    rate = None
    for row in chain([None], rows):
        if row is not None:
            states[row["state"]] += 1
            # The first trial of a worker compiles for all of its later ones.
            ends.append((time.monotonic(), row["worker"] in workers))
            workers.add(row["worker"])
            # The rate counts from the end of the oldest of the recent trials.
            times, counts = zip(*ends, strict=True)
            n, span = sum(counts[1:]), times[-1] - times[0]
            rate = n / span if n and span else None
        yield Progress(
            total=total,
            ended=states.total(),
            before=len(before),
            not_converged=states["not converged"],
            failed=states["failed"],
            rate=rate,
            row=row,
        )
