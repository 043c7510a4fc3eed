"""The real silicone beam: does E still change with the mesh and the element?

The packaged demo (loads `gravity` and `load101` fitted, `load52` predicted) on three
meshes of quadratic tets in the mean-dilatation form, on the middle one in the
displacement form, and on linear tets. Only the mesh keys of the project file differ.
"""

import re
import shutil
import statistics
import tempfile
from pathlib import Path
from typing import NamedTuple

from benchmarks._problem import Figure, Goal, Options, Outcome, Table
from softcal_jax.calibration import CalibrationResult
from softcal_jax.equilibrium import Formulation
from softcal_jax.project import load_project
from softcal_jax.robots import silicone_beam_path


class Variant(NamedTuple):
    """Cells of the beam, and the element on it."""

    cells: tuple[int, int, int]
    element: str = "quadratic"
    formulation: Formulation = "mean-dilatation"

    @property
    def name(self) -> str:
        """Name in the figures."""
        kind = "tet4" if self.element == "linear" else "tet10"
        displacement = kind == "tet10" and self.formulation == "displacement"
        cells = "x".join(map(str, self.cells))
        return f"{kind}{'_displacement' if displacement else ''}_{cells}"


REFINED = [Variant((7, 2, 2)), Variant((14, 4, 4)), Variant((20, 6, 6))]
OTHERS = [
    Variant((10, 4, 4), formulation="displacement"),
    Variant((14, 4, 4), formulation="displacement"),
    Variant((14, 4, 4), "linear", "displacement"),
]
FINEST = REFINED[-1].name
GOALS = {
    f"{FINEST}_held_out_rms_mm": Goal("at most", 1.3),
    "E_change_of_last_refinement_percent": Goal("at most", 1.0),
}


def run(options: Options) -> Outcome:
    """One calibration per variant."""
    figures: dict[str, Figure] = {}
    rows = []
    for variant in [*REFINED, *OTHERS]:
        options.say(variant.name)
        result = _calibrate(variant)
        found = _figures(result)
        figures |= {f"{variant.name}_{key}": value for key, value in found.items()}
        rows.append([variant.name, *(f"{value:.5g}" for value in found.values())])
    E = [float(figures[f"{variant.name}_E_kPa"]) for variant in REFINED]
    figures["E_change_of_last_refinement_percent"] = 100.0 * abs(E[-1] / E[-2] - 1.0)
    for variant in OTHERS:
        change = float(figures[f"{variant.name}_E_kPa"]) / E[-1] - 1.0
        figures[f"{variant.name}_E_off_percent"] = 100.0 * change
    columns = ["variant", "nodes", "E kPa", "std. error kPa"]
    columns += ["fitted mm", "held out mm", "held out %"]
    table = Table("Silicone beam", columns, rows)
    return Outcome(figures, goals=GOALS, tables=[table])


def _figures(result: CalibrationResult) -> dict[str, float]:
    rms = lambda role: [f.rms_after for f in result.configurations if f.role == role]
    (held_out,) = [f for f in result.configurations if f.role == "validation"]
    return {
        "n_nodes": result.model.mesh.n_nodes,
        "E_kPa": 1e-3 * result.value("E"),
        "standard_error_kPa": 1e-3 * result.parameters[0].standard_error,
        "fitted_rms_mm": 1e3 * statistics.fmean(rms("calibration")),
        "held_out_rms_mm": 1e3 * held_out.rms_after,
        "held_out_percent_of_motion": 100.0 * held_out.rms_after / held_out.motion,
    }


def _calibrate(variant: Variant) -> CalibrationResult:
    """Calibrate the demo's own project with other cells and another element.

    Raises:
        RuntimeError: If it does not converge.
    """
    source = silicone_beam_path()
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(shutil.copytree(source.parent, Path(folder) / "project"))
        path = copy / source.name
        text = path.read_text(encoding="utf-8")
        path.write_text(_edited(text, variant), encoding="utf-8")
        result = load_project(path).calibrate()
    if not result.converged:
        raise RuntimeError(f"{variant.name}: the calibration did not converge.")
    return result


def _edited(text: str, variant: Variant) -> str:
    """The project file of a variant.

    Raises:
        RuntimeError: If the file no longer has the keys that are replaced here.
    """
    changes = {
        r"cells = \[[^\]]*\]": f"cells = {list(variant.cells)}",
        r'(?m)^element = "\w+"': f'element = "{variant.element}"',
        r"(?m)^\[material\]$": f'[material]\nformulation = "{variant.formulation}"',
    }
    for pattern, new in changes.items():
        text, found = re.subn(pattern, new, text)
        if found != 1:
            raise RuntimeError(f"{pattern} occurs {found} times in the project file.")
    return text
