"""The fields of a model, and entries of a parameter space: an unknown, an error."""

import operator
from abc import abstractmethod
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike

from softcal_jax._module import Module
from softcal_jax._typing import Array, Float, HostArray, is_traced
from softcal_jax._units import readable
from softcal_jax.materials import DENSITY, UNREMARKABLE, ConstantKind, fields_of_tets


def set_field(
    model: Any, field: str, value: Float[ArrayLike, "..."], region: str | None = None
) -> Any:
    """Change one field of a model; traceable and differentiable.

    Args:
        model: Anything with `law`, `density` and `mesh`.
        field: Name of a field of the law, like "E", or "density".
        value: New value in SI units: one for all, or one per tet of the region.
        region: Tet group that it applies to; the whole mesh by default.

    Raises:
        ValueError: If the field or the region does not exist, the field is not unique,
            or there are neither one value nor as many as tets.
    """
    where = find_field(model, field)
    old = where(model)
    new = jnp.asarray(value, float)
    mesh = model.mesh
    n_tets = mesh.n_tets if region is None else len(mesh.tets_of(region))
    if new.shape not in ((), (n_tets,)):
        of = "the mesh" if region is None else f"region {region!r}"
        raise ValueError(
            f"{field} has shape {new.shape}; expected one value, or {n_tets} for {of}."
        )
    if region is None:
        new = jnp.broadcast_to(new, jnp.broadcast_shapes(new.shape, jnp.shape(old)))
    elif is_traced(old) or is_traced(new):
        new = jnp.broadcast_to(old, (mesh.n_tets,)).at[mesh.tets_of(region)].set(new)
    else:
        # What is known is changed on the host, where nothing is compiled.
        values = np.broadcast_to(old, (mesh.n_tets,)).copy()
        values[np.asarray(mesh.tets_of(region))] = new
        new = jax.device_put(values)
    return eqx.tree_at(where, model, new)


def region_tets(mesh: Any, region: str | None) -> HostArray:
    """Return the indices of the tets of a region; of all tets without one."""
    if region is None:
        return np.arange(mesh.n_tets)
    return np.asarray(mesh.tets_of(region))


def find_field(model: Any, field: str):
    """Return the function from a model to a field of its law, or to its density.

    The name is like "E", or a dotted path if that is not unique; "density" is that of
    the model, even if the law has one.

    Raises:
        ValueError: If no field has that name, or more than one.
    """
    paths = [path for path, _, _ in constants_of(model)]
    named = [path for path in paths if ("." + path).endswith("." + field)]
    named = [field] if field in named else named
    if len(named) != 1:
        problem = "is not unique" if named else "does not exist"
        if hasattr(model.law, field):
            problem = "is shared by all tets: change it by eqx.tree_at"
        raise ValueError(f"field {field!r} {problem}; there are {', '.join(paths)}.")
    return _Accessor(named[0])


def constants_of(model: Any) -> Iterator[tuple[str, Any, Mapping[str, Any]]]:
    """Yield the constants of a model, of its law and its density, see `constant`.

    Each has its path in the model, like "law.fibre.theta", its value, one or one per
    tet, and its declaration.
    """
    for path, leaf, declared in fields_of_tets(model.law):
        if "[" not in path:  # of a tuple, like the local axes of a fibre
            yield "law" + path, leaf, declared
    yield "density", model.density, DENSITY


def kind_of(model: Any, field: str) -> ConstantKind:
    """Return the kind of a field that `find_field` finds."""
    where = find_field(model, field).path
    declared = next(of for path, _, of in constants_of(model) if path == where)
    return declared.get("kind", UNREMARKABLE)


@dataclass(frozen=True)
class _Accessor:
    """Accessor by dotted path; hashable, so equal ones share compiled programs."""

    path: str

    def __call__(self, model: Any) -> Any:
        return operator.attrgetter(self.path)(model)


Value = TypeVar("Value")


class once(cached_property[Value]):
    """Property whose first value is kept, for values that loops on the host use often.

    Unlike in `cached_property`, a traced value is never kept: it is of no use outside
    its trace, and another thread would take it.
    """

    if not TYPE_CHECKING:  # its type is that of the base

        def __get__(self, module: Any, owner: Any = None) -> Any:
            if module is None:
                return self
            value = self.func(module)
            if not any(map(is_traced, jax.tree.leaves(value))):
                vars(module)[self.attrname] = value
            return value


