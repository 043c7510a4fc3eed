"""Values as a user types them: axes by letters, vectors as lists."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import ArrayLike

from softcal_jax._typing import Float, HostArray


class Unstated(float):
    """A default standard deviation, which weighs data but states nothing of them."""


def parse_axes(axes: str) -> list[int]:
    """Return the indices of the axes in a word like "xz"."""
    if not axes or set(axes) - set("xyz") or len(set(axes)) != len(axes):
        raise ValueError(
            'axes must be made of the letters x, y, z, like "xyz" or "z", '
            f"got {axes!r}."
        )
    return ["xyz".index(letter) for letter in axes]


def three_numbers(name: str, unit: str, value) -> Float[HostArray, "3"]:
    """Convert a vector to an array, and check it."""
    vector = np.asarray(value, float)
    if vector.shape != (3,) or not np.all(np.isfinite(vector)):
        raise ValueError(
            f"{name} must be three finite numbers [{unit}], got {value!r}."
        )
    return vector


def as_floats(value: Float[ArrayLike, "..."] | Sequence) -> Float[HostArray, "..."]:
    """Convert numbers to an array, as a converter of fields."""
    return np.asarray(value, float)


def optional_floats(
    value: Float[ArrayLike, "..."] | Sequence | None,
) -> Float[HostArray, "..."] | None:
    """Convert numbers to an array if there are any, as a converter of fields."""
    return None if value is None else as_floats(value)
