"""Which parameters belong together: order constraints and material axes."""

from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from softcal_jax._module import Module
from softcal_jax._text import unknown_name
from softcal_jax._typing import Array, Float, HostArray, Int, is_traced
from softcal_jax.fields._control_points import ControlPointParameters
from softcal_jax.fields._parameters import AbstractEntry, Parameter, Values

Entries = tuple[AbstractEntry, ...]

Groups = tuple[tuple[str, ...], ...]
"""Names that belong together: pairs of an order, triples of an axis."""

Scaled = Float[Array, " n_p"]
"""Scaled coordinates z of the parameters, or one number for each."""


class Term(NamedTuple):
    """One side of an inequality: unit * z[column], or a known constant."""

    name: str
    scale: str
    column: int | None
    unit: Float[Array, ""]
    constant: Float[Array, ""]


def order_terms(entries: Entries, order: Groups) -> list[tuple[Term, Term]]:
    """Collect both sides of every inequality smaller <= larger.

    One pair per control point of two fields, or per pair of parameters, except for
    pairs of known values.
    """
    pairs = []
    for smaller, larger in order:
        if smaller == larger:
            raise ValueError(f"order ({smaller!r}, {larger!r}): name two parameters.")
        left, right = (_sides(entries, name, "order") for name in (smaller, larger))
        shared = [key for key in left if key in right]
        if not shared:
            raise ValueError(
                f"order ({smaller!r}, {larger!r}): the two have no control point in "
                f"common ({', '.join(left)} and {', '.join(right)})."
            )
        for key in shared:
            small, large = left[key], right[key]
            if small.scale != large.scale:
                raise ValueError(
                    f"order ({smaller!r}, {larger!r}): give both the same scale; got "
                    f"{small.scale!r} and {large.scale!r}."
                )
            if small.column is not None or large.column is not None:
                pairs.append((small, large))
            elif is_traced(small.constant) or is_traced(large.constant):
                continue
            elif float(small.constant) > float(large.constant):
                raise ValueError(
                    f"order: {small.name} <= {large.name}, but both are fixed, the "
                    "first above the second."
                )
    return pairs


def _sides(entries: Entries, name: str, key: str) -> dict[str, Term]:
    """Return the terms of a parameter, or of a field by control point.

    Errors call the option that names it `key`.
    """
    parameters = [q for entry in entries for q in entry.parameters]
    columns = {q.name: i for i, q in enumerate(parameters)}

    def unknown(column: int) -> Term:
        q = parameters[column]
        return Term(q.name, q.scale, column, q.unit_step, jnp.zeros(()))

    if name in columns:
        return {"": unknown(columns[name])}
    fields = [entry for entry in entries if isinstance(entry, ControlPointParameters)]
    sides: dict[str, Term] = {}
    for entry in fields:
        if entry.field != name:
            continue
        for point in entry.control_points.names:
            if point in sides:
                raise ValueError(
                    f"{name} has two values at control point {point!r}, in "
                    "different regions: give their control points different names."
                )
            if point in entry.fixed:
                value = entry.fixed[point]
                known = jnp.log(value) if entry.scale == "log" else value
                label = f"{name} of {point}"
                sides[point] = Term(label, entry.scale, None, jnp.ones(()), known)
            else:
                sides[point] = unknown(columns[entry.parameter_name(point)])
    if not sides:
        known = {*(entry.field for entry in fields), *columns}
        raise ValueError(f"{key}: {unknown_name('parameter or field', name, known)}")
    return sides


class Region(Module):
    """Values that fields may have together at a control point: A ln(values) <= b.

    Where the fields mix logarithms with the same weights, no tet leaves it either.

    Attributes:
        fields: Names of the fields, on a log scale and with the same control points.
        A: Its half-planes, a row of unit length each [-].
        b: How far each lies from the origin [-].
        centre: Logarithms of values inside, to which others are drawn.
        name: What has these values, like "Polyfoam".
    """

    fields: tuple[str, ...] = eqx.field(static=True)
    A: Float[Array, "n_rows n_fields"] = eqx.field(converter=jnp.asarray)
    b: Float[Array, " n_rows"] = eqx.field(converter=jnp.asarray)
    centre: Float[Array, " n_fields"] = eqx.field(converter=jnp.asarray)
    name: str = eqx.field(static=True, default="region")


