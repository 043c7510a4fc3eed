"""The folder of a scene: mesh, numbers, script and how to run it."""

import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from softcal_jax._typing import Float, HostArray, Int
from softcal_jax.exchange.sofa._component import Component, Scale
from softcal_jax.export import file_stems, results_folder, write_json
from softcal_jax.mesh import TetMesh

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
        lines = _readme(scene, text, notes)
        (folder / files[2]).write_text("\n".join(lines) + "\n", encoding="utf-8")
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
    rows = lambda table: [" ".join(map(repr, row)) for row in table.tolist()]
    lines = [
        "# vtk DataFile Version 4.2",
        "written by softcal_jax",
        "ASCII",
        "DATASET UNSTRUCTURED_GRID",
        f"POINTS {len(points)} double",
        *rows(points),
        f"CELLS {len(tets)} {5 * len(tets)}",
        *(f"4 {row}" for row in rows(tets)),
        f"CELL_TYPES {len(tets)}",
        *["10"] * len(tets),
    ]
    path.write_text("\n".join(lines) + "\n", encoding="ascii")


def _readme(scene: Scene, text: Sequence[str], notes: Sequence[str]) -> list[str]:
    """Say what is needed, how to run the scene, and what to expect of it."""
    first, *_ = scene.configurations
    units = ", ".join(f"{what} {unit}" for what, unit in scene.scale.words.items())
    needed = [f"- {_NEEDED[plugin]}." for plugin in scene.plugins]
    loaded = "".join(f" -l {plugin}" for plugin in ["SofaPython3", *scene.plugins])
    steps = 100 if first in scene.driven else 1
    on_driven = [
        "",
        f"With cables or chambers: {', '.join(scene.driven)}. SOFA solves these in "
        "time, by long implicit steps that lose all motion: run on until the effectors "
        "stand still. If they do not, shorten TIME_STEP in scene.py.",
    ]
    return [
        f"# {scene.name} in SOFA",
        "",
        f"Written by softcal_jax for SOFA {scene.release} (from the sources of "
        f"{scene.release}.00), to be run with",
        "",
        "- SofaPython3, with NumPy in its Python.",
        *needed,
        "",
        "```sh",
        f"runSofa{loaded} -g batch -n {steps} scene.py",
        "```",
        "",
        "or, to see it, without `-g batch -n ...` and then Animate. Each step writes "
        "where the effectors are to `effectors_CONFIGURATION.csv`, with the distance "
        "from what softcal_jax predicts for the same mesh and law: it should fall to "
        "the tolerance of the solver.",
        "",
        f"Configurations: {', '.join(scene.configurations)}. The first is run, another "
        "one with the environment variable SOFTCAL_CONFIGURATION set to its name.",
        *(on_driven if scene.driven else []),
        "",
        f"Units: {units}, mass kg, time s. The law is that of "
        f"`{scene.elasticity.component}`.",
        "",
        "## Calibrated for this mesh",
        "",
        "SOFA runs linear tets, which are too stiff, and corotational ones with a "
        "rotation of its own. The values were therefore calibrated again with the mesh "
        "and the law of this scene, and belong to them alone:",
        "",
        "```text",
        *text,
        "```",
        *(line for note in notes for line in ("", note)),
    ]