Values = Mapping[str, Float[Array, ""]]
"""Values of all parameters by name, in SI units."""

Names = Mapping[str, str]
"""New names by the old ones."""


class AbstractEntry(Module):
    """One or several unknowns, and what they set in a model and its configurations.

    Sensitivities follow from `apply` by autodiff. A new kind of parameter is a row of
    `KINDS` if it sets an entry of an array; otherwise it is a subclass.
    """

    @property
    @abstractmethod
    def parameters(self) -> tuple["Parameter", ...]:
        """The unknowns that it adds."""

    @property
    def fields(self) -> tuple[str, ...]:
        """Fields of the law, or the density, if it sets these and nothing else.

        One pass over the tets then gives the forces of all unknowns of a field. Empty
        for an entry that sets anything else; `check_parameters` verifies this.
        """
        return ()

    @property
    def tet_group(self) -> str | None:
        """Tet group in which it sets fields; None for the whole body."""
        return None

    @property
    def label(self) -> str:
        """Its name in messages."""
        return ", ".join(parameter.name for parameter in self.parameters)

    @abstractmethod
    def apply(self, model: Any, configuration: Any, values: Values) -> tuple[Any, Any]:
        """Set the values of its unknowns; traceable and differentiable.

        Returns the model, which has `law`, `density`, `mesh` and `mechanism`, and the
        arrays of one configuration, None where only the model is wanted.
        """

    @abstractmethod
    def check(self, model: Any) -> None:
        """Raise ValueError unless the model has what the entry sets."""

    def renamed(self, points: Names, names: Names) -> "AbstractEntry":
        """Return the same entry with other names of control points and parameters.

        An entry with more than its `name` to change overrides this.
        """
        return replace(self, name=names[self.label])


def as_values(value: Any) -> Any:
    if value is None:
        return None
    if isinstance(value, jax.Array):
        return jnp.asarray(value, float)
    # Not jnp.asarray, which compiles a program for plain numbers.
    return jax.device_put(np.asarray(value, float))


Real = Float[Array, ""]
"""One number."""


class AbstractFieldEntry(AbstractEntry):
    """Unknowns that set one field of the law, or the density.

    Attributes:
        scale: "log" for moduli (a step is a ratio), "linear" otherwise.
        S: For a linear scale, the size of a unit step of lambda_p; upper - lower by
            default. A log scale needs none.
        region: Tet group that it is set in; the whole body by default.
        unit: SI unit, for tables.
        max_step: Largest entry of lambda_p in one step, like the step limits of the
            paper; on a log scale 0.01 is 1 %. None leaves it to the trust region [-].
        prior_std: Standard deviation of the prior about `start`: relative on a log
            scale (0.3 is 30 %), in SI units on a linear one. None without a prior.
    """

    scale: Literal["log", "linear"] = eqx.field(
        static=True, default="log", kw_only=True
    )
    S: Real | None = eqx.field(default=None, converter=as_values, kw_only=True)
    region: str | None = eqx.field(static=True, default=None, kw_only=True)
    unit: str = eqx.field(static=True, default="", kw_only=True)
    max_step: Real | None = eqx.field(default=None, converter=as_values, kw_only=True)
    prior_std: Real | None = eqx.field(default=None, converter=as_values, kw_only=True)

    @property
    def tet_group(self) -> str | None:
        return self.region


def to_scale(scale: str, S: Real, p: Real) -> Real:
    return jnp.log(p) if scale == "log" else p / S


def from_scale(scale: str, S: Real, z: Real) -> Real:
    return jnp.exp(z) if scale == "log" else z * S