class Likeness(Module):
    """Differences of values at neighbouring control points that count like errors.

    Attributes:
        A: Differences of scaled parameters, one row for each pair [-].
        b: The known one of two values, 0 if both are unknown [-].
        turn: Difference after which an angle is the same again; infinite for others.
        std: Difference that counts as much as an error of one standard deviation [-].
    """

    A: Float[Array, "n_pairs n_p"]
    b: Float[Array, " n_pairs"]
    turn: Float[Array, " n_pairs"]
    std: Float[Array, " n_pairs"]

    def rows(
        self, z: Scaled
    ) -> tuple[Float[Array, " n_pairs"], Float[Array, "n_pairs n_p"]]:
        """Return the differences over their `std`, and their derivatives by z [-]."""
        gap = self.A @ z - self.b
        finite = jnp.where(jnp.isinf(self.turn), 1.0, self.turn)
        gap = gap - jnp.where(
            jnp.isinf(self.turn), 0.0, finite * jnp.round(gap / finite)
        )
        return gap / self.std, self.A / self.std[:, None]


def region_terms(
    entries: Entries, regions: tuple[Region, ...]
) -> list[tuple[Region, tuple[Term, ...]]]:
    """Collect the terms of the fields of each region, for each control point."""
    terms = []
    for region in regions:
        sides = [_sides(entries, field, "regions") for field in region.fields]
        for other in sides:
            if list(other) != list(sides[0]):
                fields = " and ".join(region.fields)
                raise ValueError(f"regions: {fields} need the same control points.")
        for entry in entries:
            if {*entry.fields} & {*region.fields} and (
                entry.parameters[0].scale != "log"
                or getattr(entry, "interpolation", "log") != "log"
            ):
                raise ValueError(
                    f'regions: {entry.label} needs scale="log" and '
                    'interpolation="log", so that no tet leaves the values that '
                    f"{region.name} has."
                )
        points = zip(*(side.values() for side in sides), strict=True)
        terms += [(region, of_point) for of_point in points]
    return terms


def axis_columns(entries: Entries, axes: Groups) -> Int[HostArray, "n_axes 3"]:
    """Find the columns of (smaller modulus, larger modulus, angle) of every axis.

    One row per control point at which all three are unknown.
    """
    rows: list[list[int]] = []
    parameters = [q for entry in entries for q in entry.parameters]
    for axis in axes:
        sides = [_sides(entries, name, "axes") for name in axis]
        unknown = []
        for key in sides[0]:
            columns = [s[key].column if key in s else None for s in sides]
            known = [column for column in columns if column is not None]
            # If all three are tied, another control point has given this axis already.
            if len(known) == 3 and known not in unknown:
                unknown.append(known)
                _check_axis(axis, [parameters[i] for i in known])
        if not unknown:
            raise ValueError(
                f"axes {axis}: no control point has all three unknown; give the three "
                "fields the same control points, or leave this axis out."
            )
        rows += unknown
    used = [column for row in rows for column in row]
    for column in used:
        if used.count(column) > 1:
            raise ValueError(
                f"axes: {parameters[column].name!r} belongs to more than one axis."
            )
    return np.array(rows, dtype=int).reshape(-1, 3)


def _check_axis(axis: tuple[str, ...], members: list[Parameter]) -> None:
    angle = members[2]
    if not angle.periodic:
        raise ValueError(
            f"axes {axis}: {angle.name!r} must turn freely: give it "
            'interpolation="director" and bounds that span 180 degrees.'
        )
    for member in members:
        if member is not angle and member.scale != "log":
            raise ValueError(
                f'axes {axis}: {member.name!r} needs scale="log", not {member.scale!r}.'
            )
        if member.max_step is not None:
            raise ValueError(
                f"axes {axis}: {member.name!r} has a max_step, but steps of an axis "
                "are taken as tensors; leave one of the two out."
            )


_NEARLY_ISOTROPIC = 1e-7
"""Smallest d: at 0 the angle and the derivatives along c and s are undefined [-]."""


