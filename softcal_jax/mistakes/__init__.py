"""Mistakes that people make, tried where the model contradicts the data."""

from softcal_jax.mistakes._search import (
    Mistake as Mistake,
    likely_mistakes as likely_mistakes,
)
