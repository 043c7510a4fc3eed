"""A project folder for a robot: a ready-made one, or one's own mesh or CAD model."""

import shutil
import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from softcal_jax._names import check_unique
from softcal_jax._typing import Float, HostArray
from softcal_jax.exchange.proposal._body import (
    Body,
    far_end,
    propose_held,
    read_body,
)
from softcal_jax.exchange.proposal._cavities import find_actuated
from softcal_jax.exchange.proposal._file import project_text
from softcal_jax.exchange.proposal._recorded import (
    Findings,
    MarkerPlace,
    Recorded,
    read_recorded,
)
from softcal_jax.export import results_folder
from softcal_jax.mesh import MaterialPoints, MeshWarning, TetMesh, locate, mesh_files
from softcal_jax.project import ProjectWarning, load_project
from softcal_jax.robots import ready_made_path

PROJECT = "project.toml"

_SAME_FRAME = 0.3
"""Distance from the mesh, as a share of its size, up to which markers share its frame.

Posts that carry markers are shorter; cameras stand farther away from the robot.
"""


def write_ready_made(name: str, folder: Path) -> tuple[str, ...]:
    """Write the project file and the data of a ready-made robot into a new folder.

    Robots are named in `softcal_jax.robots.READY_MADE`. Returns the names of the files.

    Raises:
        ValueError: If there is no such robot, or the folder exists.
        OSError: If it cannot be written.
    """
    source = ready_made_path(name).parent
    files = sorted(path for path in source.iterdir() if path.is_file())
    _check_absent(folder)
    with results_folder(folder, replaceable=False) as made:
        for file in files:
            shutil.copyfile(file, made / file.name)
    return tuple(file.name for file in files)


def propose_project(
    model: Path,
    folder: Path,
    *,
    recordings: Sequence[Path] = (),
    size: float | None = None,
    length_unit: str | None = None,
) -> Findings:
    """Write a project for a mesh or CAD model, and guess what the files do not state.

    Each guess has a remark "# CHANGE: ..."; `load_project` warns of those that stay.

    Args:
        model: A mesh file, or a STEP or STL file.
        folder: The folder, which must not be there. Model and recordings are copied.
        recordings: A table of markers, or recordings over time, a pose in each.
        size: Edges of the tets of a CAD model; a twentieth of it by default [m].
        length_unit: Unit of the model; guessed where it states none.

    Raises:
        FileNotFoundError: If a file is not there.
        ValueError: If the folder is there, a file cannot be read, or no project can be
            made of what they hold.
        ImportError: If a file needs a package that is not installed.
        OSError: If the folder cannot be written.
    """
    _check_absent(folder)
    check_unique("file", [file.name for file in (model, *recordings)])
    body = read_body(model, size=size, length_unit=length_unit)
    recorded = None
    if recordings:
        recorded = read_recorded(recordings, float(np.ptp(body.mesh.points, 0).max()))
    findings = _find(model, body, recorded)
    with results_folder(folder, replaceable=False) as made:
        for file in (model, *recordings):
            if file is not model or findings.model == model.name:
                shutil.copyfile(file, made / file.name)
        text = project_text(folder.name, findings)
        (made / PROJECT).write_text(text, encoding="utf-8")
        with warnings.catch_warnings():  # `softcal check` shows them, with final paths
            warnings.simplefilter("ignore", MeshWarning)
            warnings.simplefilter("ignore", ProjectWarning)
            load_project(made / PROJECT, solve=False)
    return findings


def _find(model: Path, body: Body, recorded: Recorded | None) -> Findings:
    """Collect what the files state, and guess the rest."""
    mesh, located, own_frame = body.mesh, None, False
    if recorded is not None:
        located = locate(mesh, recorded.positions, max_distance=np.inf)
        own_frame = bool(located.distance.max() > _SAME_FRAME * mesh.size)
    moving = None if recorded is None or own_frame else recorded.moving
    held = propose_held(mesh, moving)
    tip = far_end(mesh, held)
    if recorded is None or located is None:
        middle = _on_top(mesh, 0.5 * (tip + held.centre))
        markers = MarkerPlace("tip", tip, 0.0), MarkerPlace("middle", middle, 0.0)
    else:
        markers = _markers(mesh, recorded, located, own_frame=own_frame)
    # A file that includes others would have to be copied with all of them.
    alone = len(mesh_files(model)) == 1
    return Findings(
        model=model.name if alone else str(model.resolve()),
        body=body,
        held=held,
        # Within a tet, since a finer or coarser mesh has its skin elsewhere.
        tip=mesh.centroids[locate(mesh, tip[None], max_distance=np.inf).tet[0]],
        actuated=find_actuated(mesh),
        recorded=recorded,
        own_frame=own_frame,
        markers=markers,
    )


def _markers(
    mesh: TetMesh, recorded: Recorded, located: MaterialPoints, *, own_frame: bool
) -> tuple[MarkerPlace, ...]:
    """Place markers at the points of the mesh that are nearest to their readings."""
    places = located.foot
    if own_frame:
        box = lambda points: 0.5 * (points.min(axis=0) + points.max(axis=0))
        shifted = recorded.positions + box(mesh.points) - box(recorded.positions)
        places = locate(mesh, shifted, max_distance=np.inf).foot
    placed = zip(recorded.labels, places, located.distance.tolist(), strict=True)
    return tuple(MarkerPlace(*each) for each in placed)


def _on_top(mesh: TetMesh, place: Float[HostArray, "3"]) -> Float[HostArray, "3"]:
    """Return a point of the skin above a place within, or at a larger x [m]."""
    # From the box around the mesh, since the nearest point may be in a cavity.
    low, high = mesh.points.min(axis=0), mesh.points.max(axis=0)
    side = 0 if np.argmax(high - low) == 2 else 2
    above = np.where(np.arange(3) == side, high, place)
    return locate(mesh, above[None], max_distance=np.inf).foot[0]


def _check_absent(folder: Path) -> None:
    """Raise ValueError if there is something where the folder is to be."""
    if folder.exists() or folder.is_symlink():
        raise ValueError(
            f"{folder} is there already, and nothing of it is overwritten. Choose "
            "another name."
        )
