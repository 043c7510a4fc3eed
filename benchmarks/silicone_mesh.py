"""The real silicone beam: does E still change with the mesh and the element?

The packaged demo (loads `gravity` and `load101` fitted, `load52` predicted) on three
meshes of quadratic tets in the mean-dilatation form, on the middle one in the
displacement form, and on linear tets. Only the mesh keys of the project file differ.
"""

import statistics
import tempfile
from pathlib import Path

from benchmarks._demo import Variant, copy_demo
from benchmarks._problem import Figure, Goal, Options, Outcome, Table
from softcal_jax.calibration import CalibrationResult
from softcal_jax.project import load_project

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
        values = _figures(result)
        figures |= {f"{variant.name}_{key}": value for key, value in values.items()}
        rows.append([variant.name, *(f"{value:.5g}" for value in values.values())])
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
    with tempfile.TemporaryDirectory() as folder:
        path = copy_demo(Path(folder) / "project", variant)
        result = load_project(path).calibrate()
    if not result.converged:
        raise RuntimeError(f"{variant.name}: the calibration did not converge.")
    return result
