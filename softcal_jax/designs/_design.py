"""Design: fields and actuation for goals, by the loop of the calibration (Eq. 9)."""

import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from softcal_jax._names import check_known, listed
from softcal_jax._units import readable
from softcal_jax.calibration import (
    CalibrationResult,
    CalibrationSettings,
    CalibrationWarning,
    HistoryEntry,
    SearchProgress,
    as_sequence,
    calibrate,
)
from softcal_jax.configurations import (
    Configuration,
    ConfigurationLanes,
    ImposedDisplacement,
    configuration_lanes,
    motions,
)
from softcal_jax.control import GoalFit, Limits, limit_arrays
from softcal_jax.designs._foam import FoamTable
from softcal_jax.designs._foam_region import foam_region, isotropic_range
from softcal_jax.designs._holding import held_by, trades
from softcal_jax.designs._printing import Printing, design_goals
from softcal_jax.designs._result import Alternative, DesignResult, error_of
from softcal_jax.equilibrium import Model, NewtonSettings
from softcal_jax.fields import (
    ControlPointParameters,
    ControlPoints,
    Entry,
    Parameter,
    ParameterSpace,
    SetupParameter,
    as_space,
    command,
    exactly_known,
)
from softcal_jax.unknowns import held_nodes

LOOP = CalibrationSettings(damping=1e-4, least_fall=1e-4, least_cost=1.0)
"""Settings of the loop: of the many fields that come as near, a close one is taken.

The damping holds back directions that hardly move a goal, and does not move the
minimum; and a fall of the cost by less is no better design.
"""


class _Asked(NamedTuple):
    """What the designs of one call have in common."""

    model: Model
    configurations: tuple[Configuration, ...]
    commands: tuple[Entry, ...]
    foam: FoamTable | None
    seed: int
    settings: CalibrationSettings
    newton: NewtonSettings | None
    progress: Callable[[HistoryEntry], None] | None
    search_progress: Callable[[SearchProgress], None] | None


def design(
    model: Model,
    parameters: ParameterSpace | Entry | Sequence[Entry] | None,
    configurations: Configuration | Sequence[Configuration],
    *,
    limits: Mapping[str, Limits] | None = None,
    foam: FoamTable | None = None,
    printing: Printing | None = None,
    starts: int | None = None,
    seed: int = 0,
    settings: CalibrationSettings | None = None,
    newton: NewtonSettings | None = None,
    progress: Callable[[HistoryEntry], None] | None = None,
    search_progress: Callable[[SearchProgress], None] | None = None,
    answer: Callable[[DesignResult], None] = lambda _: None,
    stage: Callable[[str], None] = lambda _: None,
) -> DesignResult:
    """Find the fields, and for each goal the actuation, that meet goals together.

    Eq. (9) with lambda_p and every lambda_a unknown: one stacked, bounded QP, by the
    loop of `calibrate` (paper, abstract and Sec. VIII).

    Args:
        model: The body.
        parameters: What may be designed, with start and bounds: fields at control
            points, or any parameter that can be calibrated; None for actuation alone.
        configurations: The goals: what markers and effectors have as measured values,
            with their `std` as tolerance. A curve is several of them.
        limits: Actuators whose imposed value is designed, with both ends; they start at
            their value in the `actuation` of each configuration. Others keep theirs.
        foam: What can be printed: E_l and E_t, or E, stay within what it reaches. Their
            fields need scale and interpolation "log".
        printing: Errors of printing.
        starts: Most starts of the search, as in `calibrate`.
        seed: Seed of the random starts.
        settings: Settings of the loop.
        newton: Settings of the equilibrium.
        progress: Called after each step of the design itself, once the search is over.
        search_progress: Called after each step of a search.
        answer: Called with the design before anything is compared with it.
        stage: Called with a text: what is computed next.

    Returns:
        The design, and the same goals with the best homogeneous material and with
        actuation alone; `result.met` says whether it meets all goals. Ctrl-C ends the
        search, or leaves out the comparison.

    Raises:
        ValueError: If nothing may be designed, no effector has a goal, a goal is
            farther away than the body is long or of an effector that nothing moves,
            limits clash or have no ends, or the foam has none of the moduli.
        RuntimeError: If a configuration has no equilibrium at the start.
    """
    goals = as_sequence(configurations)
    space = None if parameters is None else as_space(parameters)
    commands = _commands(model, goals, limits or {})
    if space is None and not commands:
        raise ValueError(
            "nothing may be designed: give parameters of the material, or limits of "
            "actuators."
        )
    _check_goals(model, goals)
    loop = settings or LOOP
    calls = progress, search_progress
    asked = _Asked(model, goals, commands, foam, seed, loop, newton, *calls)
    fit = _fit(asked, space, starts)
    asked = asked._replace(progress=None)
    reached = design_goals(fit, printing or Printing())
    missed = any(not goal.met for goal in reached)
    result = DesignResult(
        goals=reached,
        fit=fit,
        configurations=_commanded(fit, goals),
        held_by=held_by(fit, reached) if missed else (),
        trades=trades(fit, reached) if missed else (),
        alternatives=(),
        foam=foam,
        material=() if space is None else tuple(space.names),
    )
    if space is None or fit.interrupted:
        return result
    answer(result)
    return replace(result, alternatives=tuple(_alternatives(asked, space, stage)))


