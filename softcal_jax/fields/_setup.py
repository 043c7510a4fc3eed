"""Parameters of setup, loads and recordings that are only roughly known (Sec. VII).

If such an error is not a parameter it biases the moduli, and residuals may hide it.
"""

import math
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import replace
from operator import attrgetter
from typing import Any, Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike

from softcal_jax._module import Module
from softcal_jax._names import check_known, name_key
from softcal_jax._typing import Bool, Float, HostArray, is_traced
from softcal_jax.fields._parameters import (
    AbstractEntry,
    AbstractError,
    Names,
    Parameter,
    Values,
)

By = Literal["configuration", "recording"]
_BY: tuple[By, ...] = ("configuration", "recording")

Role = Literal["fitted", "considered", "noise", "none"]
"""What an unknown is in a calibration, see `unknowns.Unknown`."""

Change = Callable[[Any], Any]
Put = Callable[[Any, tuple[int, ...], Change], Any]

Scope = tuple[Hashable | None, ...]
"""For each configuration a key, None where the error cannot occur; configurations with
the same key have the same error."""


class Poses(Module):
    """Configurations of a model, as arrays on the host, and the recording of each."""

    model: Any
    arrays: Any
    recordings: Sequence[str]


def each_of(names: Sequence[str], has: Bool[HostArray, "n_c n"]) -> dict[str, Scope]:
    """Return a scope for each name: one error for all configurations that have it."""
    return {
        name: tuple("" if has_it else None for has_it in flags)
        for name, flags in zip(names, has.T, strict=True)
        if name
    }


def grounded_bodies(poses: Poses) -> Bool[HostArray, "n_c n_b"]:
    """Flag bodies that are held, guided or on a motor, or tied to such a body."""
    mechanism = poses.model.mechanism
    bodies = mechanism.bodies
    driven = np.isin(np.arange(bodies.n_bodies), mechanism.actuators.motor_body)
    return (poses.arrays.bodies.is_guided | driven)[:, bodies.owner]


class Quantity(NamedTuple):
    """An array of the model, or of its configurations, whose entries can be unknown.

    Attributes:
        title: Name of an unknown, with {of} and {axis} filled in.
        put: Function that changes an entry, of (owner, index, function of the old
            value). The owner is the model or a configuration.
        noun: What its first axis enumerates, like "motor"; empty if nothing.
        names: Names along the first axis, from the owner.
        components: Names along the last axis; empty for one number.
        relative: Whether errors are relative to the value, as those of factors are; its
            parameter then has a log scale.
        unit: SI unit, for tables.
        least: Smallest value that it can have at all, in SI units.
        of_configuration: Whether each configuration has the array, and not the model.
        uncertain: Field of `Uncertain` with its usual standard deviation, if any.
        role: What an error of it is where it is not fitted: "considered", part of the
            "noise" that weighs the data, or "none".
        occurs: Where such an error can occur, by the name of what it belongs to, like
            the motor; empty for everywhere.
        absent: Message if it can occur nowhere, with {of} filled in.
    """

    title: str
    put: Put
    noun: str = ""
    names: Callable[[Any], Sequence[str]] = lambda _: ()
    components: tuple[str, ...] = ()
    relative: bool = False
    unit: str = ""
    least: float = -math.inf
    of_configuration: bool = False
    uncertain: str = ""
    role: Role = "considered"
    occurs: Callable[[Poses], Mapping[str, Scope]] = lambda _: {}
    absent: str = ""


def entry_of(path: str) -> Put:
    """Make the function that changes an entry of the array with a dotted path."""
    where = attrgetter(path)

    def put(owner: Any, index: tuple[int, ...], change: Change) -> Any:
        old = where(owner)
        if not is_traced(old):
            # On the host, where nothing is compiled.
            host = np.array(old)
            new = change(host[index])
            if not is_traced(new):
                host[index] = np.asarray(new)
                return eqx.tree_at(where, owner, jax.device_put(host))
        old = jnp.asarray(old)
        return eqx.tree_at(where, owner, old.at[index].set(change(old[index])))

    return put


def actuators_where(
    which: Callable[[Any], Sequence[bool]],
) -> Callable[[Any], list[str]]:
    """Make the function that names all actuators, but "" for those not of a kind."""

    def names(model: Any) -> list[str]:
        actuators = model.mechanism.actuators
        both = zip(actuators.names, which(actuators), strict=True)
        return [name if known else "" for name, known in both]

    return names


QUANTITIES: dict[str, Quantity] = {}
"""Kinds of parameters that set one entry of an array, by name.

`_setup_parameters` declares each beside the function that makes parameters of it.
"""


