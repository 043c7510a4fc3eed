"""A real robot on four soft legs: how well are 248 poses predicted from twelve?

The packaged robot `emio` (Compliance Robotics): fitted are twelve of 260 poses, held
out all others. The robot was driven open loop; its authors' model of beams is off by
`authors_rms_mm` on the poses that are held out, without any fit, and by
`authors_moved_rms_mm` if the frame of the tracker is fitted to the same twelve.

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
from benchmarks._problem import Figure, Goal, Options, Outcome, Table
from softcal_jax.calibration import CalibrationResult, ConfigurationResult
from softcal_jax.configurations import Configuration, ImposedDisplacement
from softcal_jax.identifiability import WEAK_UP_TO, assess
from softcal_jax.project import Project, load_project
from softcal_jax.robots import ready_made_path

GOALS = {
    "held_out_rms_mm": Goal("at most", 2.0),
    "coverage_95_of_held_out": Goal("between", 0.92, 0.98),
    "unidentifiable_called_identified": Goal("at most", 0),
}


def run(options: Options) -> Outcome:
    """One calibration, the prediction of all other poses, and one leg."""
    options.say("fit of twelve poses, prediction of 248")
    project = load_project(ready_made_path("emio"))
    fitted = [c.name for c in project.calibration]
    asked = [row for row in poses() if row["pose"] not in fitted]
    held_out = [posed(project, row) for row in near_to_near(asked)]
    result = replace(project, validation=tuple(held_out)).calibrate()
    by_role = {
        role: [c for c in result.configurations if c.role == role]
        for role in ("calibration", "validation")
    }
    options.say("one leg")
    leg = _emio_leg.stiffnesses()
    figures: dict[str, Figure] = {
        **_sizes("fitted", errors_mm(by_role["calibration"])),
        **_sizes("held_out", errors_mm(by_role["validation"])),
        **_authors(fitted),
        "coverage_95_of_held_out": coverage(result, by_role["validation"]),
        "newton_iterations_per_pose": float(
            np.mean([c.newton_steps for c in by_role["validation"]])
        ),
        "unidentifiable_called_identified": called_identified(result),
        "converged": int(result.converged),
        "called_identified": int(assess(result).identified),
        **{f"{p.name}_MPa": p.value / 1e6 for p in result.parameters[:3]},
        **_factors(leg),
    }
    figures["authors_over_ours"] = _ratio(figures, "authors_rms_mm")
    figures["authors_moved_over_ours"] = _ratio(figures, "authors_moved_rms_mm")
    values = {"parameters": [p.value for p in result.parameters]}
    return Outcome(
        figures, values, goals=GOALS, tables=[_parameters(result), _elements(leg)]
    )


def poses() -> list[dict[str, str]]:
    """All poses that were measured, as poses.csv has them."""
    file = ready_made_path("emio").parent / "poses.csv"
    with file.open(newline="", encoding="utf-8") as stream:
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


def near_to_near(rows: list[dict[str, str]]) -> list[dict[str, str]]:
    """Order poses so that each is near to the one before, from which it is solved."""
    left, path = list(rows), [rows[0]]
    places = {
        row["pose"]: columns([row], *(f"scene_{a}_mm" for a in "xyz"))[0]
        for row in rows
    }
    while left:
        here = places[path[-1]["pose"]]
        path.append(min(left, key=lambda r: np.linalg.norm(places[r["pose"]] - here)))
        left.remove(path[-1])
    return path[1:]


def errors_mm(fits: Sequence[ConfigurationResult]) -> np.ndarray:
    """Simulated minus measured positions of the sensor [mm]."""
    return 1e3 * np.concatenate([c.error_after for c in fits])


def coverage(result: CalibrationResult, fits: Sequence[ConfigurationResult]) -> float:
    """Share of the coordinates that are within their intervals of 95 % [-].

    Parameters and noise are uncertain; that the model is, its misfit tells as noise.
    """
    inside = []
    for fit in fits:
        (marker,) = fit.points
        assert fit.W_ep is not None
        rows = fit.W_ep[marker.index]
        variance = np.sum(rows @ result.budget.covariance * rows, axis=1)
        noise = marker.std * result.uncertainty.level
        inside.append(np.abs(fit.error_after[0]) < 1.96 * np.sqrt(variance + noise**2))
    return float(np.mean(inside))


def called_identified(result: CalibrationResult) -> int:
    """Parameters that neither data nor prior know well enough, yet called known."""
    outlook = assess(result).identifiability
    return sum(
        p.verdict == "identifiable"
        and p.data_only > WEAK_UP_TO * p.asked
        and (p.prior is None or p.prior > WEAK_UP_TO * p.asked)
        for p in outlook.parameters
    )


def _authors(fitted: Sequence[str]) -> dict[str, float]:
    """Errors of the authors' model on the poses that are held out."""
    rows = poses()
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


def _sizes(which: str, errors: np.ndarray) -> dict[str, float]:
    lengths = np.linalg.norm(errors, axis=1)
    return {
        f"{which}_rms_mm": float(np.sqrt(np.mean(lengths**2))),
        f"{which}_mean_mm": float(lengths.mean()),
        f"{which}_max_mm": float(lengths.max()),
    }


def _ratio(figures: dict[str, Figure], authors: str) -> float:
    return float(figures[authors]) / float(figures["held_out_rms_mm"])


def _factors(leg: list[_emio_leg.Stiffness]) -> dict[str, float]:
    """What E has to be multiplied by, to be as soft as the finest mesh."""
    names = ("linear", "linear_8", "linear_64", "quadratic")
    finest = leg[-1].across
    return {
        f"factor_{name}": finest / row.across
        for name, row in zip(names, leg, strict=False)
    }


def _parameters(result: CalibrationResult) -> Table:
    rows = [
        [p.name, f"{p.value:.4g}", f"{p.standard_error:.2g}", p.unit]
        for p in result.parameters
    ]
    return Table("Parameters", ["parameter", "value", "standard error", "unit"], rows)


def _elements(leg: list[_emio_leg.Stiffness]) -> Table:
    finest = leg[-1].across
    rows = [
        [s.elements, str(s.n_nodes), f"{s.across:.3f}", f"{finest / s.across:.3f}"]
        for s in leg
    ]
    head = ["elements", "nodes", "force per shift [N/m]", "factor on E"]
    return Table("One leg, clamped at both ends", head, rows)
