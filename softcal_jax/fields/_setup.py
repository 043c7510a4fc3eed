"""Parameters of setup, loads and recordings that are only roughly known (Sec. VII).

If such an error is not a parameter it biases the moduli, and residuals may hide it.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from operator import attrgetter
from typing import Any, Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._names import name_key, unknown_name
from softcal_jax._typing import Array, Float, is_traced
from softcal_jax.fields._occurrence import Occurs
from softcal_jax.fields._parameters import AbstractEntry, Parameter

By = Literal["configuration", "recording"]
_BY: tuple[By, ...] = ("configuration", "recording")

Role = Literal["fitted", "considered", "noise", "none"]
"""What an unknown is in a calibration, see `calibration.Unknown`."""

_XYZ = ("x", "y", "z")

Change = Callable[[Any], Any]
Put = Callable[[Any, tuple[int, ...], Change], Any]


class Quantity(NamedTuple):
    """An array of the model, or of its configurations, whose entries can be unknown.

    Attributes:
        title: Name of an unknown, with {of} and {axis} filled in.
        put: Changes an entry: of (model or configuration, index, function of the old
            value).
        noun: What its first axis enumerates, like "motor"; empty if nothing.
        names: Names along the first axis, from the model or the configuration.
        components: Names along the last axis; empty for one number.
        scales: Scales that a parameter of it may have, the usual one first.
        unit: SI unit, for tables.
        least: Smallest value that it can have at all, in SI units.
        of_configuration: Whether each configuration has such an array, or the model.
        uncertain: Entry of `Uncertain` that says how far off it usually is; empty if
            none does.
        role: What an error of it is where it is not fitted: "considered", part of the
            "noise" that weighs the data, or "none".
        occurs: Where such an error can occur, see `Poses`; empty for everywhere.
        absent: What is said where it can occur nowhere, with {of} filled in.
    """

    title: str
    put: Put
    noun: str = ""
    names: Callable[[Any], Sequence[str]] = lambda _: ()
    components: tuple[str, ...] = ()
    scales: tuple[Literal["linear", "log"], ...] = ("linear",)
    unit: str = ""
    least: float = -math.inf
    of_configuration: bool = False
    uncertain: str = ""
    role: Role = "none"
    occurs: Occurs = lambda _: {}
    absent: str = ""

    @property
    def relative(self) -> bool:
        """Whether its errors are relative to the value, as those of factors are."""
        return self.scales[0] == "log"


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


QUANTITIES: dict[str, Quantity] = {}
"""Kinds of parameters that set one entry of an array, by name.

`_setup_parameters` declares each beside the function that makes parameters of it.
"""


def _as_tuple(parameters: Parameter | Sequence[Parameter]) -> tuple[Parameter, ...]:
    return (parameters,) if isinstance(parameters, Parameter) else tuple(parameters)


class SetupParameter(AbstractEntry):
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
    unknowns: tuple[Parameter, ...] = eqx.field(converter=_as_tuple)
    axis: str = eqx.field(static=True, default="")
    each: tuple[str, ...] = eqx.field(static=True, default=(), converter=tuple)
    by: By = eqx.field(static=True, default="recording")

    def __check_init__(self):
        if self.kind not in QUANTITIES:
            raise unknown_name("kind of a setup parameter", self.kind, QUANTITIES)
        quantity, what = self.quantity, f"parameter {self.label!r}"
        quoted = lambda names: " or ".join(f'"{name}"' for name in names)
        if quantity.components and self.axis not in quantity.components:
            raise ValueError(
                f"{what}: axis must be {quoted(quantity.components)}, got "
                f"{self.axis!r}."
            )
        if self.axis and not quantity.components:
            raise ValueError(
                f"{what}: {self.kind} is one number and has no axis, got {self.axis!r}."
            )
        if self.unknowns[0].scale not in quantity.scales:
            raise ValueError(
                f"{what} of the setup needs scale={quoted(quantity.scales)}: zero is a "
                "value that it may have."
            )
        if self.by not in _BY:
            raise ValueError(f"{what}: by must be {quoted(_BY)}, got {self.by!r}.")
        if self.each and not self.quantity.of_configuration:
            raise ValueError(
                f"{what}: {self.kind} belongs to the robot, which all configurations "
                "share; leave `each` out."
            )
        if len(self.unknowns) != max(1, len(self.each)):
            raise ValueError(
                f"{what}: {len(self.unknowns)} unknowns were given, expected one for "
                f"each {self.by} named ({', '.join(self.each) or 'none'}), or one for "
                "all."
            )
        for name in self.each:
            if self.each.count(name) > 1:
                raise ValueError(f"{what}: {name!r} stands twice in `each`.")

    @property
    def quantity(self) -> Quantity:
        """What it sets."""
        return QUANTITIES[self.kind]

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
        """Name of what a configuration belongs to: its own, or that of its recording.

        Args:
            configuration: Anything with `name` and `recording`.
        """
        recording = configuration.recording if self.by == "recording" else None
        return recording or configuration.name

    def check(self, model: Any) -> None:
        """Raise ValueError unless the model has the motor or the body."""
        if not self.quantity.of_configuration:
            entry_index(self, model)

    def apply(
        self, model: Any, configuration: Any, values: Mapping[str, Float[Array, ""]]
    ) -> tuple[Any, Any]:
        """Set its entry; configurations that it does not belong to keep theirs."""
        quantity = self.quantity
        owner = configuration if quantity.of_configuration else model
        if owner is None:
            return model, configuration

        def change(old):
            if not self.each:
                return values[self.unknowns[0].name]
            own = configuration.key[_BY.index(self.by)]
            for name, parameter in zip(self.each, self.unknowns, strict=True):
                old = jnp.where(own == name_key(name), values[parameter.name], old)
            return old

        owner = quantity.put(owner, entry_index(self, owner), change)
        return (
            (model, owner) if self.quantity.of_configuration else (owner, configuration)
        )

    def renamed(
        self, points: Mapping[str, str], names: Mapping[str, str]
    ) -> "SetupParameter":
        """Return the same unknowns with other names."""
        del points
        own = tuple(replace(q, name=names[q.name], unit="") for q in self.unknowns)
        return replace(self, unknowns=own)


def entry_index(entry: Any, owner: Any) -> tuple[int, ...]:
    """Find the index of what an entry sets in the array of its quantity.

    Args:
        entry: Anything with `kind`, `of`, `axis` and `label`.
        owner: The model, or a configuration.

    Raises:
        ValueError: If the owner does not have what the entry belongs to.
    """
    quantity, index = QUANTITIES[entry.kind], ()
    if quantity.noun:
        names = list(quantity.names(owner))
        known = [name for name in names if name]
        if entry.of not in known:
            what = f"{quantity.noun} of parameter {entry.label!r}"
            raise unknown_name(what, entry.of, known)
        index = (names.index(entry.of),)
    if quantity.components:
        index += (quantity.components.index(entry.axis),)
    return index
