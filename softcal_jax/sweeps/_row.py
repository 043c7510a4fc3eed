"""Rows of trials, and how a calibration becomes one: each trial ends in a row."""

import dataclasses
import hashlib
import json
import math
import os
import socket
import time
import traceback
import warnings
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from itertools import chain
from pathlib import Path
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._compilation_cache import throw_away_damaged
from softcal_jax._process import Clock, ends_at
from softcal_jax.calibration import CalibrationResult
from softcal_jax.configurations import Configuration, rms_distance
from softcal_jax.fields import ParameterSpace, random_starts
from softcal_jax.layouts import place_control_points
from softcal_jax.project import Project, load_project, parse_in_si, read_toml
from softcal_jax.robots import synthetic_measurements
from softcal_jax.sweeps._trial import Trial, shown

State = Literal["converged", "not converged", "failed"]

Figure = bool | float | int | str | None

TO_TRUTH = "distance to truth [-]"  # a figure of trials to which the truth applies
ON_BOUND = "on a bound"  # a figure in words: parameters that ended on one of theirs
OUT_OF_RANGE = "out of range"  # a figure that no sweep writes, like 1e400
WINDOW = 50  # number of recent trials over which the rate is averaged


@dataclass(frozen=True)
class Outcome:
    """What a trial found.

    Attributes:
        figures: Numbers or words by name; nan and None mean that there is none. A name
            may end with its SI unit in brackets, "fit rms [m]": tables then show
            readable units.
        converged: Whether the figures can be used; if not, means leave them out.
        reason: Why the trial did not converge.
        notes: What a user should know before using the figures.
    """

    figures: Mapping[str, Any]
    converged: bool = True
    reason: str = ""
    notes: Sequence[str] = ()


_OF_ROW = ("state", "reason", "seconds", "compile_seconds", "worker", "ended")
"""Columns of a table of rows between axes and figures."""

TrialFunction = Callable[[Trial], Outcome | Mapping[str, Any]]


@dataclass(frozen=True)
class TrialRow:
    """How a trial ended: a row of the database.

    Attributes:
        key: Name of the trial.
        point: Its value on each axis.
        state: "converged", "not converged" or "failed".
        reason: Why it did not converge, or failed.
        figures: What it found; nothing if it failed.
        notes: What a user should know before using the figures.
        seconds: Wall time [s].
        compile_seconds: Part of it that JAX spent tracing and compiling, or reading
            compiled programs [s].
        worker: Machine and process that ran it.
        ended: When it ended, in UTC.
        traceback: Where it failed.
    """

    key: str
    point: Mapping[str, Any]
    state: State
    reason: str = ""
    figures: Mapping[str, Figure] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    seconds: float = 0.0
    compile_seconds: float = 0.0
    worker: str = ""
    ended: str = ""
    traceback: str = ""


def run_trial(function: TrialFunction, trial: Trial) -> TrialRow:
    """Run a trial, and return a row even if it raises."""
    outcome, reason, trace = Outcome({}), "", ""
    with warnings.catch_warnings(record=True) as caught, Clock() as clock:
        warnings.simplefilter("always")
        warnings.simplefilter("ignore", DeprecationWarning)  # for developers
        try:
            outcome = _as_outcome(function(trial))
        except Exception as error:  # a trial that fails is a row with its reason
            reason = f"{type(error).__name__}: {error}"
            trace = traceback.format_exc()
    warned = [str(w.message) for w in caught]
    for text in warned:  # a killed worker leaves an incomplete program on disk
        throw_away_damaged(text)
    warned = [text for text in warned if "persistent compilation cache" not in text]
    state: State = "converged" if outcome.converged else "not converged"
    if not outcome.converged:
        reason = outcome.reason or "it did not converge"
    return TrialRow(
        key=trial.key,
        point=trial.point,
        state="failed" if trace else state,
        reason=reason,
        figures=outcome.figures,
        notes=tuple(dict.fromkeys([*outcome.notes, *warned])),
        seconds=sum(clock.seconds.values()),
        compile_seconds=clock.seconds["compile"],
        worker=f"{socket.gethostname()} {os.getpid()}",
        ended=_now(),
        traceback=trace,
    )


def failed_row(trial: Trial, reason: str) -> TrialRow:
    """Return the row of a trial whose worker could not report its end."""
    return TrialRow(trial.key, trial.point, "failed", reason, ended=_now())


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")


