"""From the tables of a project file to the parameters that are calibrated."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from softcal_jax.export import readable_unit
from softcal_jax.fields import (
    ControlPointParameters,
    ControlPoints,
    Entry,
    Parameter,
    ParameterSpace,
    check_names,
)
from softcal_jax.project._laws import ANGLES, CONSTANTS, RATIOS
from softcal_jax.project._problems import at, suggestion
from softcal_jax.project._schema import ProjectTable
from softcal_jax.project._schema_material import MaterialTable
from softcal_jax.project._schema_parameters import (
    ControlPointsTable,
    ParameterTable,
    PerPoint,
)
from softcal_jax.project._setup import build_setup


def build_space(path: Path, table: ProjectTable) -> ParameterSpace | None:
    """The parameters; a start that is left out is the constant of the material.

    Returns:
        None if nothing is to be calibrated.

    Raises:
        ProjectError: If bounds, start or scale do not fit, a set of control points is
            unknown, or what holds between parameters cannot hold.
    """
    sets = {}
    for name, points in table.control_points.items():
        with at(path, f"control_points.{name}"):
            sets[name] = _control_points(points)
    entries: list[Entry] = []
    for own in table.parameters:
        name = own.name or _name(own.field, own.region)
        with at(path, f"parameters.{name}"):
            if own.control_points is None:
                entries.append(_parameter(name, own, table.material))
            else:
                points = _set_of(own.control_points, sets)
                entries.append(_at_control_points(own, points, table.material))
    entries += build_setup(path, table)
    between = table.parameter_space
    if not entries:
        return None
    with at(path, "parameters"):
        check_names(tuple(entries))
    with at(path, "parameter_space"):
        return ParameterSpace(tuple(entries), order=between.order, axes=between.axes)


def _name(field: str, region: str | None) -> str:
    return field if region is None else f"{field}_{region}"


def _control_points(table: ControlPointsTable) -> ControlPoints:
    return ControlPoints(
        table.positions
        if isinstance(table.positions, dict)
        else np.array(table.positions, float).reshape(-1, 3),
        names=table.names,
        power=table.power,
        nearest=table.nearest,
        axes=table.axes,
        max_distance=table.max_distance,
    )


def _set_of(name: str, sets: Mapping[str, ControlPoints]) -> ControlPoints:
    if name in sets:
        return sets[name]
    known = f"Known: {', '.join(sets)}." if sets else "Add a table"
    known += "" if sets else f" [control_points.{name}]."
    raise ValueError(
        f"there are no control points {name!r}.{suggestion(name, sets)} {known}"
    )


def _constant(table: ParameterTable, material: MaterialTable) -> float:
    """The constant of the material, or of the region that the parameter is for."""
    region = material.regions.get(table.region or "")
    own = None if region is None else getattr(region, table.field)
    return getattr(material, table.field) if own is None else own


def _parameter(name: str, table: ParameterTable, material: MaterialTable) -> Parameter:
    start, lower, upper = table.start, table.lower, table.upper
    if start is None:
        start = _constant(table, material)
    assert isinstance(start, float)  # tables are for control points, says the schema
    assert isinstance(lower, float)
    assert isinstance(upper, float)
    _check_range(table.field, material, start, lower, upper)
    return Parameter(
        name,
        table.field,
        start,
        lower,
        upper,
        scale=table.chosen_scale,
        S=table.S,
        region=table.region,
        unit=CONSTANTS[table.field].unit,
        max_step=table.max_step,
        prior_std=table.prior_std,
        # An axis at -90 degrees is the one at 90.
        periodic=table.field in ANGLES and bool(np.isclose(upper - lower, np.pi)),
    )


def _at_control_points(
    table: ParameterTable, points: ControlPoints, material: MaterialTable
) -> ControlPointParameters:
    known = {*table.fixed, *table.tied}
    free = [name for name in points.names if name not in known]
    constant = _constant(table, material)
    each = lambda key, value, default: _each(key, value, points.names, free, default)
    start = each("start", constant if table.start is None else table.start, constant)
    lower = each("lower", table.lower, None)
    upper = each("upper", table.upper, None)
    for name, *values in zip(points.names, start, lower, upper, strict=True):
        if name in free:
            _check_range(table.field, material, *values, at=f"{name}: ")
    angle = table.field in ANGLES
    return ControlPointParameters(
        table.field,
        points,
        start=start,
        lower=lower,
        upper=upper,
        scale=table.chosen_scale,
        S=table.S,
        region=table.region,
        unit=CONSTANTS[table.field].unit,
        # The axis at +90 and at -90 degrees is the same, so is that between them.
        interpolation=table.interpolation or ("director" if angle else "linear"),
        sampling=table.sampling or "centroids",
        fixed=table.fixed,
        tied=table.tied,
        max_step=table.max_step,
        prior_std=table.prior_std,
        core=table.core,
    )


def _each(
    key: str,
    value: PerPoint,
    names: tuple[str, ...],
    free: list[str],
    default: float | None,
) -> np.ndarray:
    """One value per control point; those that are fixed or tied need none."""
    if not isinstance(value, dict):
        return np.full(len(names), value)
    for name in value:
        if name not in names:
            raise ValueError(
                f"{key} names {name!r}, which is no control point."
                f"{suggestion(name, names)} Known: {', '.join(names)}."
            )
    missing = [name for name in free if name not in value]
    if missing and default is None:
        raise ValueError(f"{key} has no value for {', '.join(missing)}.")
    spare = next(iter(value.values()), 0.0) if default is None else default
    return np.array([value.get(name, spare) for name in names])


def _check_range(
    field: str,
    material: MaterialTable,
    start: float,
    lower: float,
    upper: float,
    *,
    at: str = "",
) -> None:
    """Raise unless bounds and start fit, in the units that a reader expects."""

    def show(value: float) -> str:
        factor, unit = readable_unit([value], CONSTANTS[field].unit)
        return f"{factor * value:.6g} {unit}".rstrip()

    if lower >= upper:
        raise ValueError(
            f"{at}the bounds are crossed, lower {show(lower)} is not below upper "
            f"{show(upper)}."
        )
    if field == "nu" and material.law != "fibre-reinforced":
        if not (-1.0 < lower and upper < 0.5):
            raise ValueError(
                f"{at}the bounds of nu must lie in (-1, 0.5), got [{lower:g}, "
                f"{upper:g}]."
            )
    if field not in RATIOS + ANGLES and lower <= 0.0:
        raise ValueError(f"{at}lower must be positive, got {show(lower)}.")
    if not lower <= start <= upper:
        raise ValueError(
            f"{at}the start, {show(start)}, lies outside the bounds, {show(lower)} to "
            f"{show(upper)}. (Without `start` it is the constant of [material].)"
        )
