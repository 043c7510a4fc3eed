"""Constants of a material: their declaration, their values and checks of these."""

import dataclasses
import math
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike

from softcal_jax._module import Module
from softcal_jax._typing import Array, Float, is_traced
from softcal_jax._units import readable


def as_field(value: Float[ArrayLike, "..."]) -> Float[Array, "..."]:
    """Convert a constant, or one value per tet, to a floating-point array."""
    return jnp.asarray(value, float)


def as_components(matrices: Any) -> tuple[Float[Array, "..."], ...]:
    """Convert 3x3 matrices, one or one per tet, to nine fields row by row."""
    if isinstance(matrices, tuple):
        return matrices
    rows = np.asarray(matrices, float)
    # Not jnp.asarray of a part, which would compile a program for every shape.
    parts = (np.array(rows[..., i, j]) for i, j in np.ndindex(3, 3))
    return jax.device_put(tuple(parts))


class PointValues(Module):
    """One value per tet and quadrature point, in place of a constant of a law.

    Attributes:
        values: The values by tet, then by the points of `Model.shape_gradients`.
    """

    values: Float[Array, "*tets n_qp"]


def as_matrix(components: tuple[Float[Array, "..."], ...]) -> Float[Array, "3 3 ..."]:
    """Stack the nine fields of `as_components` to a matrix, or one per tet."""
    return jnp.stack([jnp.stack(components[3 * i : 3 * i + 3]) for i in range(3)])


def is_point_values(leaf: Any) -> bool:
    """Say whether a constant of a law is given per quadrature point."""
    return isinstance(leaf, PointValues)


def law_at_points(law: Any) -> tuple[Any, Any]:
    """Replace `PointValues` of a tet's law by arrays; return also the axes for `vmap`.

    These are a tree of the same structure: 0 for values per point, else None.
    """
    plain = jax.tree.map(
        lambda leaf: leaf.values if is_point_values(leaf) else leaf,
        law,
        is_leaf=is_point_values,
    )
    axes = jax.tree.map(
        lambda leaf: 0 if is_point_values(leaf) else None, law, is_leaf=is_point_values
    )
    return plain, axes


def constant(
    unit: str,
    words: str,
    *,
    within: tuple[float, float] | None = None,
    may_vanish: bool = False,
) -> dict[str, Any]:
    """Build the metadata that declare a field of a law as a constant.

    Project files offer the constant by them.

    Args:
        unit: SI unit, like "Pa"; "" for a plain number, "rad" for the angle of an axis.
        words: What it is, with an example: 'bulk modulus: "2 MPa"'.
        within: Open interval that the bounds of a parameter must lie in; by default
            what is positive for a modulus, and anything for a number or an angle.
        may_vanish: Whether 0 is allowed too, as for a body without fibres.
    """
    if within is None:
        within = (-math.inf if unit in ("", "rad") else 0.0, math.inf)
    return {"unit": unit, "words": words, "within": within, "may_vanish": may_vanish}


MODULUS = constant("Pa", 'Young\'s modulus: "200 kPa"')
ACROSS = constant("Pa", 'Young\'s modulus across the fibre: "700 kPa"')
ALONG = constant("Pa", 'Young\'s modulus along the fibre: "400 kPa"')
FIBRES = constant("Pa", 'modulus that fibres add along them: "20 MPa"', may_vanish=True)
SHEAR = constant("Pa", 'shear modulus along the fibre: "200 kPa"')
PLANE_RATIO = constant(
    "", "Poisson's ratio in the plane across the fibre: 0.3", within=(-1.0, 1.0)
)
RATIO = constant("", "Poisson's ratio: 0.499", within=(-1.0, 0.5))


def _concrete(value: Any) -> np.ndarray | None:
    """Return the values on the host; None if they are traced."""
    values = value.values if is_point_values(value) else value
    if is_traced(values) or not hasattr(values, "shape"):
        return None
    return np.atleast_1d(np.asarray(values))


def check_constants(module: eqx.Module) -> None:
    """Raise ValueError unless every constant lies where its field says.

    A plain number without an interval is left to checks together with others.
    """
    for field in dataclasses.fields(module):
        low, high = field.metadata.get("within", (-math.inf, math.inf))
        unit = field.metadata.get("unit")
        values = _concrete(getattr(module, field.name))
        if values is None or not (unit or math.isfinite(low)):
            continue
        may_vanish = field.metadata.get("may_vanish", False)
        allowed = (values > low) & (values < high) | (values == 0.0) & may_vanish
        bad = values[~allowed]
        if not bad.size:
            continue
        expected, hint = f"lie in ({low:g}, {high:g})", ""
        if math.isinf(high):
            sign = "not negative and " if may_vanish else "positive and "
            expected = f"be {sign if low == 0.0 else ''}finite [{unit}]"
        elif high == RATIO["within"][1] and values.max() >= high:
            hint = " For an incompressible rubber take 0.499."
        raise ValueError(f"{field.name} must {expected}, got {bad[0]:g}.{hint}")


def _together(**fields: Float[Array, "..."]) -> list[np.ndarray] | None:
    """Broadcast values on the host to one list each; None if one is traced."""
    values = {name: _concrete(value) for name, value in fields.items()}
    known = {name: value for name, value in values.items() if value is not None}
    if len(known) < len(values):
        return None
    sizes = {name: len(value) for name, value in known.items() if len(value) > 1}
    if len(set(sizes.values())) > 1:
        counts = ", ".join(f"{name} {size}" for name, size in sizes.items())
        raise ValueError(
            f"Fields of a law must hold one value or one per tet, got {counts} values."
        )
    columns = [value.reshape(len(value), -1) for value in known.values()]
    return [values.ravel() for values in np.broadcast_arrays(*columns)]


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
    bad = np.flatnonzero(~(np.abs(ratio) < limit))
    if bad.size:
        i = bad[0]
        raise ValueError(
            f"nu_tl must lie in (-{limit[i]:.4g}, {limit[i]:.4g}) for "
            f"{_moduli(stiff_t[i], stiff_l[i])}, nu_t = {plane[i]:g}, or the stiffness "
            f"is not positive definite; got {ratio[i]:g}."
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
    bad = np.flatnonzero(~((ratio > low) & (ratio < high)))
    if bad.size:
        i = bad[0]
        raise ValueError(
            f"nu must lie in ({low[i]:.4g}, {high[i]:.4g}) for "
            f"{_moduli(stiff_t[i], stiff_l[i])}, got {ratio[i]:g}."
        )


def _moduli(E_t: Any, E_l: Any) -> str:
    return f"E_t = {readable(E_t, 'Pa')}, E_l = {readable(E_l, 'Pa')}"
