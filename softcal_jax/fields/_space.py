"""The space of all calibrated parameters: scaling, bounds, order constraints."""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._module import Module
from softcal_jax._text import check_known, check_unique
from softcal_jax._typing import Array, Bool, Float, HostArray, Int, numpy_of
from softcal_jax.fields._control_points import ControlPointParameters
from softcal_jax.fields._order import (
    AxisChart,
    Groups,
    Likeness,
    Region,
    Scaled,
    Term,
    axis_columns,
    faded,
    fading_axes,
    order_terms,
    region_terms,
)
from softcal_jax.fields._parameters import (
    AbstractEntry,
    Parameter,
    Values,
    from_scale,
    once,
    to_scale,
)

Entry = AbstractEntry


def _groups(groups: Iterable[str | Sequence[str]]) -> Groups:
    return tuple((g,) if isinstance(g, str) else tuple(map(str, g)) for g in groups)


_EXAMPLES = {"order": ("E_l", "E_t"), "axes": ("E_l", "E_t", "theta")}
"""Members of a group: smaller and larger value, and the angle of an axis."""


@partial(jax.jit, static_argnums=(0, 1))
def _each_converted(convert, scales: tuple[str, ...], steps: list[Array], values):
    """Convert all values in one program, which knows no names."""
    each = zip(scales, steps, values, strict=True)
    return jnp.stack([convert(*one) for one in each])


class Pin(Module):
    """A parameter drawn to a scaled value [-], in place of its prior.

    The weight is 1 / tolerated deviation, scaled [-].
    """

    column: Int[Array, ""]
    value: Float[Array, ""]
    weight: Float[Array, ""]


