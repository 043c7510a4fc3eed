"""Parameters of setup, loads and recordings that are only roughly known (Sec. VII).

If such an error is not a parameter it biases the moduli, and residuals may hide it.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from operator import attrgetter
from typing import Any, Literal, NamedTuple

import equinox as eqx
import jax.numpy as jnp

from softcal_jax._names import name_key, unknown_name
from softcal_jax._typing import Array, Float
from softcal_jax.fields._entry import AbstractEntry
from softcal_jax.fields._parameters import Parameter

Scope = Literal["configuration", "recording"]
_SCOPES: tuple[Scope, ...] = ("configuration", "recording")

XYZ = ("x", "y", "z")


class Quantity(NamedTuple):
    """An array of the model, or of its configurations, whose entries can be unknown.

    Attributes:
        where: Accessor of the array, as `eqx.tree_at` takes it.
        of_configuration: Whether configurations hold it, or the model.
        noun: What its first axis enumerates, like "motor"; empty if nothing.
        names: Names along the first axis, from the model or the configuration.
        components: Names along the last axis; empty for one number.
        scales: Scales that a parameter of it may have.
    """

    where: Callable[[Any], Any]
    of_configuration: bool
    noun: str = ""
    names: Callable[[Any], Sequence[str]] = lambda _: ()
    components: tuple[str, ...] = ()
    scales: tuple[str, ...] = ("linear",)


def _motors(model: Any) -> list[str]:
    """List the names of all actuators, empty unless they are motors."""
    actuators = model.mechanism.actuators
    both = zip(actuators.names, actuators.motor_body, strict=True)
    return [name if body >= 0 else "" for name, body in both]


def _friction(model: Any) -> Any:
    """Return the coefficients of friction of the actuators that have one."""
    groups = model.mechanism.actuators.groups
    return next(group.friction for group in groups if hasattr(group, "friction"))


def _with_friction(model: Any) -> list[str]:
    """List the names of the actuators with friction, in the order of `_friction`."""
    actuators = model.mechanism.actuators
    both = zip(actuators.names, actuators.has_friction, strict=True)
    return [name for name, has_friction in both if has_friction]


QUANTITIES = {
    "motor_zero": Quantity(
        attrgetter("mechanism.motor_zero"),
        of_configuration=False,
        noun="motor",
        names=_motors,
    ),
    "mounting": Quantity(
        attrgetter("mechanism.bodies.mounting_translation"),
        of_configuration=False,
        noun="rigid body",
        names=attrgetter("mechanism.bodies.names"),
        components=XYZ,
    ),
    "friction": Quantity(
        _friction,
        of_configuration=False,
        noun="actuator with friction",
        names=_with_friction,
    ),
    "gravity_tilt": Quantity(
        attrgetter("tilt"), of_configuration=True, components=("first", "second")
    ),
    "load_factor": Quantity(
        attrgetter("load_factor"), of_configuration=True, scales=("linear", "log")
    ),
    "actuator_factor": Quantity(
        attrgetter("actuation.force_factor"),
        of_configuration=True,
        noun="actuator",
        names=attrgetter("actuation.names"),
        scales=("linear", "log"),
    ),
    "recording_offset": Quantity(
        attrgetter("effectors.base.translation"), of_configuration=True, components=XYZ
    ),
    "recording_turn": Quantity(
        attrgetter("effectors.base.rotation"), of_configuration=True, components=XYZ
    ),
    "clamp_stiffness": Quantity(
        attrgetter("springs.stiffness"),
        of_configuration=True,
        noun="support with a stiffness",
        names=attrgetter("springs.names"),
        scales=("log", "linear"),
    ),
}
"""Kinds of parameters that set one entry of an array: one line for a new kind."""


def _as_tuple(parameters: Parameter | Sequence[Parameter]) -> tuple[Parameter, ...]:
    return (parameters,) if isinstance(parameters, Parameter) else tuple(parameters)


class SetupParameter(AbstractEntry):
    """One unknown of the setup, the loads or the recordings.

    It is calibrated together with the material, to decouple them (paper Sec. VII).
    `motor_zero`, `mounting`, `gravity_tilt`, `load_factor`,
    `actuator_factor`, `recording_offset` and `clamp_stiffness` make them.

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
    by: Scope = eqx.field(static=True, default="recording")

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
        if self.parameters[0].scale not in quantity.scales:
            raise ValueError(
                f"{what} of the setup needs scale={quoted(quantity.scales)}: zero is a "
                "value that it may have."
            )
        self._check_scope(what)

    def _check_scope(self, what: str) -> None:
        if self.by not in _SCOPES:
            raise ValueError(
                f'{what}: by must be "configuration" or "recording", got {self.by!r}.'
            )
        if self.each and not self.quantity.of_configuration:
            raise ValueError(
                f"{what}: {self.kind} belongs to the robot, which all configurations "
                "share; leave `each` out."
            )
        if len(self.parameters) != max(1, len(self.each)):
            raise ValueError(
                f"{what}: {len(self.parameters)} unknowns were given, expected one for "
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
    def fields(self) -> tuple[str, ...]:
        """None: it sets no field of the law."""
        return ()

    @property
    def tet_group(self) -> None:
        """None: it belongs to no tets."""
        return None

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Its unknowns."""
        return self.unknowns

    @property
    def label(self) -> str:
        """Names of its unknowns."""
        return ", ".join(parameter.name for parameter in self.parameters)

    def check(self, model: Any) -> None:
        """Raise ValueError unless the model has the motor or the body."""
        if not self.quantity.of_configuration:
            self._index(model)

    def _index(self, owner: Any) -> tuple[int, ...]:
        """Find the index of its entry in the array.

        Raises:
            ValueError: If model or configuration do not have what it belongs to.
        """
        quantity, index = self.quantity, ()
        if quantity.noun:
            names = list(quantity.names(owner))
            known = [name for name in names if name]
            if self.of not in known:
                what = f"{quantity.noun} of parameter {self.label!r}"
                raise unknown_name(what, self.of, known)
            index = (names.index(self.of),)
        if quantity.components:
            index += (quantity.components.index(self.axis),)
        return index

    def apply(
        self, model: Any, configuration: Any, values: Mapping[str, Float[Array, ""]]
    ) -> tuple[Any, Any]:
        """Set its entry; configurations that it does not belong to keep theirs."""
        of_configuration = self.quantity.of_configuration
        owner = configuration if of_configuration else model
        if owner is None:
            return model, configuration
        index, where = self._index(owner), self.quantity.where
        old = jnp.asarray(where(owner))
        new = old[index]
        if self.each:
            own = configuration.key[_SCOPES.index(self.by)]
            for name, parameter in zip(self.each, self.parameters, strict=True):
                new = jnp.where(own == name_key(name), values[parameter.name], new)
        else:
            new = values[self.parameters[0].name]
        owner = eqx.tree_at(where, owner, old.at[index].set(new))
        return (model, owner) if of_configuration else (owner, configuration)

    def renamed(
        self, points: Mapping[str, str], names: Mapping[str, str]
    ) -> "SetupParameter":
        """Return the same unknowns with other names."""
        del points
        own = tuple(replace(q, name=names[q.name], unit="") for q in self.parameters)
        return replace(self, unknowns=own)
