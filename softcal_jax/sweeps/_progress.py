"""Progress of a sweep: trials ended, rate, and time left."""

import time
from collections import Counter, deque
from dataclasses import dataclass
from datetime import timedelta

from softcal_jax.sweeps._row import TrialRow

WINDOW = 50
"""Number of recent trials over which the rate is averaged."""


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
        left = timedelta(seconds=round((self.total - self.ended) / self.rate))
        text += f", {3600.0 * self.rate:.1f} per hour"
        return f"{text}, {left} left" if left else text


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
        return Progress(
            total=self._total,
            ended=self._states.total(),
            before=self._before,
            not_converged=self._states["not converged"],
            failed=self._states["failed"],
            rate=self._rate(),
            row=row,
        )

    def _rate(self) -> float | None:
        """Return trials per second since the end of the oldest of the recent trials."""
        times, counts = zip(*self._ends, strict=True) if self._ends else ((0.0,), ())
        n, span = sum(counts[1:]), times[-1] - times[0]
        return n / span if n and span else None