class ParameterSpace(Module):
    """The calibrated parameters, in the order of lambda_p.

    The paper's step p + S lambda_p is z + lambda_p here; on a log scale lambda_p is the
    logarithm of the ratio of new to old value.

    Attributes:
        entries: Single parameters and fields with control points.
        order: Pairs (smaller, larger) of parameter names, or of fields with the same
            control points: ("E_l", "E_t") keeps the fibre the soft axis. They are
            linear constraints of every QP step.
        axes: Triples (smaller modulus, larger modulus, angle) of fields with the same
            control points: ("E_l", "E_t", "theta") for a soft fibre. Their steps are
            taken as tensors, see `AxisChart`: neither winding of the angle nor the
            isotropic state can trap them, and smaller <= larger always holds. If the
            angle has a `core`, their contrast fades in it.
        tensor_steps: Whether steps of axes are taken as tensors; if not, as moduli and
            angles, which need `order`.
        regions: Values that fields may have together, which need steps of moduli.
        likeness: Differences of neighbouring control points that count like errors.
        pin: A parameter held at a value, for a profile of the likelihood.
    """

    entries: tuple[Entry, ...] = eqx.field(converter=tuple)
    order: Groups = eqx.field(static=True, default=(), converter=_groups)
    axes: Groups = eqx.field(static=True, default=(), converter=_groups)
    tensor_steps: bool = eqx.field(static=True, default=True)
    regions: tuple[Region, ...] = eqx.field(default=(), converter=tuple)
    likeness: Likeness | None = None
    pin: Pin | None = None

    def __check_init__(self):
        if not self.parameters:
            raise ValueError("at least one parameter is needed, got none.")
        check_names(self.entries)
        for option, like in _EXAMPLES.items():
            for group in getattr(self, option):
                if len(group) != len(like):
                    raise ValueError(f"{option} takes groups like {like}; got {group}.")
        order_terms(self.entries, self.order)
        axis_columns(self.entries, self.axes)
        fading_axes(self.entries, self.axes)
        region_terms(self.entries, self.regions)
        if self.regions and self.axes and self.tensor_steps:
            raise ValueError("regions need tensor_steps=False: rows are of moduli.")

    @once
    def parameters(self) -> tuple[Parameter, ...]:
        """The unknowns one by one."""
        return tuple(q for entry in self.entries for q in entry.parameters)

    @property
    def names(self) -> list[str]:
        """Names of the parameters."""
        return [parameter.name for parameter in self.parameters]

    def start(self) -> Scaled:
        """Return the scaled start."""
        return self.to_scaled([q.start for q in self.parameters])

    def lower(self) -> Scaled:
        """Return the scaled lower bounds."""
        return self.to_scaled([q.lower for q in self.parameters])

    def upper(self) -> Scaled:
        """Return the scaled upper bounds."""
        return self.to_scaled([q.upper for q in self.parameters])

    def to_scaled(self, p: Scaled | list[Array]) -> Scaled:
        """Convert values p to scaled coordinates z."""
        return self._converted(to_scale, p)

    def from_scaled(self, z: Scaled) -> Scaled:
        """Convert scaled coordinates z to values p."""
        return self._converted(from_scale, z)

    def _converted(self, convert: Any, values: Scaled | list[Array]) -> Scaled:
        self._check_number(values)
        scales = tuple(q.scale for q in self.parameters)
        steps = [q.unit_step for q in self.parameters]
        return _each_converted(convert, scales, steps, values)

    def _check_number(self, values: Scaled | list[Array]) -> None:
        if len(values) != len(self.parameters):
            raise ValueError(
                f"there are {len(values)} values for the {len(self.parameters)} "
                f"parameters ({', '.join(self.names)}); give one for each."
            )

    def slopes(self, z: Float[Array | HostArray, " n_p"]) -> Float[HostArray, " n_p"]:
        """Compute |dp/dz| of each parameter, in its SI unit per unit of z."""
        z = jax.device_put(z)
        one = jax.device_put(np.ones(z.shape))
        _, slopes = jax.jvp(self.from_scaled, (z,), (one,))
        return np.abs(np.asarray(slopes))

    def _if_periodic(self, periodic, otherwise) -> Scaled:
        flags = np.array([q.periodic for q in self.parameters])
        xp = numpy_of(periodic, otherwise)
        return jax.device_put(xp.where(flags, periodic, otherwise))

    def room(self, z: Float[Array | HostArray, " n_p"]) -> tuple[Scaled, Scaled]:
        """Return the largest steps down and up within bounds; infinite if periodic."""
        low, high = self.lower(), self.upper()
        low, high, z = map(numpy_of(low, z).asarray, (low, high, z))
        down = self._if_periodic(-np.inf, low - z)
        return down, self._if_periodic(np.inf, high - z)

    def at_bound(self, z: Float[Array | HostArray, " n_p"]) -> Bool[HostArray, " n_p"]:
        """Tell which parameters are on a bound, up to rounding."""
        down, up = map(np.asarray, self.room(np.asarray(z)))  # compiles nothing
        return (down >= -1e-9) | (up <= 1e-9)

    def max_step(self) -> Scaled:
        """Return the step limits of the parameters, infinite by default."""
        none = jnp.asarray(jnp.inf)
        limits = [none if q.max_step is None else q.max_step for q in self.parameters]
        return jnp.stack(limits)

    def wrap(self, z: Scaled) -> Scaled:
        """Wrap periodic parameters into their bounds."""
        low, high = self.lower(), self.upper()
        return self._if_periodic(low + jnp.mod(z - low, high - low), z)

    def shorter(self, gap: Scaled) -> Scaled:
        """Reduce differences of scaled parameters to the shorter way if periodic."""
        turn = self.upper() - self.lower()
        return self._if_periodic(gap - turn * jnp.round(gap / turn), gap)

    @once
    def chart(self) -> AxisChart | None:
        """Step coordinates of the axes; None without axes or tensor steps."""
        if not (self.axes and self.tensor_steps):
            return None
        small, large, angle = axis_columns(self.entries, self.axes).T
        S = [self.parameters[i].unit_step for i in angle]
        return AxisChart(small, large, angle, jnp.stack(S))

    @once
    def numbered(self) -> "ParameterSpace":
        """The parameters with numbers for names, to compute with; reports need names.

        Names are static in compiled programs, so spaces that only differ in names, like
        two layouts with equally many control points, would compile twice.
        """
        points: dict[str, str] = {}
        names: dict[str, str] = {}
        for entry in self.entries:
            if isinstance(entry, ControlPointParameters):
                for point in entry.control_points.names:
                    number = points.setdefault(point, str(len(points) + 1))
                    names[f"{entry.field} of {point}"] = f"{entry.field} of {number}"
            else:
                for parameter in entry.parameters:
                    names[parameter.name] = f"parameter {len(names) + 1}"

        def rename(groups: Groups) -> Groups:  # an order may name fields as well
            return tuple(tuple(names.get(name, name) for name in g) for g in groups)

        return replace(
            self,
            entries=tuple(entry.renamed(points, names) for entry in self.entries),
            order=rename(self.order),
            axes=rename(self.axes),
        )

    def in_plain_steps(self) -> "ParameterSpace":
        """Return the parameters with steps of moduli and angles instead of tensors.

        Where both moduli of an axis are equal, a step of tensors has a kink, since the
        axis switches there. With their order as a constraint such an optimum is
        regular.
        """
        if self.chart is None:
            return self
        pairs = zip(self.chart.small, self.chart.large, strict=True)
        order = [(self.names[small], self.names[large]) for small, large in pairs]
        return replace(self, order=(*self.order, *order), tensor_steps=False)

    def admissible(self, z: Scaled) -> Scaled:
        """Clip parameters to their bounds, keeping moduli of an axis slightly apart."""
        z = self.wrap(z)
        if self.chart is not None:
            z = self.chart.clip(z, self.lower(), self.upper())
        z = jnp.clip(z, self.lower(), self.upper())
        for region, terms in region_terms(self.entries, self.regions):
            z = _drawn_in(region, terms, z)
        return z

    @property
    def has_prior(self) -> bool:
        """Whether any parameter has a prior or is pinned."""
        known = any(q.prior_std is not None for q in self.parameters)
        return known or self.pin is not None

    def prior_weights(self) -> Scaled:
        """Return 1 / standard deviations of the prior; 0 without one [-]."""
        zero = jnp.zeros(())
        stds = [(q.unit_step, q.prior_std) for q in self.parameters]
        weights = jnp.stack([zero if std is None else S / std for S, std in stds])
        if self.pin is None:
            return weights
        return weights.at[self.pin.column].set(self.pin.weight)

    def from_prior(self, z: Scaled) -> Scaled:
        """Compute signed distances from the start, in units of the prior [-]."""
        middle = self.start()
        if self.pin is not None:
            middle = middle.at[self.pin.column].set(self.pin.value)
        return self.prior_weights() * self.shorter(z - middle)

    def order_rows(self) -> tuple[Float[Array, "n_rows n_p"], Float[Array, " n_rows"]]:
        """Return the order constraints as A z <= b."""
        terms = order_terms(self.entries, self.order)
        # Not jnp.zeros, which would compile a program for every shape.
        shape = (len(terms), len(self.parameters))
        A, b = jax.device_put((np.zeros(shape), np.zeros(len(terms))))
        for row, pair in enumerate(terms):
            # Rows of unit size: lambda_p is of the order of 1 in every direction.
            size = jnp.maximum(pair[0].unit, pair[1].unit)
            for sign, term in zip((1.0, -1.0), pair, strict=True):
                if term.column is None:
                    b = b.at[row].add(-sign * term.constant / size)
                else:
                    A = A.at[row, term.column].add(sign * term.unit / size)
        return A, b

    def rows(self) -> tuple[Float[Array, "n_rows n_p"], Float[Array, " n_rows"]]:
        """Return all linear constraints, of order and of regions, as A z <= b."""
        if not self.regions:
            return self.order_rows()
        parts = [self.order_rows()]
        for region, terms in region_terms(self.entries, self.regions):
            A = jnp.zeros((len(region.b), len(self.parameters)))
            known = jnp.stack([term.constant for term in terms])
            for k, term in enumerate(terms):
                if term.column is not None:
                    A = A.at[:, term.column].add(region.A[:, k])
            parts.append((A, region.b - region.A @ known))
        A, b = zip(*parts, strict=True)
        return jnp.concatenate(A), jnp.concatenate(b)

    def order_names(self) -> list[tuple[str, str]]:
        """List the names of smaller and larger value of each order constraint."""
        return [(s.name, l.name) for s, l in order_terms(self.entries, self.order)]

    def row_names(self) -> list[str]:
        """Say what each of the `rows` keeps, in words."""
        names = [f"{small} <= {large}" for small, large in self.order_names()]
        for region, terms in region_terms(self.entries, self.regions):
            values = " and ".join(term.name for term in terms)
            names += [f"what {region.name} reaches of {values}"] * len(region.b)
        return names

    def apply(
        self,
        model: Any,
        configuration: Any,
        z: Scaled,
        columns: Int[HostArray, " n"] | Sequence[int] = (),
        coordinates: Float[Array, " n"] | Sequence[float] = (),
    ) -> tuple[Any, Any]:
        """Set the values of scaled coordinates in a model and a configuration.

        Setting them again changes nothing. The configuration is None where only the
        model is wanted. For derivatives by some coordinates, `coordinates` has their
        values in place of those in `z`, and `columns` their indices [-].

        Raises:
            ValueError: If either lacks what a parameter sets.
        """
        self._check_number(z)
        scaled = list(z)
        for column, value in zip(columns, coordinates, strict=True):
            scaled[column] = value
        pairs = zip(self.parameters, scaled, strict=True)
        values = {q.name: q.from_scaled(coordinate) for q, coordinate in pairs}
        return self.with_values(model, configuration, values)

    def with_values(
        self, model: Any, configuration: Any, values: Values
    ) -> tuple[Any, Any]:
        """Set the values of all parameters, as `apply` does."""
        # Fields come last: weights of control points are those of the shape.
        for entry in sorted(self.entries, key=lambda entry: bool(entry.fields)):
            model, configuration = entry.apply(model, configuration, values)
        for axis in fading_axes(self.entries, self.axes):
            model = faded(model, values, axis)
        return model, configuration

    def model_at(self, model: Any, z: Scaled) -> Any:
        """Set the values of scaled coordinates in a model alone; see `apply`."""
        return self.apply(model, None, z)[0]

    @property
    def field_names(self) -> tuple[str, ...]:
        """Fields of the law, or the density, that parameters set."""
        names = [name for entry in self.entries for name in entry.fields]
        return tuple(dict.fromkeys(names))

    @property
    def sets_fields(self) -> tuple[bool, ...]:
        """Whether each parameter sets some of `field_names` and nothing else."""
        return tuple(bool(e.fields) for e in self.entries for _ in e.parameters)


def _drawn_in(region: Region, terms: tuple[Term, ...], z: Scaled) -> Scaled:
    """Draw the moduli of a control point straight to the centre, into their region."""
    columns = [term.column for term in terms]
    if None in columns:
        return z
    where = np.array(columns)
    away = region.A @ (z[where] - region.centre)
    room = region.b - region.A @ region.centre
    share = jnp.min(room / jnp.maximum(away, room))
    return z.at[where].set(region.centre + share * (z[where] - region.centre))


Parameters = ParameterSpace | Entry | Sequence[Entry]


def as_space(parameters: Parameters) -> ParameterSpace:
    """Make a parameter space of one parameter or several."""
    if isinstance(parameters, ParameterSpace):
        return parameters
    one = isinstance(parameters, AbstractEntry)
    return ParameterSpace((parameters,) if one else tuple(parameters))


def check_names(entries: tuple[Entry, ...]) -> None:
    """Raise ValueError unless names of parameters are unique and ties name one."""
    names = [q.name for entry in entries for q in entry.parameters]
    check_unique("parameter", names)
    for entry in entries:
        if isinstance(entry, ControlPointParameters):
            for point, name in entry.tied:
                what = f"parameter that {entry.field} of {point} is tied to,"
                check_known(what, names, name)