def _as_outcome(returned: Any) -> Outcome:
    if isinstance(returned, Mapping):
        returned = Outcome(returned)
    if not isinstance(returned, Outcome):
        raise TypeError(
            f"the function of a sweep must return a mapping of names to numbers, or an "
            f"Outcome; got {type(returned).__name__}."
        )
    figures = {str(name): _figure(name, v) for name, v in returned.figures.items()}
    return Outcome(figures, bool(returned.converged), returned.reason, returned.notes)


def _figure(name: str, value: Any) -> Figure:
    if isinstance(value, np.ndarray | np.generic | jax.Array) and np.ndim(value) == 0:
        value = np.asarray(value).item()
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if value is None or isinstance(value, str | int):
        return value
    raise TypeError(
        f"figure {name!r} must be a number or a word, got {type(value).__name__}; give "
        "each entry of an array a name of its own."
    )


def flat_columns(
    axes: Sequence[str], rows: Sequence[TrialRow]
) -> tuple[dict[str, list[Any]], ...]:
    """Return rows as columns: of the axes, how the trials ended, figures, notes."""
    figures = dict.fromkeys(name for row in rows for name in row.figures)
    cell = lambda value: shown(value) if isinstance(value, list) else value
    return (
        {axis: [cell(row.point[axis]) for row in rows] for axis in axes},
        {name: [getattr(row, name) for row in rows] for name in _OF_ROW},
        {name: [row.figures.get(name) for row in rows] for name in figures},
        {"notes": [" ".join(row.notes) for row in rows]},
    )


@dataclass(frozen=True)
class Progress:
    """State of a sweep, after each trial.

    Attributes:
        total: Trials of the sweep.
        ended: Trials that have ended, in this run or before.
        before: Trials that had ended before this run.
        not_converged: Ended trials that did not converge.
        failed: Ended trials that failed.
        rate: Trials per second over the last ones of this run; None until a worker has
            ended its second trial, since the first one compiles.
        row: The trial that has just ended; None at the beginning.
    """

    total: int
    ended: int
    before: int
    not_converged: int
    failed: int
    rate: float | None
    row: TrialRow | None

    def __str__(self) -> str:
        """Write one line for a terminal."""
        counts = {"failed": self.failed, "not converged": self.not_converged}
        bad = [f"{n} {what}" for what, n in counts.items() if n]
        text = f"{self.ended} of {self.total} trials"
        text += f" ({', '.join(bad)})" if bad else ""
        if self.rate is None:
            return text
        left = (self.total - self.ended) / self.rate
        text += f", {3600.0 * self.rate:.1f} per hour"
        # Earlier, an estimate can be off by more than a factor of two.
        of_run = self.total - self.before, self.ended - self.before
        foreseen = left and 3 * of_run[1] >= of_run[0]
        return f"{text}, {ends_at(left)}" if foreseen else text


def progress_of(
    total: int, before: Sequence[str], rows: Iterable[TrialRow]
) -> Iterator[Progress]:
    """Count the trials of a run as they end, after those that had ended before it.

    `before` holds the states of those. The first progress is that of the beginning.
    """
    states, workers = Counter(before), set()
    ends: deque[tuple[float, bool]] = deque(maxlen=WINDOW)
    rate = None
    for row in chain([None], rows):
        if row is not None:
            states[row.state] += 1
            # The first trial of a worker compiles for all of its later ones.
            ends.append((time.monotonic(), row.worker in workers))
            workers.add(row.worker)
            # The rate counts from the end of the oldest of the recent trials.
            times, counts = zip(*ends, strict=True)
            n, span = sum(counts[1:]), times[-1] - times[0]
            rate = n / span if n and span else None
        yield Progress(
            total=total,
            ended=states.total(),
            before=len(before),
            not_converged=states["not converged"],
            failed=states["failed"],
            rate=rate,
            row=row,
        )


OWN_AXES = ("layout", "configurations", "start", "noise")
"""Axes that are not keys of the project file."""

KEPT = 8  # number of variants of a project that a worker keeps

MOST_MAPS = 40_000
"""Memory maps from which a worker drops compiled programs; Linux allows 65 530."""

FIT, HELD_OUT = "fit rms [m]", "held-out rms [m]"  # figures of how far the model is off

