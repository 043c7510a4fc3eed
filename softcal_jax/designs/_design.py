"""Design: fields and actuation for goals, by the loop of the calibration (Eq. 9)."""

import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, Literal, NamedTuple

import jax.numpy as jnp
import numpy as np

from softcal_jax._process import progress_line
from softcal_jax._typing import Array, Float
from softcal_jax.calibration import (
    CalibrationResult,
    CalibrationSettings,
    CalibrationWarning,
    Event,
    FitOptions,
    SearchProgress,
    Watch,
    as_sequence,
    checked_problem,
    fit as fit_problem,
    number_of_starts,
)
from softcal_jax.configurations import Configuration
from softcal_jax.control import Limits
from softcal_jax.designs._asked import check_goals, commands, within
from softcal_jax.designs._foam import FoamTable
from softcal_jax.designs._peaks import (
    KEPT,
    MOST_TIGHTENED,
    TIGHTER,
    PeakLimits,
    aimed,
    peaks,
)
from softcal_jax.designs._printing import (
    Change,
    Printing,
    design_goals,
    over_specimens,
    specimens,
)
from softcal_jax.designs._result import (
    Alternative,
    DesignResult,
    error_of,
    expected_of,
    held_by,
    trades,
)
from softcal_jax.equilibrium import Model, NewtonSettings
from softcal_jax.fields import (
    ControlPointParameters,
    ControlPoints,
    Entry,
    ParameterSpace,
    as_space,
    exactly_known,
)

DesignWatch = Callable[[Event | DesignResult], None]

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
    largest: PeakLimits
    change: Change | None
    seed: int
    settings: CalibrationSettings
    newton: NewtonSettings | None
    watch: Watch | Literal[False] | None


