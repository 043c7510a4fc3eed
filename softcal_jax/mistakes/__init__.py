"""Mistakes that people make, tried where the model contradicts the data."""

from softcal_jax.mistakes._mistake import Kind as Kind, Mistake as Mistake
from softcal_jax.mistakes._search import likely_mistakes as likely_mistakes
