"""How notebooks show a result: the package says what writes it, which is far above."""

from collections.abc import Callable

html_of: Callable[[object], str | None] = lambda result: None
"""Writes the HTML of a result; `softcal_jax` sets it to that of its report."""