_STEPS, _COST, _ERROR = "steps", "cost [-]", "standard error of"

_KEPT: dict[str, Project] = {}
_EXACT: dict[str, tuple[Configuration, ...]] = {}
"""Configurations of these projects, with exact measurements that the truth gives."""


@dataclass(frozen=True)
class CalibrationTrial:
    """The function of a sweep over calibrations of one project.

    Attributes:
        project: The project file, at a path that every worker can read.
        files: Digest of the project file and of each file that it names, by path.
        layouts: For each layout, the keys of [control_points.NAME] to set, or `place`.
        replaces: The set of control points of the project that a layout replaces.
        truth: Parameter values, as written in the file, from which measurements are
            simulated on the trial's own mesh with the file's own control points; empty
            for a project with real measurements.
    """

    project: Path
    files: Mapping[str, str]
    layouts: Mapping[str, Mapping[str, Any]]
    replaces: str
    truth: Mapping[str, Any]

    def __call__(self, trial: Trial) -> Outcome:
        """Calibrate at a point of the sweep.

        Raises:
            RuntimeError: If a configuration has no equilibrium, or a file has changed.
            ValueError: If the project cannot be calibrated at this point.
        """
        project = self.variant(trial.point)
        project = self._measured(project, trial)
        start, space = None, project.space
        assert space is not None  # `load_sweep` has asked for parameters
        if trial.point.get("start"):
            seed = trial.seed_of("start")
            start = random_starts(space, 1, seed=seed)[0]
        # If starts are an axis, a trial has one start, unless the file sets `starts`.
        starts = project.starts or (1 if "start" in trial.point else None)
        project = dataclasses.replace(project, intervals=None, starts=starts)
        result = project.calibrate(start=start, watch=False)
        figures = _figures(result)
        if self.truth and not self.layouts.get(trial.point.get("layout", "")):
            truth = truth_in_si(space, self.truth)
            z = space.to_scaled(jnp.asarray([truth[name] for name in space.names]))
            figures[TO_TRUTH] = float(jnp.max(jnp.abs(space.shorter(result.z - z))))
        return Outcome(figures, result.converged, why_not(result), result.notes)

    def variant(self, point: Mapping[str, Any]) -> Project:
        """Load the project with the control points and keys of a point.

        The project is kept, so that later trials reuse what was compiled for it.
        """
        name = self._name(point)
        if name not in _KEPT:
            if len(_KEPT) >= KEPT:
                _KEPT.clear()
                _EXACT.clear()
            maps = Path("/proc/self/maps")  # exists on Linux only, which limits them
            if maps.exists() and maps.read_bytes().count(b"\n") > MOST_MAPS:
                jax.clear_caches()
            for path, digest in self.files.items():
                if file_digest(Path(path)) != digest:
                    raise RuntimeError(
                        f"{path} has changed since the sweep began; its rows would no "
                        "longer belong together."
                    )
            keys = file_keys(point)
            if "layout" in point:
                keys |= self._layout(point)
            _KEPT[name] = load_project(self.project, changes=keys)
        return _KEPT[name]

    def _name(self, point: Mapping[str, Any]) -> str:
        """Return a key that is unique among the variants of all sweeps."""
        layout = point.get("layout")
        of_layout = None if layout is None else [self.replaces, self.layouts[layout]]
        keys = file_keys(point)
        return json.dumps([str(self.project), dict(self.files), of_layout, keys])

    def _exact(self, point: Mapping[str, Any]) -> tuple[Configuration, ...]:
        """Simulate all poses with the truth and the file's own control points."""
        point = {axis: value for axis, value in point.items() if axis != "layout"}
        name = json.dumps([self._name(point), dict(self.truth)])
        true = self.variant(point)
        if name not in _EXACT:
            assert true.space is not None
            _EXACT[name] = synthetic_measurements(
                true.model,
                true.space,
                true.configurations,
                truth_in_si(true.space, self.truth),
                newton=true.newton,
            )
        return _EXACT[name]

    def _layout(self, point: Mapping[str, Any]) -> dict[str, Any]:
        """Return the layout of a point as changes of the project file."""
        keys = dict(self.layouts[point["layout"]])
        if not keys:
            return {}
        if "place" in keys:
            mesh = self.variant(file_keys(point)).model.mesh
            points = place_control_points(mesh, keys.pop("place"))
            text = "({:.9g}, {:.9g}, {:.9g}) m".format
            places = map(text, *np.asarray(points.positions).T)
            keys["positions"] = dict(zip(points.names, places, strict=True))
        keys = {"names": None, **keys}  # names in the file belong to its own positions
        return {f"control_points.{self.replaces}.{key}": v for key, v in keys.items()}

    def _measured(self, project: Project, trial: Trial) -> Project:
        """Return the project with the measurements of a trial and the poses it fits."""
        poses = self._exact(trial.point) if self.truth else project.configurations
        fitted = [c.name for c in project.calibration]
        fitted = trial.point.get("configurations", fitted)
        if trial.point.get("noise"):
            random = np.random.default_rng(trial.seed_of("noise"))
            noisy = {c.name: _with_noise(c, random) for c in poses}
            # What is held out stays exact, to measure the error of the prediction.
            poses = [noisy[c.name] if c.name in fitted else c for c in poses]
        return dataclasses.replace(
            project,
            calibration=tuple(c for c in poses if c.name in fitted),
            validation=tuple(c for c in poses if c.name not in fitted),
        )