def design(
    model: Model,
    parameters: ParameterSpace | Entry | Sequence[Entry] | None,
    configurations: Configuration | Sequence[Configuration],
    *,
    limits: Mapping[str, Limits] | None = None,
    foam: FoamTable | None = None,
    largest: PeakLimits | None = None,
    change: Change | None = None,
    printing: Printing | None = None,
    robust: bool = False,
    starts: int | None = None,
    seed: int = 0,
    settings: CalibrationSettings | None = None,
    newton: NewtonSettings | None = None,
    watch: DesignWatch | Literal[False] | None = None,
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
        largest: Limits of the stretch and the stress anywhere in the body.
        change: Change between neighbouring control points that costs as much as a goal
            that is a tolerance off; by default it costs nothing.
        printing: Errors of printing.
        robust: Whether to go on from the design of least error as ordered to one of
            least expected error, over `specimens` of prints; with as many equilibria
            per goal as there are uncertain parameters, and two more.
        starts: Most starts of the search, as in `calibrate`.
        seed: Seed of the random starts.
        settings: Settings of the loop.
        newton: Settings of the equilibrium.
        watch: Called with what happens, as that of `calibrate`, but with the design
            before anything is compared with it. By default, on a terminal and in
            notebooks, a line says what is under way; False switches it off.

    Returns:
        The design, and the same goals with the best homogeneous material and with
        actuation alone; `result.met` says whether it meets all goals. Ctrl-C ends the
        search, or leaves out the comparison.

    Raises:
        ValueError: If nothing may be designed, no effector has a goal, a goal is
            farther away than the body is long or of an effector that nothing moves,
            limits clash or have no ends, the foam has none of the moduli, or `robust`
            or `change` have nothing to act on.
        RuntimeError: If a configuration has no equilibrium at the start.
    """
    # Configurations of one recording would share a command.
    goals = tuple(replace(c, recording=None) for c in as_sequence(configurations))
    space = None if parameters is None else as_space(parameters)
    entries = commands(model, goals, limits or {})
    if space is None and not entries:
        raise ValueError(
            "nothing may be designed: give parameters of the material, or limits of "
            "actuators."
        )
    check_goals(model, goals)
    printing, largest = printing or Printing(), largest or PeakLimits()
    if robust and not (space and printing.touches(model, space)):
        raise ValueError(
            "robust: nothing that is designed has errors of printing; leave it out."
        )
    tell = watch or (lambda _: None)
    # What is under way is said here.
    is_step = lambda event: not isinstance(event, str)
    of_fit = _part_of(watch, is_step)
    options = seed, settings or LOOP, newton, of_fit
    asked = _Asked(model, goals, entries, foam, largest, change, *options)
    fit = _fit(asked, space, starts=starts)
    reached, others, lost = design_goals(fit, printing), [], ""
    of_search = _part_of(watch, lambda event: isinstance(event, SearchProgress))
    asked, of_prints = asked._replace(watch=of_search or False), None
    if robust and not fit.interrupted:
        tell("the least expected error of prints")
        try:
            of_prints = _robust(asked, space, fit, printing)
        except (RuntimeError, KeyboardInterrupt) as error:
            lost = str(error) or "interrupted."  # but not the design so far
            fit = replace(fit, interrupted=isinstance(error, KeyboardInterrupt))
    robust = of_prints is not None
    if of_prints is not None:
        nominal, poses, n = fit, of_prints.configurations, len(goals)
        before = over_specimens(reached, poses, n, before=True)
        # The first few are as ordered.
        linear = of_prints.linear.only(of_prints.linear.pose < n)
        fit = replace(of_prints, configurations=poses[:n], linear=linear)
        reached = over_specimens(design_goals(fit, printing), poses, n)
        name = "the design of least error as ordered"
        error = error_of([goal.effector for goal in before])
        others = [Alternative(name, error, expected_of(before), nominal)]
    # What holds a robust design is its prints.
    missed = not robust and any(not goal.met for goal in reached)
    found = {p.name: p.value for p in fit.parameters}
    commanded = lambda goal: {
        name: replace(asked, value=found.get(f"{name} in {goal.name}", asked.value))
        for name, asked in goal.actuation.items()
    }
    result = DesignResult(
        goals=reached,
        fit=fit,
        configurations=tuple(replace(g, actuation=commanded(g)) for g in goals),
        held_by=held_by(fit, reached) if missed else (),
        trades=trades(fit, reached) if missed else (),
        alternatives=(),
        peaks=peaks(fit, largest),
        robust=robust,
        lost=lost,
        foam=foam,
        material=() if space is None else tuple(space.names),
    )
    if space is None or fit.interrupted:
        return result
    tell(result)
    try:
        others.extend(_alternatives(asked, space, tell))
    except KeyboardInterrupt:
        result = replace(result, fit=replace(fit, interrupted=True))
    return replace(result, alternatives=tuple(others))


def _part_of(
    watch: DesignWatch | Literal[False] | None, tells: Callable[[Event], bool]
) -> Watch | Literal[False] | None:
    """Return a `watch` that is told a part of what happens."""
    return watch and (lambda event: watch(event) if tells(event) else None)


def _fit(
    asked: _Asked,
    space: ParameterSpace | None,
    *,
    prints: Sequence[Configuration] = (),
    deviations: Float[Array, "n_c n_p"] | None = None,
    **begin: Any,
) -> CalibrationResult:
    """Fit goals, and again with more weight on limits of peaks that are not kept."""
    tighter, fit = 0, None
    while True:
        limits = asked.largest.readings(KEPT / TIGHTER**tighter)
        goals = [
            replace(goal, effectors=(*goal.effectors, *limits))
            for goal in asked.configurations
        ]
        goals += prints
        try:
            fit = _calibrated(asked, space, goals, deviations=deviations, **begin)
        except KeyboardInterrupt:
            if fit is None:
                raise
            return replace(fit, interrupted=True)
        if fit.interrupted or tighter == MOST_TIGHTENED:
            return fit
        if all(peak.kept for peak in peaks(fit, asked.largest)):
            return fit
        tighter, begin = tighter + 1, {"start": jnp.asarray(fit.z)}


def _robust(
    asked: _Asked,
    space: ParameterSpace | None,
    nominal: CalibrationResult,
    printing: Printing,
) -> CalibrationResult:
    """Go on to the least error over prints, with one command for all of a goal."""
    off = specimens(printing.deviations(nominal), asked.seed)
    n = len(asked.configurations)
    prints = [
        replace(goal, name=f"{goal.name}, print {k}", recording=goal.name)
        for k in range(1, len(off))
        for goal in asked.configurations
    ]
    return _fit(
        asked,
        space,
        prints=prints,
        deviations=jnp.asarray(np.repeat(off, n, axis=0)),
        start=jnp.asarray(nominal.z),
    )


def _calibrated(
    asked: _Asked,
    space: ParameterSpace | None,
    goals: Sequence[Configuration],
    *,
    deviations: Float[Array, "n_c n_p"] | None = None,
    starts: int | None = None,
    start: Float[Array, " n_p"] | None = None,
) -> CalibrationResult:
    """Fit some goals; with `deviations` each is of a specimen of its own."""
    if space is None:
        whole = ParameterSpace(asked.commands)
    else:
        whole = replace(space, entries=(*space.entries, *asked.commands))
    if asked.foam is not None:
        whole = within(asked.foam, asked.model, whole)
    if asked.change is not None:
        whole = replace(whole, likeness=asked.change.likeness(asked.model, whole))
    options = FitOptions(
        noise="stated",
        settings=asked.settings,
        starts=number_of_starts(whole, starts, start),
        seed=asked.seed,
        start=start,
    )
    with warnings.catch_warnings(), progress_line(wanted=asked.watch is None) as line:
        # That goals are fewer than parameters is the rule here.
        warnings.simplefilter("ignore", CalibrationWarning)
        problem, _ = checked_problem(
            asked.model,
            whole,
            tuple(goals),
            newton=asked.newton or NewtonSettings(),
            uncertain=exactly_known(),
            goals=True,
        )
        problem = replace(problem, deviations=deviations)
        return fit_problem(problem, options, asked.watch or line).result


def _alternatives(
    asked: _Asked, space: ParameterSpace, tell: Callable[[str], None]
) -> Iterator[Alternative]:
    """Fit the same goals with less that may be designed, until interrupted."""
    if any(len(entry.parameters) > 1 for entry in space.entries if entry.fields):
        tell("the same goals with the best homogeneous material")
        one = asked._replace(change=None)
        fit = _fit(one, _homogeneous(asked.model, space), starts=None)
        yield _alternative("the best homogeneous material", fit)
    if asked.commands:
        tell("the same goals with actuation alone")
        known = space.model_at(asked.model, space.start())
        alone = asked._replace(model=known, foam=None, change=None)
        yield _alternative("actuation alone", _fit(alone, None, starts=1))


def _alternative(name: str, fit: CalibrationResult) -> Alternative:
    if fit.interrupted:  # it would be compared unfairly
        raise KeyboardInterrupt
    goals = [effector for pose in fit.configurations for effector in aimed(pose)]
    return Alternative(name, error_of(goals), np.nan, fit)


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
