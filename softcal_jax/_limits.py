"""Limits on what is read and run; environment variables raise them.

A file cannot raise them: it may be somebody else's, or hold the slip that they catch.
"""

import os
from typing import NamedTuple


class LimitError(ValueError):
    """There is more of something than is read or run; the text names the remedy."""


class Limit(NamedTuple):
    """The largest number of something, above which it is taken for a mistake.

    It is `usual`, unless the environment variable `variable` holds another number.
    """

    variable: str
    usual: int
    unit: str

    @property
    def most(self) -> float:
        """The limit that is in force."""
        text = os.environ.get(self.variable, "").strip()
        try:
            most = float(text or self.usual)
        except ValueError:
            most = 0.0
        if not most > 0.0:
            raise ValueError(
                f"the environment variable {self.variable} is {text!r}; expected a "
                f"number of {self.unit}, like {self.usual}."
            )
        return most

    def check(self, what: str, n: float) -> None:
        """Raise LimitError if `n` is above the limit; `what` opens the message."""
        if n > self.most:
            raise self.error(what, n)

    def error(self, what: str, n: float) -> LimitError:
        """Return the error that says that `n` is above the limit."""
        return LimitError(
            f"{what}: {_shown(n)} {self.unit}, more than the limit of "
            f"{_shown(self.most)}. If that is meant, raise the limit with the "
            f"environment variable {self.variable}."
        )


def _shown(n: float) -> str:
    return f"{min(n, 1e300):.3g}" if n >= 1e9 else f"{n:,.15g}".replace(",", " ")


# Tets of a mesh; a million quadratic ones take more than 10 GB to solve.
TETS = Limit("SOFTCAL_MAX_TETS", 2_000_000, "tets")
# Trials of a sweep in one database or part, and starts of a calibration.
TRIALS = Limit("SOFTCAL_MAX_TRIALS", 100_000, "trials")
# Trials of a sweep that runs in parts.
PLANNED = Limit("SOFTCAL_MAX_PLANNED", 10_000_000, "trials")
# Size of a file that is read, and of what is packed in it [MB].
MEGABYTES = Limit("SOFTCAL_MAX_FILE_MB", 100, "MB")
# Time and memory that filling a CAD model takes; a damaged one may take any.
MESHING_SECONDS = Limit("SOFTCAL_MAX_MESHING_S", 600, "s")
MESHING_MEGABYTES = Limit("SOFTCAL_MAX_MESHING_MB", 8000, "MB")
