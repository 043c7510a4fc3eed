"""The space of all calibrated parameters: scaling, bounds, order constraints."""

from collections.abc import Iterable, Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from softcal_jax._typing import Array, Float, HostArray, Int
from softcal_jax.fields._axes import AxisChart
from softcal_jax.fields._cores import fading_axes
from softcal_jax.fields._entry import AbstractEntry
from softcal_jax.fields._order import axis_columns, order_terms
from softcal_jax.fields._parameters import Parameter
from softcal_jax.fields._spread import ControlPointParameters

Entry = AbstractEntry


def _as_pairs(order: Iterable[Sequence[str]]) -> tuple[tuple[str, str], ...]:
    pairs = []
    for pair in order:
        if isinstance(pair, str) or len(pair) != 2:
            raise ValueError(
                'order takes pairs (smaller, larger), like ("E_l", "E_t"); got '
                f"{pair!r}."
            )
        pairs.append((str(pair[0]), str(pair[1])))
    return tuple(pairs)


def _as_triples(axes: Iterable[Sequence[str]]) -> tuple[tuple[str, str, str], ...]:
    triples = []
    for axis in axes:
        if isinstance(axis, str) or len(axis) != 3:
            raise ValueError(
                "axes takes triples (smaller modulus, larger modulus, angle), like "
                f'("E_l", "E_t", "theta"); got {axis!r}.'
            )
        triples.append((str(axis[0]), str(axis[1]), str(axis[2])))
    return tuple(triples)


class Pin(eqx.Module):
    """A parameter drawn to a value, in place of its prior.

    Attributes:
        column: Index of the parameter.
        value: Its scaled value [-].
        weight: 1 / tolerated deviation, scaled [-].
    """

    column: Int[Array, ""]
    value: Float[Array, ""]
    weight: Float[Array, ""]