class AxisChart(NamedTuple):
    """Step coordinates of axes: the components of a tensor, regular at isotropy.

    {E_s, E_l, theta} (smaller and larger modulus, angle of the material axis) are polar
    coordinates of a symmetric tensor in the print plane: with m = (ln E_l + ln E_s) / 2
    and d = (ln E_l - ln E_s) / 2 >= 0, its logarithm has the components

        m,  c = d cos 2 theta,  s = d sin 2 theta.

    Polar coordinates have two traps for a Gauss-Newton step. The angle winds: 181
    degrees is the same axis as 1 degree, but far away. And at E_s = E_l the angle has
    no effect: a fit whose axis is a quarter turn wrong is driven there and stays.
    (m, c, s) avoid both, E_s <= E_l always holds, and a step across the origin turns
    the axis by 90 degrees, as it should. The parameters remain {E_s, E_l, theta}.

    Attributes:
        small: Columns of ln E_s in z, one per axis.
        large: Columns of ln E_l.
        angle: Columns of theta / S.
        S: Scale of the angles [rad].
    """

    small: Int[HostArray, " n_axes"]
    large: Int[HostArray, " n_axes"]
    angle: Int[HostArray, " n_axes"]
    S: Float[Array, " n_axes"]

    def to_tensor(self, z: Scaled) -> Scaled:
        """Replace (ln E_s, ln E_l, theta / S) by (m, c, s)."""
        m = 0.5 * (z[self.large] + z[self.small])
        d = 0.5 * (z[self.large] - z[self.small])
        twice = 2.0 * self.S * z[self.angle]
        z = z.at[self.small].set(m).at[self.large].set(d * jnp.cos(twice))
        return z.at[self.angle].set(d * jnp.sin(twice))

    def from_tensor(self, tensor: Scaled) -> Scaled:
        """Invert `to_tensor`, with angles between -90 and 90 degrees."""
        m, c, s = tensor[self.small], tensor[self.large], tensor[self.angle]
        d = jnp.sqrt(c**2 + s**2)
        theta = 0.5 * jnp.arctan2(s, c) / self.S
        z = tensor.at[self.small].set(m - d).at[self.large].set(m + d)
        return z.at[self.angle].set(theta)

    def clip(self, z: Scaled, lower: Scaled, upper: Scaled) -> Scaled:
        """Clip the moduli to their bounds, keeping them slightly apart."""
        gap = 2.0 * _NEARLY_ISOTROPIC
        s, l = self.small, self.large
        top = jnp.clip(z[l], jnp.maximum(lower[l], lower[s] + gap), upper[l])
        low = jnp.minimum(jnp.clip(z[s], lower[s], upper[s]), top - gap)
        return z.at[s].set(low).at[l].set(top)


Axis = tuple[ControlPointParameters, ControlPointParameters, ControlPointParameters]
"""The fields of an axis: smaller modulus, larger modulus, angle."""


def faded(model: Any, values: Values, axis: Axis) -> Any:
    """Reduce the contrast of the moduli in the cores; their geometric mean stays.

    `model` has the three fields as they would be without a core.
    """
    small, large, angle = axis
    low = jnp.log(small.evaluate(model.mesh, values))
    high = jnp.log(large.evaluate(model.mesh, values))
    middle, half = 0.5 * (high + low), 0.5 * (high - low)
    half = half * angle.contrast(model.mesh, values)
    model = small.set_on(model, jnp.exp(middle - half))
    return large.set_on(model, jnp.exp(middle + half))


def fading_axes(entries: Entries, axes: Groups) -> list[Axis]:
    """Return the axes whose angle has a core."""
    fields = [e for e in entries if isinstance(e, ControlPointParameters)]
    fading = []
    for angle in fields:
        if angle.core == 0.0:
            continue
        axis = next((axis for axis in axes if axis[2] == angle.field), None)
        if axis is None:
            raise ValueError(
                f"{angle.field} has a core, in which the contrast of two moduli fades: "
                f'name them in axes, like ("E_l", "E_t", "{angle.field}").'
            )
        beside = {e.field: e for e in fields if e.region == angle.region}
        for field in axis:
            if field not in beside:
                raise ValueError(
                    f"{angle.field} has a core, and {field} is not set where it is: "
                    f"give both region={angle.region!r}, or leave core out."
                )
        small, large, _ = axis
        fading.append((beside[small], beside[large], angle))
    return fading