def file_keys(point: Mapping[str, Any]) -> dict[str, Any]:
    """Pick the axes of a point that are keys of the project file."""
    return {axis: value for axis, value in point.items() if axis not in OWN_AXES}


def why_not(result: CalibrationResult) -> str:
    """Say how a calibration that did not converge ended.

    The text has no numbers of the trial, as tables group trials by equal reasons.
    """
    accepted = result.history[-1].accepted
    # Steps of tensors that found no way on count, but are not in the history.
    went_on = accepted and bool(np.all(np.isfinite(result.linear.W)))
    if len(result.history) > result.settings.max_steps or went_on:
        return f"lambda_p did not vanish within max_steps = {result.settings.max_steps}"
    if not accepted:
        return "its last steps were refused, down to the shortest, away from an optimum"
    return "no step could be computed: the sensitivities are not finite"


def file_digest(path: Path) -> str:
    """Digest a file; a TOML file without its comments."""
    if path.suffix == ".toml":
        text = json.dumps(read_toml(path, "project file"), sort_keys=True, default=str)
        content = text.encode()
    else:
        content = path.read_bytes()
    return f"sha256 {hashlib.sha256(content).hexdigest()[:16]}"


def truth_in_si(space: ParameterSpace, given: Mapping[str, Any]) -> dict[str, float]:
    """Convert values of parameters to SI, as `synthetic_measurements` takes them."""
    units = {q.name: q.unit for q in space.parameters}
    return {
        name: parse_in_si(value, units[name]) if name in units else np.nan
        for name, value in given.items()
    }


def _with_noise(configuration: Configuration, random) -> Configuration:
    """Add Gaussian noise with the stated standard deviations to measured positions."""
    markers, measured = configuration.markers, configuration.measured
    if markers is None or measured is None or configuration.effectors:
        raise ValueError(
            f"configuration {configuration.name!r} measures more than markers, and the "
            "axis noise knows what to add to markers alone: leave the axis out."
        )
    std = np.nan_to_num(markers.stds(), posinf=0.0)  # none where nothing is measured
    noisy = measured + std * random.standard_normal(measured.shape)
    return replace(configuration, measured=noisy)


def _figures(result: CalibrationResult) -> dict[str, Any]:
    """Return what a row keeps of a calibration, in SI units."""
    poses = [f for f in result.configurations if f.role == "validation"]
    held_out = [point for pose in poses for point in pose.points]
    last = result.history[-1]
    figures: dict[str, Any] = {FIT: last.rms}
    if held_out:
        figures[HELD_OUT] = rms_distance(held_out, lambda e: e.simulated)
    for q in result.parameters:
        figures[f"{q.name} [{q.unit or '-'}]"] = q.value
    figures |= {_STEPS: len(result.history) - 1, _COST: last.cost}
    for q in result.parameters:
        figures[f"{_ERROR} {q.name} [{q.unit or '-'}]"] = q.standard_error
    if bound := [q.name for q in result.parameters if q.at_bound]:
        figures[ON_BOUND] = "; ".join(bound)
    return figures


def is_of_the_fit(figure: str) -> bool:
    """Say whether a figure describes the fit, and not the robot."""
    return figure in (_STEPS, _COST) or figure.startswith(f"{_ERROR} ")
