"""How notebooks show a result: through hooks, since the report imports this module."""

from collections.abc import Callable

html_of: Callable[[object], str | None] = lambda result: None
"""Writes the HTML of a result; `softcal_jax` sets it to that of its report."""

text_of: Callable[[object], str] = object.__repr__
"""Writes the text of a result, likewise."""
