"""A real pneumatic arm: how well are pressures predicted that were not fitted?

The packaged `softcal demo arm`: silicone with hoop fibres in the outer wall, fitted to
100, 200 and 300 mbar. Held out are 150 and 250 mbar, between the fitted ones, and 350
and 400 mbar, beyond them. All errors are root mean squares over the markers, over
those of their motion. The same is done with plain silicone, which is the wrong law: it
must not be called identified.
"""

import re
import shutil
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmarks._problem import Figure, Goal, Options, Outcome, Table
from softcal_jax.calibration import CalibrationResult, ConfigurationResult
from softcal_jax.identifiability import Assessment, assess
from softcal_jax.project import load_project
from softcal_jax.robots import pneumatic_arm_path

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
    wound, assessment = calibrated(pneumatic_arm_path())
    figures: dict[str, Figure] = {
        "fit_percent": _percent(
            [c for c in wound.configurations if c.role == "calibration"]
        ),
        "held_out_interpolated_percent": _percent(_named(wound, BETWEEN)),
        "held_out_extrapolated_percent": _percent(_named(wound, BEYOND)),
        "wound_called_identified": int(assessment.identified),
        "wound_converged": int(wound.converged),
    }
    for p, key in zip(wound.parameters[:2], ("E_kPa", "E_f_kPa"), strict=True):
        figures[key] = 1e-3 * p.value
        figures[f"{key[:-4]}_standard_error_kPa"] = 1e-3 * p.standard_error
    options.say("plain silicone")
    with tempfile.TemporaryDirectory() as folder:
        path = pneumatic_arm_path()
        copy = Path(shutil.copytree(path.parent, Path(folder) / "arm")) / path.name
        copy.write_text(plain(copy.read_text(encoding="utf-8")), encoding="utf-8")
        silicone, doubted = calibrated(copy)
    figures |= {
        "plain_silicone_called_identified": int(doubted.identified),
        "plain_silicone_converged": int(silicone.converged),
        "plain_silicone_fit_percent": _percent(
            [c for c in silicone.configurations if c.role == "calibration"]
        ),
        "plain_silicone_held_out_percent": _percent(
            [c for c in silicone.configurations if c.role == "validation"]
        ),
    }
    columns = ["pose", "role", "motion [mm]", "wound [mm]", "plain [mm]"]
    poses = zip(wound.configurations, silicone.configurations, strict=True)
    rows = [
        [
            c.name,
            c.role,
            f"{1e3 * c.motion:.1f}",
            f"{1e3 * c.rms_after:.2f}",
            f"{1e3 * other.rms_after:.2f}",
        ]
        for c, other in poses
    ]
    return Outcome(figures, goals=GOALS, tables=[Table("Errors", columns, rows)])


def calibrated(path: Path) -> tuple[CalibrationResult, Assessment]:
    """Calibrate a project file, and say what the result may claim."""
    result = load_project(path).calibrate()
    return result, assess(result)


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
        text, found = re.subn(pattern, new, text)
        if not found:
            raise RuntimeError(f"{pattern} does not occur in the project file.")
    return text


def _named(
    result: CalibrationResult, names: Sequence[str]
) -> list[ConfigurationResult]:
    return [c for c in result.configurations if c.name in names]


def _percent(poses: Sequence[ConfigurationResult]) -> float | str:
    """Root mean square error of some poses over that of their motion [%]."""
    error, motion = (
        np.linalg.norm([getattr(c, key) for c in poses])
        for key in ("rms_after", "motion")
    )
    return float(100.0 * error / motion) if np.isfinite(error) else "no equilibrium"
