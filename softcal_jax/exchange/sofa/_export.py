"""Export a calibrated robot as a scene of SOFA: calibrate it again, and write it."""

import io
import os
import shutil
from collections.abc import Callable, Sequence
from contextlib import redirect_stderr
from pathlib import Path
from typing import Any, get_args

import meshio

from softcal_jax._module import Module
from softcal_jax._names import check_known
from softcal_jax._typing import HostArray, Int
from softcal_jax.calibration import CalibrationResult, HistoryEntry
from softcal_jax.equilibrium import model_for_law
from softcal_jax.exchange import _formats as formats
from softcal_jax.exchange.sofa._component import (
    SCALES,
    PluginElasticity,
    SofaLaw,
    SofaRelease,
    SofaUnits,
    component_of,
    law_for_sofa,
)
from softcal_jax.exchange.sofa._configurations import check_robot, scene_data
from softcal_jax.export import results_folder, write_json
from softcal_jax.materials import SofaRotation
from softcal_jax.report import LoadedResult

_NEEDED = {
    "SoftRobots": "SoftRobots (cables and chambers), which the binaries of SOFA hold",
    "Anisotropy": "Anisotropy (https://github.com/VannesteFelix/anisotropy), with "
    "SoftRobots.Inverse that it needs: both must be built from source against this "
    "release, and loaded by `-l Anisotropy`",
}


def write_scene(
    directory: Path,
    data: dict[str, Any],
    tets: Int[HostArray, "n_tets 4"],
    *,
    text: Sequence[str],
    notes: Sequence[str],
    force: bool = False,
) -> None:
    """Write a scene to a folder, whole or not at all, from its `scene_data`.

    README.md quotes `text`, lines on the calibration in columns, and `notes`.
    """
    with results_folder(directory, force=force) as folder:
        mesh = meshio.Mesh(data["positions"], [("tetra", tets)])
        with redirect_stderr(io.StringIO()):  # meshio warns of text, which SOFA reads
            mesh.write(folder / "robot.vtk", file_format="vtk42", binary=False)
        shutil.copyfile(Path(__file__).with_name("scene.py"), folder / "scene.py")
        readme = _readme(data, text, notes)
        (folder / "README.md").write_text(readme, encoding="utf-8")
        write_json(folder / "robot.json", data)


def _readme(data: dict[str, Any], text: Sequence[str], notes: Sequence[str]) -> str:
    """Say what is needed, how to run the scene, and what to expect of it."""
    poses, elasticity = data["configurations"], data["elasticity"]
    driven = [name for name, p in poses.items() if p["cables"] or p["chambers"]]
    plugins = ["SoftRobots"] * bool(driven)
    plugins += [elasticity["plugin"]] * (elasticity["plugin"] in _NEEDED)
    units = ", ".join(f"{what} {unit}" for what, unit in data["units"].items())
    needed = "".join(f"\n- {_NEEDED[plugin]}." for plugin in plugins)
    loaded = "".join(f" -l {plugin}" for plugin in ["SofaPython3", *plugins])
    steps = 100 if next(iter(poses)) in driven else 1
    on_driven = f"""
With cables or chambers: {", ".join(driven)}. SOFA solves these in time, by long \
implicit steps that lose all motion: run on until the effectors stand still. If they \
do not, shorten TIME_STEP in scene.py.
"""
    return f"""\
# {data["name"]} in SOFA

Written by softcal_jax for SOFA {data["release"]} (from the sources of \
{data["release"]}.00), to be run with

- SofaPython3, with NumPy in its Python.{needed}

```sh
runSofa{loaded} -g batch -n {steps} scene.py
```

or, to see it, without `-g batch -n ...` and then Animate. Each step writes where the \
effectors are to `effectors_CONFIGURATION.csv`, with the distance from what \
softcal_jax predicts for the same mesh and law: it should fall to the tolerance of the \
solver.

Configurations: {", ".join(poses)}. The first is run, another one with \
the environment variable SOFTCAL_CONFIGURATION set to its name.
{on_driven if driven else ""}
Units: {units}, mass kg, time s. The law is that of `{elasticity["component"]}`.

## Calibrated for this mesh

SOFA runs linear tets, which are too stiff, and corotational ones with a rotation of \
its own. The values were therefore calibrated again with the mesh and the law of this \
scene, and belong to them alone:

```text
{chr(10).join(text)}
```
""" + "".join(f"\n{note}\n" for note in notes)


