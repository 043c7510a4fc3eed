"""A real pneumatic arm: how well are pressures predicted that were not fitted?

The packaged `softcal demo arm`: silicone with hoop fibres in the outer wall, fitted to
100, 200 and 300 mbar. Held out are 150 and 250 mbar, between the fitted ones, and 350
and 400 mbar, beyond them. All errors are root mean squares over the markers, over
those of their motion. The same is done with plain silicone, which is the wrong law: it
must not be called identified.

Silicone stiffens: Gent's law, whose limit J_m is known to a factor of 8 from a
published pull test (README.md of the arm) and is calibrated beside that. That a law
which does not stiffen fails at 400 mbar was known when this one was taken, and one
other value of J_m had been tried there; the prior is that of the pull test alone.

A pose that is not found, see `equilibria`, is none of the predictions, and named.
"""

import re
import shutil
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks._problem import Figure, Goal, Options, Outcome, Table
from softcal_jax.calibration import CalibrationResult, ConfigurationResult
from softcal_jax.identifiability import Assessment, assess
from softcal_jax.project import Project, load_project
from softcal_jax.robots import ready_made_path

BETWEEN = ("150 mbar", "250 mbar")
BEYOND = ("350 mbar", "400 mbar")

GOALS = {
    "held_out_interpolated_percent": Goal("at most", 5.0),
    "held_out_extrapolated_percent": Goal("at most", 12.0),
    "plain_silicone_called_identified": Goal("at most", 0),
}


def run(options: Options) -> Outcome:
    """Two calibrations."""
    options.say("silicone with hoops")
    project, wound, assessment = calibrated(ready_made_path("pneumatic-arm"))
    options.say(_in_words(wound))
    poses = wound.configurations
    figures: dict[str, Figure] = {
        "fit_percent": _percent(
            [c for c in wound.configurations if c.role == "calibration"]
        ),
        "held_out_interpolated_percent": _predicted(poses, BETWEEN),
        "held_out_extrapolated_percent": _predicted(poses, BEYOND),
        **{
            f"held_out_{name.replace(' ', '_')}_percent": _predicted(poses, [name])
            for name in BEYOND
        },
        "wound_called_identified": int(assessment.identified),
        "wound_converged": int(wound.converged),
    }
    fitted = {p.name: p for p in wound.parameters}
    for key, name, unit in (("mu_kPa", "mu", 1e3), ("E_f_kPa", "E_f_wall", 1e3)):
        figures[key] = fitted[name].value / unit
        figures[f"{key[:-4]}_standard_error_kPa"] = fitted[name].standard_error / unit
    figures["J_m"] = fitted["J_m"].value
    figures["J_m_standard_error"] = fitted["J_m"].standard_error
    options.say("plain silicone")
    with tempfile.TemporaryDirectory() as folder:
        path = ready_made_path("pneumatic-arm")
        copy = Path(shutil.copytree(path.parent, Path(folder) / "arm")) / path.name
        copy.write_text(plain(copy.read_text(encoding="utf-8")), encoding="utf-8")
        _, silicone, doubted = calibrated(copy)
    figures |= {
        "plain_silicone_called_identified": int(doubted.identified),
        "plain_silicone_converged": int(silicone.converged),
        "plain_silicone_fit_percent": _percent(
            [c for c in silicone.configurations if c.role == "calibration"]
        ),
        "plain_silicone_held_out_percent": _percent(
            [c for c in silicone.configurations if c.role == "validation"]
        ),
        "poses_without_equilibrium": len(project.configurations) - len(poses),
        "plain_silicone_poses_without_equilibrium": len(project.configurations)
        - len(silicone.configurations),
    }
    options.say(_in_words(silicone))
    columns = ["pose", "role", "motion [mm]", "wound [mm]", "plain [mm]"]
    plain_mm = {c.name: f"{1e3 * c.rms_after:.2f}" for c in silicone.configurations}
    rows = [
        [
            c.name,
            c.role,
            f"{1e3 * c.motion:.1f}",
            f"{1e3 * c.rms_after:.2f}",
            plain_mm.get(c.name, "no equilibrium"),
        ]
        for c in poses
    ]
    return Outcome(
        figures,
        {"parameters": [p.value for p in wound.parameters]},
        goals=GOALS,
        tables=[Table("Errors", columns, rows)],
    )


def calibrated(path: Path) -> tuple[Project, CalibrationResult, Assessment]:
    """Calibrate a project file, and say what the result may claim.

    Without intervals, which take longer than the fit and change none of the figures.
    """
    project = replace(load_project(path), intervals=None)
    result = project.calibrate()
    return project, result, assess(result)


def plain(text: str) -> str:
    """The project file without fibres.

    Raises:
        RuntimeError: If the file no longer has what is taken out here.
    """
    changes = {
        r'law = "fibre-reinforced"\nmatrix = ': "law = ",
        r"(?m)^(E_f|directions|tension_only) = .*\n": "",
        r"\[material\.regions\.wall\]\n": "",
        r'\[\[parameters\]\]\nfield = "E_f"\n(.+\n)+': "",
    }
    for pattern, new in changes.items():
        text, count = re.subn(pattern, new, text)
        if not count:
            raise RuntimeError(f"{pattern} does not occur in the project file.")
    return text


def _in_words(result: CalibrationResult) -> str:
    """Say in a line what was found, before the next calibration begins."""
    values = [f"{p.name} = {p.value:.5g} {p.unit}" for p in result.parameters]
    poses = [
        f"{c.name} off {1e3 * c.rms_after:.2f} of {1e3 * c.motion:.1f} mm"
        for c in result.configurations
    ]
    return "found " + ", ".join(values) + ": " + ", ".join(poses)


def _predicted(poses: Sequence[ConfigurationResult], names: Sequence[str]) -> Figure:
    """Error of some poses; in words where one of them has no equilibrium."""
    named = [pose for pose in poses if pose.name in names]
    missing = set(names) - {pose.name for pose in named}
    if missing:
        return f"no equilibrium at {', '.join(sorted(missing))}"
    return _percent(named)


def _percent(poses: Sequence[ConfigurationResult]) -> float:
    """Root mean square error of some poses over that of their motion [%]."""
    error, motion = (
        np.linalg.norm([getattr(c, key) for c in poses])
        for key in ("rms_after", "motion")
    )
    return float(100.0 * error / motion)
