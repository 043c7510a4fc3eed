"""The keys of a project file that say what is calibrated, and where it varies."""

from typing import Annotated, Any, Literal

from pydantic import (
    Discriminator,
    Field,
    Tag,
    field_validator,
    model_validator,
)

from softcal_jax.project._laws import ANGLES, CONSTANTS, RATIOS, parse_in_si
from softcal_jax.project._problems import shown
from softcal_jax.project._table import (
    Integer,
    Length,
    Number,
    Position,
    Table,
    table_or_vector,
)

PerPoint = float | dict[str, float]
"""One value for all control points, or a table of their names."""


class ControlPointsTable(Table):
    """Places where fields of the law have values of their own."""

    positions: Annotated[
        Annotated[dict[str, Position], Tag("(table)")]
        | Annotated[tuple[Position, ...], Tag("(vector)")],
        Discriminator(table_or_vector),
    ] = Field(
        description='names and positions, { "CP 1" = "(0, 7.5, 7.5) mm" }, or a list '
        "of positions"
    )
    names: tuple[str, ...] | None = None
    power: Number = 2.0
    nearest: Integer | None = None
    axes: str = "xyz"
    max_distance: Length | None = None

    @model_validator(mode="after")
    def _check(self) -> "ControlPointsTable":
        if self.names is not None and isinstance(self.positions, dict):
            raise ValueError(
                "`positions` is a table, which names its points; leave `names` out, or "
                "give a list of positions."
            )
        return self


class ParameterTable(Table):
    """One unknown constant of the material, or one per control point."""

    field: Literal[
        "E", "nu", "E_t", "E_l", "nu_t", "nu_tl", "mu_l", "theta", "phi", "density"
    ] = Field(description='a constant of the material, like "E" or "density"')
    name: str | None = None
    region: str | None = None
    control_points: str | None = None
    lower: PerPoint = Field(description='smallest value allowed: "50 kPa"')
    upper: PerPoint = Field(description='largest value allowed: "1 MPa"')
    start: PerPoint | None = None
    scale: Literal["log", "linear"] | None = None
    S: float | None = None
    max_step: Number | None = None
    interpolation: Literal["linear", "log", "director"] | None = None
    sampling: Literal["centroids", "quadrature"] | None = None
    fixed: dict[str, float] = Field(default_factory=dict)
    tied: dict[str, str] = Field(default_factory=dict)
    prior_std: float | None = None
    core: float = 0.0

    @property
    def chosen_scale(self) -> Literal["log", "linear"]:
        """The scale of the file, or that of the field."""
        return self.scale or _scale_of(self.field)

    @field_validator("lower", "upper", "start", "S", "fixed", mode="before")
    @classmethod
    def _parse(cls, value: Any, info: Any) -> Any:
        # `field` stands first, so it is known here unless it was wrong itself.
        field = info.data.get("field")
        if info.field_name == "fixed" and not isinstance(value, dict):
            raise ValueError(
                f"got {value!r}; expected a table of control points and their values, "
                'like { "CP 1" = "700 kPa" }.'
            )
        if field is None:
            return {} if info.field_name == "fixed" else 0.0
        if isinstance(value, dict) and info.field_name != "S":
            return {
                name: _at_point(name, entry, field) for name, entry in value.items()
            }
        return _parsed(value, field)

    @field_validator("prior_std", mode="before")
    @classmethod
    def _parse_prior(cls, value: Any, info: Any) -> Any:
        field = info.data.get("field")
        if field is None:
            return None  # it was wrong itself
        if (info.data.get("scale") or _scale_of(field)) == "linear":
            return _parsed(value, field)
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise ValueError(
                f"got {shown(value)}; on a log scale it is relative: expected a "
                "number, like 0.3 for 30 %."
            )
        return float(value)

    @field_validator("control_points", mode="before")
    @classmethod
    def _check_set(cls, value: Any) -> Any:
        if not isinstance(value, str):
            raise ValueError(
                f"got {value!r}; expected the name of one set in [control_points], "
                'like "ends". All control points of that set are calibrated.'
            )
        return value

    @model_validator(mode="after")
    def _check(self) -> "ParameterTable":
        if self.control_points is not None:
            if self.name is not None:
                raise ValueError(
                    "`name` is for a single parameter; at control points the names are "
                    f'made, like "{self.field} of CP 1". Leave it out.'
                )
            return self
        options = ("interpolation", "sampling", "fixed", "tied", "core")
        given = [key for key in options if getattr(self, key)]
        given += [
            f"a table for `{key}`"
            for key in ("start", "lower", "upper")
            if isinstance(getattr(self, key), dict)
        ]
        if given:
            raise ValueError(
                f"{given[0]} is for control points: name a set of them, like "
                'control_points = "ends".'
            )
        return self


def _scale_of(field: str) -> Literal["log", "linear"]:
    return "linear" if field in RATIOS + ANGLES else "log"


def _parsed(value: Any, field: str) -> float:
    return parse_in_si(value, CONSTANTS[field].unit)


def _at_point(name: str, value: Any, field: str) -> float:
    try:
        return _parsed(value, field)
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from error


class ParameterSpaceTable(Table):
    """What holds between parameters."""

    order: tuple[tuple[str, str], ...] = ()
    axes: tuple[tuple[str, str, str], ...] = ()
