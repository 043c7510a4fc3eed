"""Export a calibrated robot as a scene of SOFA: calibrate it again, and write it."""

import os
import shutil
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple, get_args

import numpy as np

from softcal_jax._module import Module
from softcal_jax._names import check_known
from softcal_jax._typing import Float, HostArray, Int
from softcal_jax.calibration import CalibrationResult, HistoryEntry
from softcal_jax.equilibrium import model_for_law
from softcal_jax.exchange import _formats as formats
from softcal_jax.exchange.sofa._component import (
    SCALES,
    Component,
    PluginElasticity,
    Scale,
    SofaLaw,
    SofaRelease,
    SofaUnits,
    component_of,
    law_for_sofa,
)
from softcal_jax.exchange.sofa._configurations import check_robot, scene_configurations
from softcal_jax.export import file_stems, results_folder, write_json
from softcal_jax.materials import SofaRotation
from softcal_jax.mesh import TetMesh
from softcal_jax.report import LoadedResult

_NEEDED = {
    "SoftRobots": "SoftRobots (cables and chambers), which the binaries of SOFA hold",
    "Anisotropy": "Anisotropy (https://github.com/VannesteFelix/anisotropy), with "
    "SoftRobots.Inverse that it needs: both must be built from source against this "
    "release, and loaded by `-l Anisotropy`",
}


class Scene(NamedTuple):
    """All of a scene but its script, with the mesh in m and masses in kg."""

    name: str
    release: str
    scale: Scale
    mesh: TetMesh
    elasticity: Component
    vertex_mass: Float[HostArray, " n_nodes"]
    configurations: dict[str, dict[str, Any]]

    @property
    def driven(self) -> list[str]:
        """Names of the configurations with cables or chambers."""
        posed = self.configurations.items()
        return [name for name, pose in posed if pose["cables"] or pose["chambers"]]

    @property
    def plugins(self) -> list[str]:
        """Plugins that are not part of SOFA itself."""
        plugin = self.elasticity.plugin
        return ["SoftRobots"] * bool(self.driven) + [plugin] * (plugin in _NEEDED)


def write_scene(
    directory: Path,
    scene: Scene,
    *,
    text: Sequence[str],
    notes: Sequence[str],
    force: bool = False,
) -> None:
    """Write a scene to a folder, whole or not at all.

    README.md quotes `text`, lines on the calibration in columns, and `notes`.
    """
    points = scene.scale.length * scene.mesh.points
    stems = file_stems(list(scene.configurations))
    named = zip(scene.configurations.items(), stems, strict=True)
    files = ["robot.vtk", "scene.py", "README.md"]
    with results_folder(directory, force=force) as folder:
        _write_vtk(folder / files[0], points, scene.mesh.tets)
        shutil.copyfile(Path(__file__).with_name("scene.py"), folder / files[1])
        readme = _readme(scene, text, notes)
        (folder / files[2]).write_text(readme, encoding="utf-8")
        data = {
            "format": "softcal_jax.sofa/1",
            "name": scene.name,
            "release": scene.release,
            "units": scene.scale.words,
            "elasticity": scene.elasticity._asdict(),
            "positions": points.tolist(),
            "vertex mass": scene.vertex_mass.tolist(),
            "configurations": {
                name: {"file": stem, **pose} for (name, pose), stem in named
            },
            "files": files,
        }
        write_json(folder / "robot.json", data)


def _write_vtk(
    path: Path, points: Float[HostArray, "n 3"], tets: Int[HostArray, "n_tets 4"]
) -> None:
    """Write linear tets as SOFA reads them: VTK before version 5, as text.

    Numbers have full precision, which the writer of VTK itself does not keep.
    """
    rows = lambda table: "\n".join(" ".join(map(repr, row)) for row in table.tolist())
    cells = np.insert(tets, 0, 4, axis=1)
    text = f"""\
# vtk DataFile Version 4.2
written by softcal_jax
ASCII
DATASET UNSTRUCTURED_GRID
POINTS {len(points)} double
{rows(points)}
CELLS {len(cells)} {cells.size}
{rows(cells)}
CELL_TYPES {len(cells)}
"""
    path.write_text(text + "10\n" * len(cells), encoding="ascii")