def _commands(
    model: Model, goals: Sequence[Configuration], limits: Mapping[str, Limits]
) -> tuple[SetupParameter, ...]:
    """Make what is imposed on the actuators parameters, each by configuration."""
    used = [name for goal in goals for name in goal.actuation]
    check_known("actuator with limits, in the actuation of a goal,", used, *limits)
    actuators, entries = model.mechanism.actuators, []
    in_each = [
        limit_arrays(
            model.mechanism,
            goal,
            {name: given for name, given in limits.items() if name in goal.actuation},
        )
        for goal in goals
    ]
    for name in limits:
        a = actuators.names.index(name)
        kind, start, ends, unit = actuators.kinds[a], {}, {}, ""
        for goal, allowed in zip(goals, in_each, strict=True):
            if name not in goal.actuation:
                continue
            imposed = goal.actuation[name]
            by_displacement = isinstance(imposed, ImposedDisplacement)
            unit = kind.displacement_unit if by_displacement else kind.force_unit
            low, high = map(float, allowed.inputs[:, a])
            if not np.isfinite([low, high]).all() or low >= high:
                what = "displacement" if by_displacement else "force"
                raise ValueError(
                    f"limits of the {what} of {kind.noun} {name!r} are {low:g} to "
                    f"{high:g} {unit}, and a design needs two finite ends that differ."
                )
            other = "force" if by_displacement else "displacement"
            if np.isfinite([*getattr(limits[name], other), limits[name].step]).any():
                raise ValueError(
                    f"{kind.noun} {name!r}: a design limits what is imposed on it, not "
                    f"its {other} or its steps: leave those limits out, or impose the "
                    "quantity that has limits."
                )
            start[goal.name], ends[goal.name] = imposed.value, (low, high)
        entries.append(command(name, start, ends, unit=unit or ""))
    return tuple(entries)


def _check_goals(model: Model, goals: Sequence[Configuration]) -> None:
    """Raise ValueError for goals that are probably mistakes."""
    lanes = configuration_lanes(model.mesh, goals, model.mechanism)
    show = lambda value: readable(float(f"{value:.3g}"), "m")
    for goal, records in zip(goals, lanes.effectors, strict=True):
        if not goal.is_measured or not any(r.seen.any() for r in records):
            raise ValueError(
                f"configuration {goal.name!r} has no goal: give markers or effectors "
                "measured values, which are its goals."
            )
        for name, moved in motions(records).items():
            distance, size = float(np.linalg.norm(moved)), model.mesh.size
            if distance > size:
                raise ValueError(
                    f"the goal of {name!r} in {goal.name!r} is {show(distance)} from "
                    f"its place at rest, and the body is {show(size)} long: check the "
                    "unit of length and the frame."
                )
    _check_movable(model, goals, lanes)


def _check_movable(
    model: Model, goals: Sequence[Configuration], lanes: ConfigurationLanes
) -> None:
    """Raise ValueError for the goal of a point that is held."""
    held = held_nodes(model, lanes.arrays)
    arrays = lanes.arrays.effectors
    for c, (goal, records) in enumerate(zip(goals, lanes.effectors, strict=True)):
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


