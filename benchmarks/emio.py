"""A real robot on four soft legs: how well are 248 poses predicted from twelve?

The packaged robot `emio` (Compliance Robotics): fitted are twelve of 260 poses, held
out all others. The robot was driven open loop; its authors' model of beams is off by
`authors_rms_mm` on the poses that are held out, without any fit, and by
`authors_moved_rms_mm` if the frame of the tracker is fitted to the same twelve. The
same with a camera, in poses that the authors' linear tets commanded (`camera_...`).

And why do the authors multiply E by 0.2 where they use linear tets? The force across
one clamped leg is compared among elements of the same E (`_emio_leg.py`): `factor_...`
is what E has to be multiplied by.
"""

import csv
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks import _emio_leg
from benchmarks._emio_robot import MOTORS
from benchmarks._predicted import called_identified, predicted_coordinates
from benchmarks._problem import Better, Figure, Goal, Options, Outcome, Table
from softcal_jax.calibration import CalibrationResult, ConfigurationResult
from softcal_jax.configurations import Configuration, ImposedDisplacement
from softcal_jax.identifiability import assess
from softcal_jax.project import Project, load_project
from softcal_jax.robots import ready_made_path

GOALS = {
    "held_out_rms_mm": Goal("at most", 2.0),
    "camera_held_out_rms_mm": Goal("at most", 4.0),
    "coverage_95_of_held_out": Goal("between", 0.85, 0.99),
    "unidentifiable_called_identified": Goal("at most", 0),
}

SENSORS = {"polhemus": ("", "poses.csv"), "camera": ("camera_", "camera.csv")}
"""Prefix of the figures, and table of the poses."""

BETTER: dict[str, Better] = {
    f"{prefix}authors_{what}_mm": "either"
    for prefix, _ in SENSORS.values()
    for what in ("rms", "mean", "max", "moved_rms", "moved_mean", "moved_max")
}

COUNTS = {"polhemus": 1, "camera": 1, "motion": 1, "leg": 1}


def run(options: Options) -> Outcome:
    """A calibration and the prediction of all other poses by each sensor, and a leg."""
    figures: dict[str, Figure] = {}
    values: dict[str, Sequence[float]] = {}
    tables: list[Table] = []
    for part in options.counts or COUNTS:
        options.say(part)
        if part == "leg":
            leg = _emio_leg.stiffnesses()
            figures |= _factors(leg)
            tables.append(_elements(leg))
            continue
        if part == "motion":
            figures |= motion()
            continue
        prefix, file = SENSORS[part]
        result = predicted(load_project(ready_made_path("emio")), poses(file))
        named = {prefix + name: value for name, value in found(result, file).items()}
        figures |= named
        values[f"{part}_parameters"] = [p.value for p in result.parameters]
        tables.append(_parameters(part, result))
    goals = {name: goal for name, goal in GOALS.items() if name in figures}
    better: dict[str, Better] = {n: BETTER[n] for n in BETTER if n in figures}
    return Outcome(figures, values, goals=goals, tables=tables, better=better)


def predicted(project: Project, rows: list[dict[str, str]]) -> CalibrationResult:
    """Fit the poses of the project, as a table has them, and predict all others."""
    names = [c.name for c in project.calibration]
    by_name = {row["pose"]: row for row in rows}
    fitted = [posed(project, by_name[name]) for name in names]
    held_out = [posed(project, row) for row in rows if row["pose"] not in names]
    several = replace(project, calibration=tuple(fitted), validation=tuple(held_out))
    return several.calibrate()


def found(result: CalibrationResult, file: str) -> dict[str, Figure]:
    """How far off fitted poses and all others are, and what the tool says."""
    fitted, held_out = (
        [c for c in result.configurations if c.role == role]
        for role in ("calibration", "validation")
    )
    ours = _sizes("held_out", errors_mm(held_out))
    authors = _authors(file, [c.name for c in fitted])
    rms = ours["held_out_rms_mm"]
    coordinates = predicted_coordinates(result, held_out)
    return {
        **_sizes("fitted", errors_mm(fitted)),
        **ours,
        **authors,
        "authors_over_ours": authors["authors_rms_mm"] / rms,
        "authors_moved_over_ours": authors["authors_moved_rms_mm"] / rms,
        "coverage_95_of_held_out": coordinates.coverage,
        **coordinates.figures(),
        "newton_iterations_per_pose": float(
            np.mean([c.newton_steps for c in held_out])
        ),
        "unidentifiable_called_identified": called_identified(result),
        "converged": int(result.converged),
        "called_identified": int(assess(result).identified),
        **{f"{p.name}_MPa": p.value / 1e6 for p in result.parameters[:3]},
    }