class Parameter(AbstractFieldEntry):
    """One unknown constant of the model; further options are of `AbstractFieldEntry`.

    Attributes:
        name: Name in tables and results.
        field: The field of the law that it sets, like "E", or "density".
        start: Value before calibration, in SI units.
        lower: Smallest value allowed.
        upper: Largest value allowed.
        periodic: Whether both bounds are equivalent, as for the angle of an axis, -90
            to 90 degrees: a step past one bound re-enters at the other.
    """

    name: str = eqx.field(static=True)
    field: str = eqx.field(static=True)
    start: Float[Array, ""] = eqx.field(converter=as_values)
    lower: Float[Array, ""] = eqx.field(converter=as_values)
    upper: Float[Array, ""] = eqx.field(converter=as_values)
    periodic: bool = eqx.field(static=True, default=False, kw_only=True)

    def __check_init__(self):
        if any(is_traced(v) for v in (self.start, self.lower)):
            return
        start, lower, upper = float(self.start), float(self.lower), float(self.upper)
        what = f"parameter {self.name!r}"
        show = lambda v: f"{v:g}" if np.isnan(v) else readable(v, self.unit)
        finite = np.all(np.isfinite([start, lower, upper]))
        if not (finite and lower < upper and lower <= start <= upper):
            raise ValueError(
                f"{what}: start and bounds must be finite and none crossed; got start "
                f"{show(start)}, lower {show(lower)} and upper {show(upper)}."
            )
        if self.scale not in ("log", "linear"):
            raise ValueError(f'{what}: scale is {self.scale!r}, not "log" or "linear".')
        if self.scale == "log" and lower <= 0.0:
            raise ValueError(
                f"{what}: a log scale needs positive bounds, got lower {lower:g}; use "
                'scale="linear".'
            )
        for name in ("S", "max_step", "prior_std"):
            value = getattr(self, name)
            if value is not None and not 0.0 < float(value) < np.inf:
                raise ValueError(
                    f"{what}: {name} must be positive and finite, got "
                    f"{float(value):g}; leave it out for its default."
                )

    @property
    def parameters(self) -> tuple["Parameter", ...]:
        return (self,)

    @property
    def fields(self) -> tuple[str, ...]:
        return (self.field,)

    @property
    def unit_step(self) -> Float[Array, ""]:
        """S of a linear scale; 1 on a log scale."""
        if self.scale == "log":
            return jax.device_put(np.ones(()))
        return self.upper - self.lower if self.S is None else self.S

    def to_scaled(self, p: Float[Array, ""]) -> Float[Array, ""]:
        """Compute the scaled coordinate z: ln p, or p / S [-]."""
        return to_scale(self.scale, self.unit_step, p)

    def from_scaled(self, z: Float[Array, ""]) -> Float[Array, ""]:
        """Compute the value of a scaled coordinate: p = exp z, or p = S z."""
        return from_scale(self.scale, self.unit_step, z)

    def apply(self, model: Any, configuration: Any, values: Values) -> tuple[Any, Any]:
        """Set its field to one value in its region."""
        value = values[self.name]
        return set_field(model, self.field, value, self.region), configuration

    def check(self, model: Any) -> None:
        """Raise ValueError if it would overwrite values that differ over the mesh."""
        values = np.asarray(find_field(model, self.field)(model))
        if self.region is None and values.ndim and np.ptp(values) > 0:
            raise ValueError(
                f"parameter {self.name!r} would give the whole body one value of "
                f"{self.field}, which now lies between {values.min():g} and "
                f"{values.max():g}. Name the tet group it is for in `region`."
            )


class AbstractError(AbstractEntry):
    """An error that is considered, not calibrated: it counts by its derivative at zero.

    It is one unknown about zero, in units of its standard deviation.

    Attributes:
        name: Its name.
        std: Its standard deviation, in SI units or relative.
    """

    name: str = eqx.field(static=True)
    std: Float[Array, ""] = eqx.field(converter=as_values)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Its unknown."""
        unknown = Parameter(
            self.name, "", 0.0, -1.0, 1.0, scale="linear", S=1.0, prior_std=1.0
        )
        return (unknown,)


class FieldError(AbstractError):
    """An error of a field of the law, or of the density.

    Attributes:
        field: The field, as `find_field` finds it.
        share: Error of each tet per unit of the unknown; 0 where it is calibrated.
        relative: Whether the error is relative to the value.
    """

    field: str = eqx.field(static=True)
    share: Float[Array, " n_tets"]
    relative: bool = eqx.field(static=True, default=False)

    @property
    def fields(self) -> tuple[str, ...]:
        return (self.field,)

    def check(self, model: Any) -> None:
        find_field(model, self.field)

    def apply(self, model: Any, configuration: Any, values: Values) -> tuple[Any, Any]:
        """Add the error to the field."""
        old = jnp.broadcast_to(find_field(model, self.field)(model), self.share.shape)
        error = values[self.name] * self.std * self.share
        new = old + error * (old if self.relative else 1.0)
        return set_field(model, self.field, new), configuration
