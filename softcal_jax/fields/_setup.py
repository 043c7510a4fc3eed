"""Parameters of setup, loads and recordings that are only roughly known (Sec. VII).

If such an error is not a parameter it biases the moduli, and residuals may hide it.
`KINDS` says which there are.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from inspect import Parameter as Argument, Signature, cleandoc
from textwrap import fill
from typing import Any, Literal

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike

from softcal_jax._text import check_known, name_key
from softcal_jax._typing import Float
from softcal_jax.fields._kinds import KINDS, Kind
from softcal_jax.fields._parameters import (
    AbstractEntry,
    AbstractError,
    Names,
    Parameter,
    Values,
)

By = Literal["configuration", "recording"]
_BY: tuple[By, ...] = ("configuration", "recording")


class SetupParameter(AbstractEntry):
    """One unknown of the setup, the loads or the recordings.

    It is calibrated together with the material, to decouple them (paper Sec. VII).
    Functions named like its kinds make it, `motor_zero` for example.

    Attributes:
        kind: One of `KINDS`.
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

    def check(self, model: Any) -> None:
        """Raise ValueError unless the model has the motor or the body."""
        KINDS[self.kind].check(model, self)

    def apply(self, model: Any, configuration: Any, values: Values) -> tuple[Any, Any]:
        """Set its entry; configurations that it does not belong to keep theirs."""

        def change(old):
            if not self.each:
                return values[self.unknowns[0].name]
            member = configuration.key[_BY.index(self.by)]
            for name, parameter in zip(self.each, self.unknowns, strict=True):
                old = jnp.where(member == name_key(name), values[parameter.name], old)
            return old

        return KINDS[self.kind].changed(model, configuration, self, change)

    def renamed(self, points: Names, names: Names) -> "SetupParameter":
        """Return the same unknowns with other names."""
        unknowns = [replace(q, name=names[q.name], unit="") for q in self.unknowns]
        return replace(self, unknowns=unknowns)


class SetupError(AbstractError):
    """An error of the setup, the loads or a recording, added to its present value.

    The error of a factor is relative; for `kind`, `of` and `axis` see `SetupParameter`.
    """

    kind: str = eqx.field(static=True)
    of: str = eqx.field(static=True, default="")
    axis: str = eqx.field(static=True, default="")

    def check(self, model: Any) -> None:
        KINDS[self.kind].check(model, self)

    def apply(self, model: Any, configuration: Any, values: Values) -> tuple[Any, Any]:
        """Add the error to its entry."""
        error, kind = values[self.name] * self.std, KINDS[self.kind]
        change = lambda old: old + error * (old if kind.relative else 1.0)
        return kind.changed(model, configuration, self, change)


def setup_parameters(
    kind: Kind,
    of: str = "",
    *,
    limit: float,
    prior_std: float | None,
    nominal: Float[ArrayLike, "..."] | Sequence[float] | None = None,
    each: Sequence[str] = (),
    by: By = "recording",
) -> tuple[SetupParameter, ...]:
    """Make the entries of a kind, one per component.

    `limit` is the largest error, in SI units, or factor on a log scale. `nominal` is 0,
    or 1 for a factor.
    """
    axes, log = kind.components or ("",), kind.relative
    middles = np.broadcast_to(float(log) if nominal is None else nominal, len(axes))
    entries = []
    for axis, middle in zip(axes, middles, strict=True):
        name = kind.title.format(of=of, axis=axis)
        unknowns = [
            Parameter(
                own_name,
                field="",
                start=middle,
                lower=max(kind.least, middle / limit if log else middle - limit),
                upper=middle * limit if log else middle + limit,
                scale="log" if log else "linear",
                S=None if log else limit,
                unit=kind.unit,
                prior_std=prior_std,
            )
            for own_name in [f"{name} in {member}" for member in each] or [name]
        ]
        where = {"kind": kind.name, "of": of, "axis": axis}
        entries.append(SetupParameter(**where, unknowns=unknowns, each=each, by=by))
    return tuple(entries)


