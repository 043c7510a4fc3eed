"""What a `watch` of a calibration is told, one kind at a time."""

from collections.abc import Callable
from typing import Any


def only(kind: type, tell: Callable[[Any], None]) -> Callable[[Any], None]:
    """A `watch` that passes on events of one kind."""
    return lambda event: tell(event) if isinstance(event, kind) else None
