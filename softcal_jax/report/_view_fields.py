"""Fields by which the view of a page colours a body."""

from collections.abc import Mapping, Sequence
from typing import Literal, NamedTuple

import jax.numpy as jnp
import numpy as np

from softcal_jax._module import one_line
from softcal_jax._typing import Float, HostArray
from softcal_jax.calibration import ConfigurationResult
from softcal_jax.equilibrium import Model, tet_states
from softcal_jax.export import (
    STANDARD_ERROR,
    field_units,
    principal_stretches,
    readable_unit,
    tet_fields,
    von_mises_stress,
)
from softcal_jax.report._surface import Surface

Place = Literal["point", "face", "marker"]
"""What has a value: points of the surface, its faces, or the markers alone."""

_AS_THEY_ARE = ("rad", "m")
"""Units whose standard errors are no share of a value, as in an `ErrorBudget`."""


class Field(NamedTuple):
    """A field, in the unit in which it is shown.

    Attributes:
        label: Name and unit.
        unit: The unit.
        place: What has a value.
        values: Values in each configuration, nan where there is none, or None without
            an equilibrium; a single entry for a field that is the same in all.
        note: What to know about it.
    """

    label: str
    unit: str
    place: Place
    values: tuple[Float[HostArray, " n"] | None, ...]
    note: str = ""

    __repr__ = one_line


_STATE = {"largest principal stretch": "", "von Mises stress": "Pa"}
"""Fields of the state of a body, with their units."""

StateFields = Mapping[str, Float[HostArray, " n_tets"]]


def state_fields(model: Model, own: ConfigurationResult) -> StateFields:
    """Compute how far the tets are stretched, and their stress.

    There are none without an equilibrium.
    """
    if not own.converged:
        return {}
    states = tet_states(model, jnp.asarray(own.displacement))
    values = principal_stretches(states)[:, 0], von_mises_stress(states)
    return dict(zip(_STATE, values, strict=True))


def view_fields(
    model: Model,
    shown: Sequence[ConfigurationResult],
    states: Sequence[StateFields],
    surface: Surface,
    errors: Mapping[str, Float[HostArray, " n_tets"]] | None,
) -> list[Field]:
    """Collect the fields: of the state of the body, of its law, and at markers.

    Fields of the law are those that were calibrated, or that vary over the body; where
    all faces belong to rigid bodies nothing has a value.

    Args:
        model: The model.
        shown: The configurations.
        states: Fields of the state in each of them, see `state_fields`.
        surface: Its surface.
        errors: Standard errors of calibrated fields in each tet, by their names; None
            for a simulation.
    """
    moved = [_displacement(own, surface) for own in shown]
    fields = [Field("displacement [mm]", "mm", "point", tuple(moved))]
    fields += _law_fields(model, surface, errors)
    for name, unit in _STATE.items():
        values = [own[name][surface.tets] if own else None for own in states]
        fields.append(_of_faces(name, unit, values, surface))
    distances = [_distances(own) for own in shown]
    if any(d is not None and np.isfinite(d).any() for d in distances):
        label = "distance at markers [mm]"
        note = "Discs at the measured markers; between them nothing is known."
        fields.append(Field(label, "mm", "marker", tuple(distances), note))
    return [own for own in fields if any(map(_has_values, own.values))]


def _has_values(values: Float[HostArray, " n"] | None) -> bool:
    return values is not None and bool(np.isfinite(values).any())


def _displacement(own: ConfigurationResult, surface: Surface):
    if not own.converged:
        return None
    return 1e3 * np.linalg.norm(surface.cut.interpolate(own.displacement), axis=1)


def _distances(own: ConfigurationResult):
    """Compute how far simulated points are from measured ones [mm]."""
    if not own.converged or own.role == "simulation":
        return None
    seen = [point.seen.any() for point in own.points]
    return np.where(seen, 1e3 * np.linalg.norm(own.error_after, axis=1), np.nan)


def _law_fields(
    model: Model,
    surface: Surface,
    errors: Mapping[str, Float[HostArray, " n_tets"]] | None,
) -> list[Field]:
    units, found = field_units(model), tet_fields(model, errors or {})
    fields = []
    for name, values in found.items():
        if name not in units or values.ndim > 1:
            continue
        error = found.get(name + STANDARD_ERROR)
        if error is None and np.ptp(values) <= 1e-9 * np.abs(values).max():
            continue
        unit = units[name]
        fields.append(_of_faces(name, unit, [values[surface.tets]], surface))
        if error is not None:
            title, what, own = f"standard error of {name}", "%", 100.0 * error
            if unit in _AS_THEY_ARE:
                what, own = unit, error
            else:
                own = own / np.where(values == 0.0, np.nan, np.abs(values))
            fields.append(_of_faces(title, what, [own[surface.tets]], surface))
    return fields


def _of_faces(
    name: str,
    unit: str,
    values: Sequence[Float[HostArray, " n_faces"] | None],
    surface: Surface,
) -> Field:
    """Convert values of faces to a readable unit; rigid faces have none."""
    there = np.concatenate([np.zeros(0), *(v for v in values if v is not None)])
    finite = np.abs(there[np.isfinite(there)])
    factor, shown = readable_unit([float(finite.max(initial=0.0))], unit)
    own = tuple(
        None if v is None else np.where(surface.rigid, np.nan, factor * v)
        for v in values
    )
    note = ["Each face has the value of its tet."]
    if unit == "rad":
        note.append("Angles that differ by 180 deg are one axis.")
    if not np.isfinite(there).all():
        note.append("Grey: there is none.")
    return Field(f"{name} [{shown or '-'}]", shown, "face", own, " ".join(note))
