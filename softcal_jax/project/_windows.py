"""Tables of a project file that say which times of a recording are averaged."""

from typing import Annotated

from pydantic import model_validator

from softcal_jax.configurations import MarkerTable, Recording
from softcal_jax.project._sensors import Selection
from softcal_jax.project._table import Choice, Table, Time

_KINDS = ("between", "at", "plateau")
"""What a window of time is given by; each has a method of `Recording`."""


class WindowTable(Table):
    """A window of time of a recording, over which positions are averaged.

    It is `between` two times, of a `width` around the time `at`, or a `plateau` of that
    least length, which is looked for. Times count from the step of a marker or from an
    event of the file, if one is named.
    """

    between: tuple[Time, Time] | None = None
    at: Time | None = None
    width: Time | None = None
    plateau: Time | None = None
    after_step_of: str | None = None
    after_event: str | None = None

    @model_validator(mode="after")
    def _check(self) -> "WindowTable":
        given = [key for key in _KINDS if getattr(self, key) is not None]
        if len(given) != 1:
            raise ValueError(
                f"got {' and '.join(given) or 'no time'}; expected one of between = "
                '["1.2 s", "1.4 s"], at = "1.3 s", plateau = "0.5 s". A key of '
                "[shared] holds as well: where configurations differ in it, give each "
                "its own."
            )
        if self.width is not None and self.at is None:
            raise ValueError("width is for the window around `at`.")
        return self

    def of(self, recording: Recording) -> MarkerTable:
        """Average a recording over the window."""
        after = self.model_dump(include={"after_step_of", "after_event"})
        if self.between is not None:
            return recording.between(*self.between, **after)
        if self.plateau is not None:
            return recording.plateau(self.plateau, **after)
        assert self.at is not None
        width = {} if self.width is None else {"width": self.width}
        return recording.at(self.at, **width, **after)


def _is_window(value: object) -> bool:
    """Tell a window from values of columns: one may be named like a key of it."""
    if not isinstance(value, dict) or not {*_KINDS} & {*value}:
        return False
    return isinstance(value.get("between"), list) or {*value} <= {
        *WindowTable.model_fields
    }


Which = Annotated[
    WindowTable | Selection,
    Choice(lambda value, kinds: kinds[0 if _is_window(value) else 1]),
]
"""What is taken of a file: a window of a recording, or rows of a table."""

WhichOrName = Annotated[
    Which | str, Choice(lambda value, kinds: kinds[1 if isinstance(value, str) else 0])
]
