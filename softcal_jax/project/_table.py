"""What all tables of a project file share; parsed values are in SI units."""

from collections.abc import Callable, Sequence
from typing import Annotated, Any, ClassVar, TypeVar, get_args

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Discriminator,
    Field,
    GetCoreSchemaHandler,
    PrivateAttr,
    Strict,
    Tag,
    model_validator,
)
from pydantic_core import PydanticKnownError, core_schema

from softcal_jax.project._quantities import (
    ACCELERATION,
    ANGLE,
    BEDDING,
    DENSITY,
    FORCE,
    LENGTH,
    MASS,
    PRESSURE,
    TIME,
    parse_direction,
    scalar,
    vector,
)

Number = Annotated[float, Strict()]
Integer = Annotated[int, Strict()]
Flag = Annotated[bool, Strict()]
Triple = tuple[float, float, float]

Length = Annotated[float, BeforeValidator(scalar(LENGTH, "not negative"))]
PositiveLength = Annotated[float, BeforeValidator(scalar(LENGTH, "positive"))]
Density = Annotated[float, BeforeValidator(scalar(DENSITY, "not negative"))]
Angle = Annotated[float, BeforeValidator(scalar(ANGLE))]
Time = Annotated[float, BeforeValidator(scalar(TIME))]
Mass = Annotated[float, BeforeValidator(scalar(MASS, "not negative"))]
Stiffness = Annotated[float, BeforeValidator(scalar(BEDDING, "positive"))]
AccelerationSize = Annotated[float, BeforeValidator(scalar(ACCELERATION))]
Position = Annotated[Triple, BeforeValidator(vector(LENGTH))]
Corner = Annotated[Triple, BeforeValidator(vector(LENGTH, "any"))]
Extent = Annotated[Triple, BeforeValidator(vector(LENGTH, "positive"))]
Acceleration = Annotated[Triple, BeforeValidator(vector(ACCELERATION))]
Force = Annotated[Triple, BeforeValidator(vector(FORCE))]
Traction = Annotated[Triple, BeforeValidator(vector(PRESSURE))]
RotationVector = Annotated[Triple, BeforeValidator(vector(ANGLE))]
Direction = Annotated[Triple, BeforeValidator(parse_direction)]

Names = Annotated[
    tuple[str, ...],
    BeforeValidator(lambda value: [value] if isinstance(value, str) else value),
]
"""One name, or a list of them."""

Surface = Annotated[str, Field(description='name of a surface group: "z_max"')]

T = TypeVar("T")
V = TypeVar("V")

TableOr = Annotated[
    Annotated[T, Tag("(table)")] | Annotated[V, Tag("(vector)")],
    Discriminator(lambda v: "(table)" if isinstance(v, dict) else "(vector)"),
]
"""A table, or else a list or text."""


class Table(BaseModel):
    """A table of the file; unknown keys are errors."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    choice: ClassVar[str] = ""
    """How a file chooses this kind of table, for messages; empty if by its keys."""

    _typed: dict[str, str] = PrivateAttr(default_factory=dict)

    @model_validator(mode="wrap")
    @classmethod
    def _remember(cls, raw: Any, handler: Callable[[Any], Any]) -> Any:
        table = handler(raw)
        if isinstance(raw, dict):
            texts = {k: v for k, v in raw.items() if isinstance(v, str)}
            table._typed = texts
        return table

    @property
    def typed(self) -> dict[str, str]:
        """Its texts, quantities with their units among them, as they were typed."""
        return self._typed

    @classmethod
    def claims(cls, value: dict[str, Any]) -> bool | None:
        """Tell by its values whether a table is of this kind; None if by its keys."""
        del value

    @classmethod
    def foreign(cls, key: str) -> str | None:
        """Say where an unknown key belongs, for a message; None if nowhere."""
        del key


class Maker(Table):
    """A table that makes an object; its keys except `type` are the arguments in order.

    What the table is for stands in the class that it `makes`.

    Attributes:
        makes: What it makes.
        by_name: Keys that are arguments by name instead.
    """

    makes: ClassVar[type[Any]]
    by_name: ClassVar[tuple[str, ...]] = ()

    def build(self, *first: Any) -> Any:
        """Build the object; `first` are arguments before those of the table."""
        own = {key: _built(value) for key, value in self if key != "type"}
        named = {key: own.pop(key) for key in self.by_name}
        return self.makes(*first, *own.values(), **named)


def _built(value: Any) -> Any:
    if isinstance(value, tuple):
        return tuple(map(_built, value))
    return value.build() if isinstance(value, Maker) else value


class ByKeys:
    """Mark a union of tables that are distinguished by their required keys.

    A kind that `claims` the table is chosen; else that with most of its own keys
    present, and among equals one with all of them. If several remain, the error lists
    the choices.
    """

    def __get_pydantic_core_schema__(
        self, source: Any, handler: GetCoreSchemaHandler
    ) -> core_schema.CoreSchema:
        """Build the union, with a clear error where no table or several fit."""
        kinds = get_args(source)
        own = dict(zip([k.__name__ for k in kinds], own_keys(kinds), strict=True))

        def fitting(value: dict[str, Any]) -> list[str]:
            claims = {kind.__name__: kind.claims(value) for kind in kinds}
            if True in claims.values():
                return [name for name in own if claims[name]]
            left = [name for name in own if claims[name] is None]
            given = {name: sum(k in value for k in own[name]) for name in left}
            rank = {name: (n, n == len(own[name])) for name, n in given.items()}
            return [name for name in left if rank[name] == max(rank.values())]

        def check(value: Any) -> Any:
            if not isinstance(value, dict):
                raise PydanticKnownError("model_type", {"class_name": "table"})
            if len(fitting(value)) != 1:
                every = [key for keys in own.values() for key in keys]
                given = " and ".join(key for key in value if key in every) or "none"
                listed = ", ".join(" and ".join(keys) for keys in own.values())
                raise ValueError(f"expected exactly one of {listed}; got {given}.")
            return value

        union = core_schema.tagged_union_schema(
            {kind.__name__: handler.generate_schema(kind) for kind in kinds},
            discriminator=lambda value: fitting(value)[0],
        )
        return core_schema.no_info_before_validator_function(check, union)


def own_keys(kinds: Sequence[type[BaseModel]]) -> list[list[str]]:
    """Return the required keys of each table, without those that all have."""
    needed = [
        [key for key, field in kind.model_fields.items() if field.is_required()]
        for kind in kinds
    ]
    shared = set.intersection(*(set(kind.model_fields) for kind in kinds))
    return [[key for key in keys if key not in shared] for keys in needed]
