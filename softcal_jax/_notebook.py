"""What a result says: through hooks, since the report imports this module."""

from collections.abc import Callable

html_of: Callable[[object], str | None] = lambda result: None
"""Writes the HTML of a result; `softcal_jax` sets it to that of its report."""

text_of: Callable[[object], str] = object.__repr__
"""Writes the text of a result, likewise."""

headline_of: Callable[[object], str] = lambda result: ""
"""Says what a result comes to, in a sentence or two, likewise."""
