"""A mistake that would explain the data."""

import math
from typing import Literal

from softcal_jax._module import Module

Kind = Literal[
    "lost marker",
    "swapped markers",
    "swapped poses",
    "wrong sign",
    "turned frame",
    "mirrored frame",
    "wrong factor",
    "longer clamp",
]
"""What people do."""


class Mistake(Module):
    """A mistake, and what the residuals would be without it.

    Attributes:
        kind: What it is.
        change: What would have to change, like "Swapping markers mid and end in all
            poses".
        rms_before: Root mean square of the distances between measured and simulated
            points in the fitted configurations; nan without points [m].
        rms_after: The same after the change and another fit [m].
        errors_before: Root mean square of all errors, in stated standard deviations and
            without what offsets of recordings and attachments explain [-].
        errors_after: The same after the change and another fit [-].
    """

    kind: Kind
    change: str
    rms_before: float
    rms_after: float
    errors_before: float
    errors_after: float

    @property
    def sentence(self) -> str:
        """What the change would do, in a sentence."""
        before, after = 1e3 * self.rms_before, 1e3 * self.rms_after
        unit = "mm"
        if math.isnan(before):
            before, after = self.errors_before, self.errors_after
            unit = "standard deviations"
        return (
            f"{self.change} would bring the residuals from {before:.2g} {unit} to "
            f"{after:.2g} {unit}."
        )

    def __str__(self) -> str:
        """Write its sentence."""
        return self.sentence