def _fit(
    asked: _Asked, space: ParameterSpace | None, starts: int | None
) -> CalibrationResult:
    """Fit the goals, by the loop of the calibration."""
    entries = () if space is None else space.entries
    whole = (
        ParameterSpace(asked.commands)
        if space is None
        else replace(space, entries=(*entries, *asked.commands))
    )
    if asked.foam is not None:
        whole = _within(asked.foam, whole)
    with warnings.catch_warnings():
        # That goals are fewer than parameters is the rule here.
        warnings.simplefilter("ignore", CalibrationWarning)
        return calibrate(
            asked.model,
            whole,
            asked.configurations,
            noise="stated",
            uncertain=exactly_known(),
            settings=asked.settings,
            newton=asked.newton,
            starts=starts,
            seed=asked.seed,
            intervals=None,
            progress=asked.progress,
            search_progress=asked.search_progress,
        )


def _within(foam: FoamTable, space: ParameterSpace) -> ParameterSpace:
    """Limit the moduli of a design to those of a foam."""
    names = {field.rpartition(".")[2]: field for field in space.field_names}
    if {"E_l", "E_t"} <= {*names}:
        fading = any(getattr(entry, "core", 0.0) > 0.0 for entry in space.entries)
        region = foam_region(foam, names["E_l"], names["E_t"], fading=fading)
        # The region also says which of the two is the larger one.
        return replace(space, regions=(region,), tensor_steps=False)
    if "E" not in names:
        raise ValueError(
            f"{foam.infill} limits E_l and E_t together, or E of an isotropic body, "
            f"and the design has {listed(space.field_names) or 'no field'}: design "
            "both moduli, or leave the foam out."
        )
    ends = isotropic_range(foam)
    entries = [
        _narrowed(entry, *ends, foam.infill) if names["E"] in entry.fields else entry
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


def _alternatives(
    asked: _Asked, space: ParameterSpace, stage: Callable[[str], None]
) -> Iterator[Alternative]:
    """Fit the same goals with less that may be designed, until interrupted."""
    if any(len(entry.parameters) > 1 for entry in space.entries if entry.fields):
        stage("the same goals with the best homogeneous material")
        fit = _fit(asked, _homogeneous(asked.model, space), None)
        if fit.interrupted:
            return
        yield _alternative("the best homogeneous material", fit)
    if asked.commands:
        stage("the same goals with actuation alone")
        z = space.start()
        fit = _fit(
            asked._replace(model=space.model_at(asked.model, z), foam=None), None, 1
        )
        if not fit.interrupted:
            yield _alternative("actuation alone", fit)


def _alternative(name: str, fit: CalibrationResult) -> Alternative:
    goals = tuple(
        GoalFit(effector)
        for pose in fit.configurations
        for effector in pose.effectors
        if effector.seen.any()
    )
    return Alternative(name, error_of(goals), fit)


def _homogeneous(model: Model, space: ParameterSpace) -> ParameterSpace:
    """Return the parameters with one control point for each field."""
    middle = np.asarray(model.mesh.points).mean(axis=0)

    def one(entry: Entry) -> Entry:
        if not isinstance(entry, ControlPointParameters):
            return entry
        return replace(
            entry,
            control_points=ControlPoints({"body": middle}, max_distance=np.inf),
            start=np.median(entry.start),
            lower=np.min(entry.lower),
            upper=np.max(entry.upper),
            fixed=None,
            tied=None,
        )

    return replace(space, entries=[one(entry) for entry in space.entries])


def _commanded(
    fit: CalibrationResult, goals: Sequence[Configuration]
) -> tuple[Configuration, ...]:
    """Return the goals with the actuation found."""
    values = {
        (unknown.name, entry.of): fit.value(unknown.name)
        for entry in fit.space.entries
        if isinstance(entry, SetupParameter) and entry.kind == "command"
        for unknown in entry.unknowns
    }

    def value(goal: Configuration, name: str) -> float:
        return values.get((f"{name} in {goal.name}", name), goal.actuation[name].value)

    return tuple(
        replace(
            goal,
            actuation={
                name: replace(imposed, value=value(goal, name))
                for name, imposed in goal.actuation.items()
            },
        )
        for goal in goals
    )