def _readme(scene: Scene, text: Sequence[str], notes: Sequence[str]) -> str:
    """Say what is needed, how to run the scene, and what to expect of it."""
    first, *_ = scene.configurations
    units = ", ".join(f"{what} {unit}" for what, unit in scene.scale.words.items())
    needed = "".join(f"\n- {_NEEDED[plugin]}." for plugin in scene.plugins)
    loaded = "".join(f" -l {plugin}" for plugin in ["SofaPython3", *scene.plugins])
    steps = 100 if first in scene.driven else 1
    on_driven = f"""
With cables or chambers: {", ".join(scene.driven)}. SOFA solves these in time, by long \
implicit steps that lose all motion: run on until the effectors stand still. If they \
do not, shorten TIME_STEP in scene.py.
"""
    return f"""\
# {scene.name} in SOFA

Written by softcal_jax for SOFA {scene.release} (from the sources of \
{scene.release}.00), to be run with

- SofaPython3, with NumPy in its Python.{needed}

```sh
runSofa{loaded} -g batch -n {steps} scene.py
```

or, to see it, without `-g batch -n ...` and then Animate. Each step writes where the \
effectors are to `effectors_CONFIGURATION.csv`, with the distance from what \
softcal_jax predicts for the same mesh and law: it should fall to the tolerance of the \
solver.

Configurations: {", ".join(scene.configurations)}. The first is run, another one with \
the environment variable SOFTCAL_CONFIGURATION set to its name.
{on_driven if scene.driven else ""}
Units: {units}, mass kg, time s. The law is that of `{scene.elasticity.component}`.

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
        lines: The values of both models, and a table of what they predict.
        notes: What to know of the scene, in sentences.
    """

    component: str
    result: CalibrationResult
    lines: tuple[str, ...]
    notes: tuple[str, ...]

    def __str__(self) -> str:
        """Write parameters, predictions and notes, line by line."""
        return "\n".join([*self.lines, "", *self.notes]).strip()


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

    SOFA runs linear tets, which are too stiff, with a rotation of its own, so the
    calibrated moduli are not the ones that it needs. The model is therefore fitted once
    more to the same measurements, with the mesh and the law that SOFA will run, and its
    values are written.

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
        NotConvergedError: If the calibration for SOFA does not converge. Nothing is
            written then.
        RuntimeError: If a configuration has no equilibrium with the model of SOFA.
        ValueError: If an option is unknown, or the law, the robot or a support has no
            counterpart in SOFA; the text says why, and what to do.
    """
    check_known("release", get_args(SofaRelease), release)
    check_known("unit system", SCALES, units)
    check_known("law", get_args(SofaLaw), law)
    scale, folder = SCALES[units], Path(directory)
    loaded, project = formats.linear_result(result, folder, force=force)
    check_robot(project.model)
    sofa_law = law_for_sofa(
        project.model.law, project.model.mesh, choice=law, rotation=rotation
    )
    assert project.space is not None  # it has been calibrated
    of_plugin = isinstance(getattr(sofa_law, "elasticity", None), PluginElasticity)
    if of_plugin and "mu_l" in project.space.field_names:
        raise ValueError(
            "mu_l is a parameter, but the plugin Anisotropy takes the shear modulus "
            "along the fibre from E_t; calibrate without it, and export that."
        )
    model = model_for_law(project.model, sofa_law)
    component_of(model.law, model.n_tets, release, scale)  # before the work is done
    refit = formats.recalibrate(loaded, project, model, "SOFA", progress)
    refitted, *solved = refit.result, refit.posed, refit.displacements
    scene = Scene(
        name=project.name,
        release=release,
        scale=scale,
        mesh=model.mesh,
        elasticity=component_of(refitted.model.law, model.n_tets, release, scale),
        vertex_mass=formats.vertex_masses(refitted.model),
        configurations=scene_configurations(
            refitted.model, refitted.space, refitted.z, *solved, scale
        ),
    )
    notes = [*refit.notes, *_notes(refitted, scene)]
    write_scene(folder, scene, text=refit.lines, notes=notes, force=force)
    component = scene.elasticity.component
    return SofaExport(component, refitted, tuple(refit.lines), tuple(notes))


def _notes(refitted: CalibrationResult, scene: Scene) -> Iterator[str]:
    others = [f"{e.name} ({c.name})" for c in refitted.configurations for e in c.others]
    if others:
        yield (
            "Only points are followed; lengths, volumes and forces are not: "
            f"{', '.join(others)}."
        )
    if scene.elasticity.plugin == "Anisotropy":
        yield (
            "The plugin Anisotropy takes the shear modulus along the fibre from E_t, "
            "and its C13 is not that of the textbook: the values make up for both, and "
            "are no material constants."
        )
