"""The function of a sweep over calibrations of one project."""

import dataclasses
import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax.calibration import CalibrationResult
from softcal_jax.configurations import Configuration, rms_distance
from softcal_jax.fields import ParameterSpace, random_starts
from softcal_jax.layouts import place_control_points
from softcal_jax.project import Project, load_project, parse_in_si, read_toml
from softcal_jax.robots import synthetic_measurements
from softcal_jax.sweeps._result import (
    COST,
    ERROR,
    FIT,
    HELD_OUT,
    ON_BOUND,
    STEPS,
    TO_TRUTH,
)
from softcal_jax.sweeps._row import Outcome
from softcal_jax.sweeps._trial import Trial

OWN_AXES = ("layout", "configurations", "start", "noise")
"""Axes that are not keys of the project file."""

KEPT = 8  # number of variants of a project that a worker keeps

MOST_MAPS = 40_000
"""Memory maps from which a worker drops compiled programs; Linux allows 65 530."""

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
    figures |= {STEPS: len(result.history) - 1, COST: last.cost}
    for q in result.parameters:
        figures[f"{ERROR} {q.name} [{q.unit or '-'}]"] = q.standard_error
    if bound := [q.name for q in result.parameters if q.at_bound]:
        figures[ON_BOUND] = "; ".join(bound)
    return figures
