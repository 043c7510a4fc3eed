"""Range checks of material constants, at construction and only on concrete values."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike

from softcal_jax._typing import Array, Float, is_traced


def as_field(value: Float[ArrayLike, "..."]) -> Float[Array, "..."]:
    """A constant, or one value per tet, as a floating-point array."""
    return jnp.asarray(value, float)


def _concrete(value: Float[Array, "..."]) -> np.ndarray | None:
    """The values on the host, at least one; None while they are traced."""
    if is_traced(value) or not hasattr(value, "shape"):
        return None
    return np.atleast_1d(np.asarray(value))


def check_modulus(name: str, value: Float[Array, "..."]) -> None:
    """Raise ValueError unless every modulus is positive and finite [Pa]."""
    values = _concrete(value)
    if values is None:
        return
    bad = ~(np.isfinite(values) & (values > 0))
    if np.any(bad):
        raise ValueError(
            f"{name} must be positive and finite [Pa], got {values[bad][0]:g}."
        )


def check_poisson_ratio(name: str, value: Float[Array, "..."]) -> None:
    """Raise ValueError unless every ratio lies in (-1, 0.5)."""
    values = _concrete(value)
    if values is None:
        return
    bad = ~((values > -1.0) & (values < 0.5))
    if np.any(bad):
        hint = (
            " For an incompressible rubber take 0.499." if values.max() >= 0.5 else ""
        )
        raise ValueError(f"{name} must lie in (-1, 0.5), got {values[bad][0]:g}.{hint}")
