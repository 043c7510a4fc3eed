"""What a design is asked for: commands as parameters, goals, and the foam's limits."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from softcal_jax._text import check_known, listed
from softcal_jax._units import readable
from softcal_jax.configurations import (
    Configuration,
    configuration_lanes,
    motions,
)
from softcal_jax.control import Limits, commanded
from softcal_jax.designs._foam import FoamTable, foam_region, isotropic_range
from softcal_jax.equilibrium import Model
from softcal_jax.fields import (
    ControlPointParameters,
    Entry,
    Parameter,
    ParameterSpace,
    SetupParameter,
    command,
    find_field,
)
from softcal_jax.materials import youngs_moduli
from softcal_jax.unknowns import held_nodes


def commands(
    model: Model, goals: Sequence[Configuration], limits: Mapping[str, Limits]
) -> tuple[SetupParameter, ...]:
    """Make what is imposed on the actuators parameters, each by configuration."""
    used = [name for goal in goals for name in goal.actuation]
    check_known("actuator with limits, in the actuation of a goal,", used, *limits)
    actuators, entries = model.mechanism.actuators, []
    in_each = []
    for goal in goals:
        own = {name: given for name, given in limits.items() if name in goal.actuation}
        inputs = commanded(model.mechanism, goal, own)
        in_each.append(dict(zip(goal.actuation, inputs, strict=True)))
    for name in limits:
        a = actuators.names.index(name)
        kind, start, ends, unit = actuators.kinds[a], {}, {}, ""
        for goal, inputs in zip(goals, in_each, strict=True):
            if name not in inputs:
                continue
            one, (low, high) = inputs[name], inputs[name].imposed
            unit = kind.displacement_unit if one.by_displacement else kind.force_unit
            if not np.isfinite([low, high]).all() or low >= high:
                what = "displacement" if one.by_displacement else "force"
                raise ValueError(
                    f"limits of the {what} of {kind.noun} {name!r} are {low:g} to "
                    f"{high:g} {unit}, and a design needs two finite ends that differ."
                )
            other = "force" if one.by_displacement else "displacement"
            if np.isfinite([*getattr(limits[name], other), limits[name].step]).any():
                raise ValueError(
                    f"{kind.noun} {name!r}: a design limits what is imposed on it, not "
                    f"its {other} or its steps: leave those limits out, or impose the "
                    "quantity that has limits."
                )
            start[goal.name], ends[goal.name] = one.start, (low, high)
        entries.append(command(name, start, ends, unit=unit or ""))
    return tuple(entries)


def check_goals(model: Model, goals: Sequence[Configuration]) -> None:
    """Raise ValueError for goals that are probably mistakes."""
    lanes = configuration_lanes(model.mesh, goals, model.mechanism)
    held, arrays = held_nodes(model, lanes.arrays), lanes.arrays.effectors
    show = lambda value: readable(float(f"{value:.3g}"), "m")
    for c, (goal, records) in enumerate(zip(goals, lanes.effectors, strict=True)):
        if not goal.is_measured or not any(r.seen.any() for r in records):
            raise ValueError(
                f"configuration {goal.name!r} has no goal: give markers or effectors "
                "measured values, which are its goals."
            )
        for name, moved in motions(records).items():
            distance = float(np.linalg.norm(moved[np.isfinite(moved)]))
            size = model.mesh.size
            if distance > size:
                raise ValueError(
                    f"the goal of {name!r} in {goal.name!r} is {show(distance)} from "
                    f"its place at rest, and the body is {show(size)} long: check the "
                    "unit of length and the frame."
                )
        for record in records:
            if record.quantity != "point" or not record.seen.any():
                continue
            nodes = np.asarray(arrays.nodes)[c, record.index]
            acts = np.asarray(arrays.weights)[c, record.index] != 0.0
            mine = nodes[acts]
            if (mine < model.mesh.n_nodes).all() and held[c, mine].all():
                raise ValueError(
                    f"nothing can move {record.name!r} in {goal.name!r}: its place is "
                    "held. Take its goal out, or free it."
                )


def within(foam: FoamTable, model: Model, space: ParameterSpace) -> ParameterSpace:
    """Limit the moduli of a design to those of a foam."""
    names = {find_field(model, name).path: name for name in space.field_names}
    moduli = [names.get("law" + path, "") for path, _ in youngs_moduli(model.law)]
    if len(moduli) == 2 and all(moduli):
        fading = any(getattr(entry, "core", 0.0) > 0.0 for entry in space.entries)
        region = foam_region(foam, *moduli, fading=fading)
        # The region also says which of the two is the larger one.
        return replace(space, regions=(region,), tensor_steps=False)
    if len(moduli) != 1 or not all(moduli):
        raise ValueError(
            f"{foam.infill} limits E_l and E_t together, or E of an isotropic body, "
            f"and the design has {listed(space.field_names)}: design "
            "both moduli, or leave the foam out."
        )
    ends = isotropic_range(foam)
    entries = [
        _narrowed(entry, *ends, foam.infill) if moduli[0] in entry.fields else entry
        for entry in space.entries
    ]
    return replace(space, entries=entries)


def _narrowed(entry: Entry, low: float, high: float, infill: str) -> Entry:
    """Return a field with bounds within two ends [Pa]."""
    assert isinstance(entry, Parameter | ControlPointParameters)
    lower, upper = np.maximum(entry.lower, low), np.minimum(entry.upper, high)
    if np.any(lower >= upper):
        raise ValueError(
            f"{entry.label}: isotropic {infill} has {readable(low, 'Pa')} to "
            f"{readable(high, 'Pa')}, outside of the bounds of the design."
        )
    start = np.clip(entry.start, lower, upper)
    return replace(entry, start=start, lower=lower, upper=upper)