class SofaExport(Module):
    """What was written for SOFA.

    Attributes:
        component: The component that computes the law.
        result: Calibration of the model of SOFA, whose values the scene has.
        lines: Values and predictions of both models, and notes.
    """

    component: str
    result: CalibrationResult
    lines: tuple[str, ...]


def export_sofa(
    result: LoadedResult | str | os.PathLike[str],
    directory: str | os.PathLike[str],
    *,
    release: SofaRelease = "v26.06",
    units: SofaUnits = "mm-kg-s",
    law: SofaLaw = "same",
    rotation: SofaRotation = "edge",
    force: bool = False,
    progress: Callable[[HistoryEntry], None] | None = None,
) -> SofaExport:
    """Write a calibrated robot as a static scene of SOFA, calibrated again for it.

    SOFA runs linear tets, which are too stiff, with a rotation of its own. So the model
    is fitted once more to the same measurements, with the mesh and the law of SOFA.

    The folder holds `scene.py` for SofaPython3, `robot.vtk` (the linear mesh),
    `robot.json` (all numbers, in the units of the scene), and `README.md` with the
    command that runs it. The scene holds all configurations, follows their markers and
    compares them with what the model predicts.

    Args:
        result: The results folder, its `result.json`, or what `load_result` returned.
        directory: The folder; it must be new or empty, or hold an earlier scene.
        release: Release of SOFA.
        units: Unit system of the scene.
        law: "same" writes the counterpart of the calibrated law; "corotational" takes
            SOFA's corotational tets for laws with the constants E and nu.
        rotation: Rotation of the corotational tets, see `SofaCorotational`; laws with a
            fibre take that of the plugin Anisotropy.
        force: Replace an earlier scene; files that a user added stay.
        progress: Called after each step of the calibration.

    Raises:
        ResultError: If the result cannot be loaded, see `load_result`.
        FileExistsError: If the folder is not empty, and `force` is off or it holds
            something else.
        NotConvergedError: If the calibration does not converge; nothing is written.
        RuntimeError: If no configuration has an equilibrium with the model of SOFA.
        ValueError: If an option is unknown, or the law, the robot or a support has no
            counterpart in SOFA; the text says why, and what to do.
    """
    check_known("release", get_args(SofaRelease), release)
    check_known("unit system", SCALES, units)
    check_known("law", get_args(SofaLaw), law)
    folder = Path(directory)
    loaded, project = formats.linear_result(result, folder, force=force)
    model = project.model
    check_robot(model)
    sofa_law = law_for_sofa(model.law, model.mesh, choice=law, rotation=rotation)
    assert project.space is not None  # it has been calibrated
    of_plugin = isinstance(getattr(sofa_law, "elasticity", None), PluginElasticity)
    if of_plugin and "mu_l" in project.space.field_names:
        raise ValueError(
            "mu_l is a parameter, but the plugin Anisotropy takes the shear modulus "
            "along the fibre from E_t; calibrate without it, and export that."
        )
    model = model_for_law(model, sofa_law)
    # Refused before the work is done.
    component_of(model.law, model.n_tets, release, SCALES[units])
    refit = formats.recalibrate(loaded, project, model, "SOFA", progress)
    refitted = refit.result
    fitted = refitted.model, refitted.space, refitted.z, *refit.solved
    scene = scene_data(project.name, *fitted, release=release, units=units)
    notes = [*refit.notes]
    others = [f"{e.name} ({c.name})" for c in refitted.configurations for e in c.others]
    if others:
        notes.append(
            "Only points are followed; lengths, volumes and forces are not: "
            f"{', '.join(others)}."
        )
    if of_plugin:
        notes.append(
            "The plugin Anisotropy takes the shear modulus along the fibre from E_t, "
            "and its C13 is not that of the textbook: the values make up for both, and "
            "are no material constants."
        )
    tets = model.mesh.tets
    write_scene(folder, scene, tets, text=refit.lines, notes=notes, force=force)
    lines = *refit.lines, *([""] if notes else []), *notes
    return SofaExport(scene["elasticity"]["component"], refitted, lines)