class AbstractSetupEntry(AbstractEntry):
    """An entry that changes one of `QUANTITIES`."""

    kind: eqx.AbstractVar[str]
    of: eqx.AbstractVar[str]
    axis: eqx.AbstractVar[str]

    @property
    def quantity(self) -> Quantity:
        """The quantity of which it sets an entry."""
        return QUANTITIES[self.kind]

    def check(self, model: Any) -> None:
        """Raise ValueError unless the model has the motor or the body."""
        if not self.quantity.of_configuration:
            self._index(model)

    def _index(self, owner: Any) -> tuple[int, ...]:
        """Find the index of its entry in the array of its quantity."""
        quantity, index = self.quantity, ()
        if quantity.noun:
            names = list(quantity.names(owner))
            known = [name for name in names if name]
            what = f"{quantity.noun} of parameter {self.label!r}"
            check_known(what, known, self.of)
            index = (names.index(self.of),)
        if quantity.components:
            index += (quantity.components.index(self.axis),)
        return index

    def _changed(
        self, model: Any, configuration: Any, change: Change
    ) -> tuple[Any, Any]:
        """Change its entry of the array, of the model or of the configuration."""
        of_configuration = self.quantity.of_configuration
        owner = configuration if of_configuration else model
        if owner is None:
            return model, configuration
        owner = self.quantity.put(owner, self._index(owner), change)
        return (model, owner) if of_configuration else (owner, configuration)


class SetupParameter(AbstractSetupEntry):
    """One unknown of the setup, the loads or the recordings.

    It is calibrated together with the material, to decouple them (paper Sec. VII).
    Functions named like its kinds make it, `motor_zero` for example.

    Attributes:
        kind: One of `QUANTITIES`.
        of: What it belongs to, like the motor; empty where it belongs to nothing.
        unknowns: Name, start, bounds, scaling and prior of the unknown (`field` is
            ignored); one for each name in `each`, if any.
        axis: Component of a quantity that has several, like "x"; empty otherwise.
        each: Configurations or recordings with an unknown each; all others keep their
            own value. Empty for one unknown common to all.
        by: What `each` names, "configuration" or "recording".
    """

    kind: str = eqx.field(static=True)
    of: str = eqx.field(static=True)
    unknowns: tuple[Parameter, ...] = eqx.field(converter=tuple)
    axis: str = eqx.field(static=True, default="")
    each: tuple[str, ...] = eqx.field(static=True, default=(), converter=tuple)
    by: By = eqx.field(static=True, default="recording")

    def __check_init__(self):
        what = f"parameter {self.label!r}"
        check_known(f"`by` of {what}", _BY, self.by)
        for name in self.each:
            if self.each.count(name) > 1:
                raise ValueError(f"{what}: {name!r} stands twice in `each`.")

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Its unknowns."""
        return self.unknowns

    @property
    def noun(self) -> str:
        """What is unknown, like "load factor of left"."""
        kind = self.kind.replace("_", " ")
        return f"{kind} of {self.of}" if self.of else kind

    def member(self, configuration: Any) -> str:
        """Name of a configuration, or of its recording if `by` says so."""
        recording = configuration.recording if self.by == "recording" else None
        return recording or configuration.name

    def apply(self, model: Any, configuration: Any, values: Values) -> tuple[Any, Any]:
        """Set its entry; configurations that it does not belong to keep theirs."""

        def change(old):
            if not self.each:
                return values[self.unknowns[0].name]
            member = configuration.key[_BY.index(self.by)]
            for name, parameter in zip(self.each, self.unknowns, strict=True):
                old = jnp.where(member == name_key(name), values[parameter.name], old)
            return old

        return self._changed(model, configuration, change)

    def renamed(self, points: Names, names: Names) -> "SetupParameter":
        """Return the same unknowns with other names."""
        unknowns = [replace(q, name=names[q.name], unit="") for q in self.unknowns]
        return replace(self, unknowns=unknowns)


def setup_parameters(
    kind: str,
    of: str = "",
    *,
    limit: float,
    prior_std: float | None,
    nominal: Float[ArrayLike, "..."] | Sequence[float] | None = None,
    each: Sequence[str] = (),
    by: By = "recording",
) -> tuple[SetupParameter, ...]:
    """Make the entries of a quantity, one per component.

    `limit` is the largest error, in SI units, or factor on a log scale. `nominal` is 0,
    or 1 for a factor.
    """
    quantity = QUANTITIES[kind]
    axes, log = quantity.components or ("",), quantity.relative
    middles = np.broadcast_to(float(log) if nominal is None else nominal, len(axes))
    entries = []
    for axis, middle in zip(axes, middles, strict=True):
        name = quantity.title.format(of=of, axis=axis)
        unknowns = [
            Parameter(
                own_name,
                field="",
                start=middle,
                lower=max(quantity.least, middle / limit if log else middle - limit),
                upper=middle * limit if log else middle + limit,
                scale="log" if log else "linear",
                S=None if log else limit,
                unit=quantity.unit,
                prior_std=prior_std,
            )
            for own_name in [f"{name} in {member}" for member in each] or [name]
        ]
        where = {"kind": kind, "of": of, "axis": axis}
        entries.append(SetupParameter(**where, unknowns=unknowns, each=each, by=by))
    return tuple(entries)


class SetupError(AbstractError, AbstractSetupEntry):
    """An error of the setup, the loads or a recording, added to its present value.

    The error of a factor is relative; for `kind`, `of` and `axis` see `SetupParameter`.
    """

    kind: str = eqx.field(static=True)
    of: str = eqx.field(static=True, default="")
    axis: str = eqx.field(static=True, default="")

    def apply(self, model: Any, configuration: Any, values: Values) -> tuple[Any, Any]:
        """Add the error to its entry."""
        error = values[self.name] * self.std
        change = lambda old: old + error * (old if self.quantity.relative else 1.0)
        return self._changed(model, configuration, change)
