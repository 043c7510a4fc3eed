"""Constants of a material: their declaration, their values and checks of these."""

import dataclasses
import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike

from softcal_jax._module import key
from softcal_jax._typing import Array, Float, is_traced
from softcal_jax._units import readable

Constant = Float[Array, "..."]
"""A constant of a law: one value, or one per tet."""


def as_field(value: Float[ArrayLike, "..."]) -> Constant:
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


def as_matrix(components: tuple[Float[Array, "..."], ...]) -> Float[Array, "3 3 ..."]:
    """Stack the nine fields of `as_components` to a matrix, or one per tet."""
    return jnp.stack([jnp.stack(components[3 * i : 3 * i + 3]) for i in range(3)])


class ConstantKind(NamedTuple):
    """What is known of constants of a kind before anything is measured.

    Attributes:
        uncertain: Field of `Uncertain` with the standard deviation of one that no
            parameter sets; empty if its error is not considered.
        relative: Whether that is relative to the value.
        most: What it cannot exceed; its error is at most half of what is left to it.
        locks: Value from which on tets of the displacement formulation lock.
        acts_by: Array of a configuration without which it has no effect.
        asked: Standard error that is asked for by a precision of 1, in SI units; the
            value itself by default.
    """

    uncertain: str = ""
    relative: bool = False
    most: float = math.inf
    locks: float = math.inf
    acts_by: str = ""
    asked: float | None = None


UNREMARKABLE, ANGLE = ConstantKind(), ConstantKind(asked=1.0)


def constant(
    unit: str,
    words: str,
    *,
    within: tuple[float, float] | None = None,
    may_vanish: bool = False,
    kind: ConstantKind | None = None,
) -> dict[str, Any]:
    """Build the metadata by which project files offer a field of a law as a constant.

    Args:
        unit: SI unit, like "Pa"; "" for a plain number, "rad" for the angle of an axis.
        words: What it is, with an example: 'bulk modulus: "2 MPa"'.
        within: Open interval that the bounds of a parameter must lie in; by default
            all positive values of a modulus, and all values of a number or an angle.
        may_vanish: Whether 0 is allowed too, as for a body without fibres.
        kind: What is known of it: `POISSON` for a Poisson's ratio.
    """
    if within is None:
        within = (-math.inf if unit in ("", "rad") else 0.0, math.inf)
    if kind is None:
        kind = ANGLE if unit == "rad" else UNREMARKABLE
    above = "not negative" if may_vanish else "positive"
    signed = within[0] < 0.0
    size = "finite" if signed else above
    # Moduli are positive, so that steps of their parameters are ratios.
    scale = "linear" if signed or unit in ("", "rad") else "log"
    return key(unit, words, size, kind=kind, within=within, scale=scale)


POISSON = ConstantKind("nu", most=0.5, locks=0.49, asked=0.5)
CONTRACTION = ConstantKind("nu", most=0.5, asked=0.5)
"""A ratio of an anisotropic law, which does not make it incompressible by itself."""


DENSITY = constant(
    "kg/m3",
    'mass density: "1070 kg/m^3"',
    may_vanish=True,
    kind=ConstantKind("density", relative=True, acts_by="gravity"),
)

MODULUS = constant("Pa", 'Young\'s modulus: "200 kPa"')
ACROSS = constant("Pa", 'Young\'s modulus across the fibre: "700 kPa"')
ALONG = constant("Pa", 'Young\'s modulus along the fibre: "400 kPa"')
FIBRES = constant("Pa", 'modulus that fibres add along them: "20 MPa"', may_vanish=True)
SHEAR = constant("Pa", 'shear modulus along the fibre: "200 kPa"')
PLANE_RATIO = constant(
    "",
    "Poisson's ratio in the plane across the fibre: 0.3",
    within=(-1.0, 1.0),
    kind=CONTRACTION,
)
RATIO = constant("", "Poisson's ratio: 0.499", within=(-1.0, 0.5), kind=POISSON)


def _concrete(values: Any) -> np.ndarray | None:
    """Return the values on the host; None if they are traced."""
    if is_traced(values) or not hasattr(values, "shape"):
        return None
    return np.atleast_1d(np.asarray(values))


def check_constants(module: eqx.Module) -> None:
    """Raise ValueError unless every constant lies where its field says.

    A plain number without an interval is checked elsewhere, together with others.
    """
    for field in dataclasses.fields(module):
        low, high = field.metadata.get("within", (-math.inf, math.inf))
        unit = field.metadata.get("unit")
        values = _concrete(getattr(module, field.name))
        if values is None or not (unit or math.isfinite(low)):
            continue
        may_vanish = field.metadata.get("size") == "not negative"
        allowed = (values > low) & (values < high) | (values == 0.0) & may_vanish
        bad = values[~allowed]
        if not bad.size:
            continue
        expected, hint = f"lie in ({low:g}, {high:g})", ""
        if math.isinf(high):
            sign = "not negative and " if may_vanish else "positive and "
            expected = f"be {sign if low == 0.0 else ''}finite [{unit}]"
        elif field.metadata.get("kind") == POISSON and high == 0.5 <= values.max():
            hint = " For an incompressible rubber take 0.499."
        raise ValueError(f"{field.name} must {expected}, got {bad[0]:g}.{hint}")


def check_ratio(law: Any, name: str, given: Sequence[str], limits: Callable) -> None:
    """Raise ValueError unless a ratio lies between limits that other constants give."""
    concrete = {key: _concrete(getattr(law, key)) for key in (*given, name)}
    known = {key: values for key, values in concrete.items() if values is not None}
    if len(known) < len(concrete):
        return
    try:
        others = dict(zip(known, np.broadcast_arrays(*known.values()), strict=True))
    except ValueError as error:
        counts = ", ".join(f"{key} {len(values)}" for key, values in known.items())
        raise ValueError(
            f"Fields of a law must hold one value or one per tet, got {counts} values."
        ) from error
    ratio = others.pop(name)
    units = {f.name: f.metadata.get("unit", "") for f in dataclasses.fields(law)}
    low, high = limits(**others)
    for i in np.flatnonzero(~((ratio > low) & (ratio < high))):
        pairs = [(key, readable(float(v[i]), units[key])) for key, v in others.items()]
        raise ValueError(
            f"{name} must lie in ({low[i]:.4g}, {high[i]:.4g}) for "
            f"{', '.join(map(' = '.join, pairs))}, or the stiffness is not positive "
            f"definite; got {ratio[i]:g}."
        )