class ParameterSpace(eqx.Module):
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
        pin: A parameter held at a value, for a profile of the likelihood.
    """

    entries: tuple[Entry, ...] = eqx.field(converter=tuple)
    order: tuple[tuple[str, str], ...] = eqx.field(
        static=True, default=(), converter=_as_pairs
    )
    axes: tuple[tuple[str, str, str], ...] = eqx.field(
        static=True, default=(), converter=_as_triples
    )
    tensor_steps: bool = eqx.field(static=True, default=True)
    pin: Pin | None = None

    def __check_init__(self):
        if not self.parameters:
            raise ValueError("at least one parameter is needed, got none.")
        check_names(self.entries)
        order_terms(self.entries, self.order)
        axis_columns(self.entries, self.axes)
        fading_axes(self.entries, self.axes)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The unknowns one by one."""
        return tuple(q for entry in self.entries for q in entry.parameters)

    @property
    def names(self) -> list[str]:
        """Names of the parameters."""
        return [parameter.name for parameter in self.parameters]

    def start(self) -> Float[Array, " n_p"]:
        """Return the scaled start."""
        return self.to_scaled(jnp.stack([q.start for q in self.parameters]))

    def lower(self) -> Float[Array, " n_p"]:
        """Return the scaled lower bounds."""
        return self.to_scaled(jnp.stack([q.lower for q in self.parameters]))

    def upper(self) -> Float[Array, " n_p"]:
        """Return the scaled upper bounds."""
        return self.to_scaled(jnp.stack([q.upper for q in self.parameters]))

    def to_scaled(self, p: Float[Array, " n_p"]) -> Float[Array, " n_p"]:
        """Convert values p to scaled coordinates z."""
        return jnp.stack([q.to_scaled(p[i]) for i, q in enumerate(self.parameters)])

    def from_scaled(self, z: Float[Array, " n_p"]) -> Float[Array, " n_p"]:
        """Convert scaled coordinates z to values p."""
        return jnp.stack([q.from_scaled(z[i]) for i, q in enumerate(self.parameters)])

    def room(
        self, z: Float[Array, " n_p"]
    ) -> tuple[Float[Array, " n_p"], Float[Array, " n_p"]]:
        """Return the largest steps down and up within bounds; infinite if periodic."""
        periodic = jnp.asarray([q.periodic for q in self.parameters])
        return (
            jnp.where(periodic, -jnp.inf, self.lower() - z),
            jnp.where(periodic, jnp.inf, self.upper() - z),
        )

    def max_step(self) -> Float[Array, " n_p"]:
        """Return the step limits of the parameters, infinite by default."""
        none = jnp.asarray(jnp.inf)
        limits = [none if q.max_step is None else q.max_step for q in self.parameters]
        return jnp.stack(limits)

    def wrap(self, z: Float[Array, " n_p"]) -> Float[Array, " n_p"]:
        """Wrap periodic parameters into their bounds."""
        low, high = self.lower(), self.upper()
        periodic = jnp.asarray([q.periodic for q in self.parameters])
        return jnp.where(periodic, low + jnp.mod(z - low, high - low), z)

    @property
    def chart(self) -> AxisChart | None:
        """Step coordinates of the axes; None without axes or tensor steps."""
        if not (self.axes and self.tensor_steps):
            return None
        columns = axis_columns(self.entries, self.axes)
        S = [self.parameters[i].unit_step for i in columns[:, 2]]
        return AxisChart(columns[:, 0], columns[:, 1], columns[:, 2], jnp.stack(S))

    def distance(
        self, z: Float[Array, " n_p"], other: Float[Array, " n_p"]
    ) -> Float[Array, " n_p"]:
        """Compute distances of scaled parameters, the shorter way if periodic."""
        return jnp.abs(self.shorter(z - other))

    @property
    def has_prior(self) -> bool:
        """Whether any parameter has a prior or is pinned."""
        known = any(q.prior_std is not None for q in self.parameters)
        return known or self.pin is not None

    def prior_weights(self) -> Float[Array, " n_p"]:
        """Return 1 / standard deviations of the prior; 0 without one [-]."""
        weights = jnp.stack([q.prior_weight() for q in self.parameters])
        if self.pin is None:
            return weights
        return weights.at[self.pin.column].set(self.pin.weight)

    def from_prior(self, z: Float[Array, " n_p"]) -> Float[Array, " n_p"]:
        """Compute signed distances from the start, in units of the prior [-].

        Periodic parameters go the shorter way.
        """
        middle = self.start()
        if self.pin is not None:
            middle = middle.at[self.pin.column].set(self.pin.value)
        return self.prior_weights() * self.shorter(z - middle)

    def shorter(self, gap: Float[Array, " n_p"]) -> Float[Array, " n_p"]:
        """Reduce differences of scaled parameters to the shorter way if periodic."""
        turn = self.upper() - self.lower()
        periodic = jnp.asarray([q.periodic for q in self.parameters])
        return jnp.where(periodic, gap - turn * jnp.round(gap / turn), gap)

    def admissible(self, z: Float[Array, " n_p"]) -> Float[Array, " n_p"]:
        """Clip parameters to their bounds, keeping moduli of an axis slightly apart."""
        z = self.wrap(z)
        if self.chart is not None:
            z = self.chart.clip(z, self.lower(), self.upper())
        return jnp.clip(z, self.lower(), self.upper())

    def order_rows(self) -> tuple[Float[Array, "n_rows n_p"], Float[Array, " n_rows"]]:
        """Return the order constraints as A z <= b."""
        terms = order_terms(self.entries, self.order)
        A, b = jnp.zeros((len(terms), len(self.parameters))), jnp.zeros(len(terms))
        for row, pair in enumerate(terms):
            # Rows of unit size: lambda_p is of the order of 1 in every direction.
            size = jnp.maximum(pair[0].unit, pair[1].unit)
            for sign, term in zip((1.0, -1.0), pair, strict=True):
                if term.column is None:
                    b = b.at[row].add(-sign * term.constant / size)
                else:
                    A = A.at[row, term.column].add(sign * term.unit / size)
        return A, b

    def order_names(self) -> list[tuple[str, str]]:
        """List the names of smaller and larger value of each order constraint."""
        terms = order_terms(self.entries, self.order)
        return [(small.name, large.name) for small, large in terms]

    def apply(
        self, model: Any, configuration: Any, z: Float[Array, " n_p"]
    ) -> tuple[Any, Any]:
        """Set the values of scaled coordinates in a model and a configuration.

        Args:
            model: Anything with `law`, `density`, `mesh` and `mechanism`.
            configuration: Arrays of one configuration; None where only the model is
                wanted.
            z: Scaled coordinates [-].

        Returns:
            Both, with the values set; setting them again changes nothing.

        Raises:
            ValueError: If either lacks what a parameter sets.
        """
        none = np.zeros(0, int)
        return self.apply_partly(model, configuration, z, none, z[none])

    def apply_partly(
        self,
        model: Any,
        configuration: Any,
        z: Float[Array, " n_p"],
        columns: Int[HostArray, " n"],
        own: Float[Array, " n"],
    ) -> tuple[Any, Any]:
        """Do as `apply`, with some coordinates given separately, for derivatives.

        Args:
            model: As for `apply`.
            configuration: As for `apply`.
            z: Scaled coordinates [-].
            columns: Indices of the coordinates given separately.
            own: Their values, in place of those in `z` [-].
        """
        parameters = self.parameters
        scaled = {q.name: z[i] for i, q in enumerate(parameters)}
        scaled |= {parameters[i].name: own[k] for k, i in enumerate(columns)}
        values = {q.name: q.from_scaled(scaled[q.name]) for q in parameters}
        for entry in self.entries:
            model, configuration = entry.apply(model, configuration, values)
        for axis in fading_axes(self.entries, self.axes):
            model = axis.apply(model, values)
        return model, configuration

    def model_at(self, model: Any, z: Float[Array, " n_p"]) -> Any:
        """Set the values of scaled coordinates in a model alone.

        Args:
            model: Anything with `law`, `density`, `mesh` and `mechanism`.
            z: Scaled coordinates [-].
        """
        return self.apply(model, None, z)[0]

    @property
    def field_names(self) -> tuple[str, ...]:
        """Fields of the law, or the density, that parameters set."""
        names = [name for entry in self.entries for name in entry.fields]
        return tuple(dict.fromkeys(names))

    @property
    def sets_fields(self) -> tuple[bool, ...]:
        """Whether each parameter sets such fields and nothing else."""
        return tuple(bool(e.fields) for e in self.entries for _ in e.parameters)


def as_space(
    parameters: ParameterSpace | Entry | Sequence[Entry],
) -> ParameterSpace:
    """Make a parameter space of one parameter or several."""
    if isinstance(parameters, ParameterSpace):
        return parameters
    if isinstance(parameters, AbstractEntry):
        return ParameterSpace((parameters,))
    return ParameterSpace(tuple(parameters))


def check_names(entries: tuple[Entry, ...]) -> None:
    """Raise unless parameter names are unique and ties name a parameter.

    Raises:
        ValueError: If a name repeats, or a value is tied to an unknown parameter.
    """
    names = [q.name for entry in entries for q in entry.parameters]
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"parameter {name!r} is named more than once.")
    for entry in entries:
        if isinstance(entry, ControlPointParameters):
            for point, name in entry.tied:
                if name not in names:
                    raise ValueError(
                        f"{entry.field} of {point} is tied to {name!r}, which is no "
                        f"parameter; there are {', '.join(names)}."
                    )