def poses(file: str = "poses.csv") -> list[dict[str, str]]:
    """All poses that were measured by a sensor."""
    path = ready_made_path("emio").parent / file
    with path.open(newline="", encoding="utf-8") as stream:
        return list(csv.DictReader(stream))


def columns(rows: Sequence[dict[str, str]], *names: str) -> np.ndarray:
    """Some columns of poses, one row a pose."""
    return np.array([[float(row[name]) for name in names] for row in rows])


def posed(project: Project, row: dict[str, str]) -> Configuration:
    """A pose that is only predicted."""
    motors = [f"{motor.replace(' ', '_')}_deg" for motor in MOTORS]
    (angles,) = np.deg2rad(columns([row], *motors))
    imposed = map(ImposedDisplacement, map(float, angles))
    return replace(
        project.calibration[0],
        name=row["pose"],
        actuation=dict(zip(MOTORS, imposed, strict=True)),
        measured=1e-3 * columns([row], "x_mm", "y_mm", "z_mm"),
    )


def errors_mm(fits: Sequence[ConfigurationResult]) -> np.ndarray:
    """Simulated minus measured positions of the sensor [mm]."""
    return 1e3 * np.concatenate([c.error_after for c in fits])


def _authors(file: str, fitted: Sequence[str]) -> dict[str, float]:
    """Errors of the authors' model on the poses that are held out."""
    rows = poses(file)
    scene = columns(rows, "scene_x_mm", "scene_y_mm", "scene_z_mm")
    seen = columns(rows, "x_mm", "y_mm", "z_mm")
    used = np.array([row["pose"] in fitted for row in rows])
    middle, there = scene[used].mean(axis=0), seen[used].mean(axis=0)
    turn = Rotation.align_vectors(seen[used] - there, scene[used] - middle)[0]
    moved = turn.apply(scene - middle) + there
    return {
        **_sizes("authors", (scene - seen)[~used]),
        **_sizes("authors_moved", (moved - seen)[~used]),
    }


def motion() -> dict[str, float]:
    """Slopes of what was measured over what the authors' models say: 1 were right."""
    slopes: dict[str, float] = {}
    for prefix, file in SENSORS.values():
        rows = poses(file)
        scene = columns(rows, "scene_x_mm", "scene_y_mm", "scene_z_mm")
        seen = columns(rows, "x_mm", "y_mm", "z_mm")
        affine = np.column_stack([scene, np.ones(len(scene))])
        x, y, z = np.diag(np.linalg.lstsq(affine, seen, rcond=None)[0])
        slopes[f"{prefix}motion_across"] = float((x + z) / 2.0)
        slopes[f"{prefix}motion_up"] = float(y)
    return slopes


def _sizes(which: str, errors: np.ndarray) -> dict[str, float]:
    lengths = np.linalg.norm(errors, axis=1)
    return {
        f"{which}_rms_mm": float(np.sqrt(np.mean(lengths**2))),
        f"{which}_mean_mm": float(lengths.mean()),
        f"{which}_max_mm": float(lengths.max()),
    }


def _factors(leg: list[_emio_leg.Stiffness]) -> dict[str, float]:
    """What E has to be multiplied by, to be as soft as the finest mesh."""
    names = ("linear", "linear_8", "linear_64", "quadratic")
    *others, finest = leg
    across = {
        name: row.across / finest.across
        for name, row in zip(names, others, strict=True)
    }
    return {
        **{f"factor_{name}": 1.0 / stiffer for name, stiffer in across.items()},
        **{f"stiffer_{name}": stiffer for name, stiffer in across.items()},
        "stiffer_linear_width": leg[0].width / finest.width,
    }


def _parameters(part: str, result: CalibrationResult) -> Table:
    rows = [
        [p.name, f"{p.value:.4g}", f"{p.standard_error:.2g}", p.unit]
        for p in result.parameters
    ]
    return Table(
        f"Parameters, {part}", ["parameter", "value", "standard error", "unit"], rows
    )


def _elements(leg: list[_emio_leg.Stiffness]) -> Table:
    finest = leg[-1].across
    rows = [
        [s.elements, str(s.n_nodes), f"{s.across:.3f}", f"{finest / s.across:.3f}"]
        for s in leg
    ]
    head = ["elements", "nodes", "force per shift [N/m]", "factor on E"]
    return Table("One leg, clamped at both ends", head, rows)
