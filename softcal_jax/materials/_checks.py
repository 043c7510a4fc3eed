"""Constants of a material, and their checks on concrete values at construction."""

import math
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike

from softcal_jax._typing import Array, Float, is_traced


def as_field(value: Float[ArrayLike, "..."]) -> Float[Array, "..."]:
    """Convert a constant, or one value per tet, to a floating-point array."""
    return jnp.asarray(value, float)


def constant(
    unit: str, words: str, *, within: tuple[float, float] | None = None
) -> dict[str, Any]:
    """What the metadata of a field of a law say of a constant; project files read it.

    Args:
        unit: SI unit, like "Pa"; "" for a plain number, "rad" for the angle of an axis.
        words: What it is, with an example: 'bulk modulus: "2 MPa"'.
        within: Open interval that the bounds of a parameter must lie in; by default
            what is positive for a modulus, and anything for a number or an angle.
    """
    if within is None:
        within = (-math.inf if unit in ("", "rad") else 0.0, math.inf)
    return {"unit": unit, "words": words, "within": within}


MODULUS = constant("Pa", 'Young\'s modulus: "200 kPa"')
ACROSS = constant("Pa", 'Young\'s modulus across the fibre: "700 kPa"')
ALONG = constant("Pa", 'Young\'s modulus along the fibre: "400 kPa"')
SHEAR = constant("Pa", 'shear modulus along the fibre: "200 kPa"')
RATIO = constant("", "Poisson's ratio: 0.499", within=(-1.0, 0.5))


def _concrete(value: Float[Array, "..."]) -> np.ndarray | None:
    """Return the values on the host; None if they are traced."""
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


def check_finite(name: str, value: Float[Array, "..."], unit: str) -> None:
    """Raise ValueError unless every value is finite."""
    values = _concrete(value)
    if values is not None and not np.all(np.isfinite(values)):
        bad = values[~np.isfinite(values)][0]
        raise ValueError(f"{name} must be finite [{unit}], got {bad:g}.")


def _together(**fields: Float[Array, "..."]) -> list[np.ndarray] | None:
    """Broadcast values on the host against each other; None if one is traced."""
    values = {name: _concrete(value) for name, value in fields.items()}
    known = [value for value in values.values() if value is not None]
    if len(known) < len(values):
        return None
    sizes = {name: v.size for name, v in values.items() if v is not None and v.size > 1}
    if len(set(sizes.values())) > 1:
        counts = ", ".join(f"{name} {size}" for name, size in sizes.items())
        raise ValueError(
            f"Fields of a law must hold one value or one per tet, got {counts} values."
        )
    return list(np.broadcast_arrays(*known))


def check_plane_ratio(name: str, value: Float[Array, "..."]) -> None:
    """Raise ValueError unless every ratio in the transverse plane is in (-1, 1)."""
    values = _concrete(value)
    if values is None:
        return
    bad = ~(np.abs(values) < 1.0)
    if np.any(bad):
        raise ValueError(f"{name} must lie in (-1, 1), got {values[bad][0]:g}.")


def check_fibre_ratio(
    E_t: Float[Array, "..."],
    E_l: Float[Array, "..."],
    nu_t: Float[Array, "..."],
    nu_tl: Float[Array, "..."],
) -> None:
    """Raise ValueError unless nu_tl^2 < (1 - nu_t) E_t / (2 E_l) everywhere."""
    values = _together(E_t=E_t, E_l=E_l, nu_t=nu_t, nu_tl=nu_tl)
    if values is None:
        return
    stiff_t, stiff_l, plane, ratio = values
    limit = np.sqrt((1.0 - plane) * stiff_t / (2.0 * stiff_l))
    bad = ~(np.abs(ratio) < limit)
    if np.any(bad):
        i = int(np.argmax(bad))
        raise ValueError(
            f"nu_tl must lie in (-{limit[i]:.4g}, {limit[i]:.4g}) for E_t = "
            f"{stiff_t[i]:g} Pa, E_l = {stiff_l[i]:g} Pa, nu_t = {plane[i]:g}, or the "
            f"stiffness is not positive definite; got {ratio[i]:g}."
        )


def check_shared_ratio(
    E_t: Float[Array, "..."], E_l: Float[Array, "..."], nu: Float[Array, "..."]
) -> None:
    """Raise ValueError unless nu_t = nu_tl = nu gives a stable law everywhere."""
    values = _together(E_t=E_t, E_l=E_l, nu=nu)
    if values is None:
        return
    stiff_t, stiff_l, ratio = values
    n = stiff_l / stiff_t
    # The roots of 1 - nu - 2 n nu^2, and |nu_t| < 1.
    low = np.maximum(-1.0, -(1.0 + np.sqrt(1.0 + 8.0 * n)) / (4.0 * n))
    high = 2.0 / (1.0 + np.sqrt(1.0 + 8.0 * n))
    bad = ~((ratio > low) & (ratio < high))
    if np.any(bad):
        i = int(np.argmax(bad))
        raise ValueError(
            f"nu must lie in ({low[i]:.4g}, {high[i]:.4g}) for E_t = {stiff_t[i]:g} "
            f"Pa, E_l = {stiff_l[i]:g} Pa, got {ratio[i]:g}."
        )