def _signature(kind: Kind) -> Signature:
    """List the arguments of the function of a kind."""
    needed, several = Argument.empty, len(kind.parts) > 1
    arguments: dict[str, tuple[Any, Any]] = {}
    if kind.noun:
        arguments["of"] = str, kind.unnamed or needed
    if kind.nominal:
        arguments["nominal"] = Sequence[float] if kind.components else float, needed
    by_name = len(arguments)
    usual = None if several else needed
    limit = usual if kind.limit is None else kind.limit
    for part in kind.parts:
        arguments[f"{part.prefix}limit"] = float | None if several else float, limit
        arguments[f"{part.prefix}prior_std"] = float | None, usual
    if kind.each:
        arguments |= {"each": (Sequence[str], ()), "by": (By, "recording")}
    ways = Argument.POSITIONAL_OR_KEYWORD, Argument.KEYWORD_ONLY
    made = [
        Argument(name, ways[i >= by_name], annotation=type_of, default=default)
        for i, (name, (type_of, default)) in enumerate(arguments.items())
    ]
    returned = tuple[SetupParameter, ...] if kind.components else SetupParameter
    return Signature(made, return_annotation=returned)


def _function_of(kind: Kind) -> Callable[..., Any]:
    """Make the function that makes parameters of a kind."""
    signature = _signature(kind)

    def function(*values: Any, **options: Any) -> Any:
        try:
            bound = signature.bind(*values, **options)
        except TypeError as error:
            raise TypeError(f"{kind.name}: {error}") from None
        bound.apply_defaults()
        given, made = bound.arguments, []
        common = {k: given[k] for k in ("of", "nominal", "each", "by") if k in given}
        for part in kind.parts:
            own = {k: given[part.prefix + k] for k in ("limit", "prior_std")}
            if own["limit"] is not None or len(kind.parts) == 1:
                made += setup_parameters(part, **own, **common)
        if not made:
            limits = ", ".join(f"{part.prefix}limit" for part in kind.parts)
            raise ValueError(f"a {kind.name} needs {limits} or both.")
        return tuple(made) if kind.components else made[0]

    units = " and ".join("-" if q.relative else q.unit or "-" for q in kind.parts)
    size = "factor, and 1 over the smallest" if kind.relative else "error"
    size = f"{size} per axis" if kind.components else size
    text = [f"`of` is the name of the {kind.noun}."] if kind.noun else []
    if kind.nominal:
        text.append(f"`nominal` is the value without an error [{kind.unit or '-'}].")
    text.append(f"`limit` is the largest {size}, `prior_std` the standard deviation")
    text.append(f"of the prior, None if not known [{units}].")
    if kind.each:
        text.append("For `each` and `by` see `SetupParameter`.")
    function.__doc__ = f"{cleandoc(kind.words)}\n\n{fill(' '.join(text))}"
    function.__name__ = function.__qualname__ = kind.name
    function.__signature__ = signature  # pyright: ignore[reportFunctionMemberAccess]
    return function


FUNCTIONS = {kind.name: _function_of(kind) for kind in KINDS.values() if kind.words}
"""The functions that make parameters, by kind; `fields` offers each under its name."""


def __getattr__(name: str) -> Callable[..., Any]:
    # For type checkers, which take it for the functions that they cannot see.
    raise AttributeError(f"module 'softcal_jax.fields' has no attribute {name!r}")


def command(
    actuator: str,
    start: Mapping[str, float],
    limits: Mapping[str, tuple[float, float]],
    *,
    unit: str,
) -> SetupParameter:
    """Make what is imposed on an actuator a parameter of each configuration.

    `start` has its value by configuration, and `limits` the smallest and the largest
    one, in the SI `unit` of its force or displacement. Configurations of one recording
    share it, under the name of that.
    """
    unknowns = [
        Parameter(
            f"{actuator} in {name}", "", value, *limits[name], scale="linear", unit=unit
        )
        for name, value in start.items()
    ]
    return SetupParameter("command", actuator, unknowns, each=tuple(start))
