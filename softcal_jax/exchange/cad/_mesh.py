"""Meshes of CAD models: solids of a STEP file, or the inside of an STL surface.

Gmsh fills them with tets, or fTetWild where a surface is not clean, in processes of
their own (`_program.py`), with limits on time and memory.
"""

import importlib.util
import math
import os
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from softcal_jax import mesh as meshes
from softcal_jax._apart import run_apart
from softcal_jax._files import check_file, digest_of
from softcal_jax._module import key, keys
from softcal_jax._places import (
    MESHING_MEGABYTES,
    MESHING_SECONDS,
    TETS,
    Limit,
    LimitError,
    cause,
    replacing,
)
from softcal_jax._text import escaped
from softcal_jax._typing import Float, HostArray, Int
from softcal_jax._units import METRES, readable_values
from softcal_jax.exchange.cad._surface import Triangles, read_stl, turned_outwards

_STEP = (".step", ".stp")
CAD_FORMATS = (*_STEP, ".stl")
"""Extensions of CAD models."""

PROGRAM = Path(__file__).with_name("_program.py")
"""What fills models, in a process of its own."""

_LOST = 0.02  # share of the volume that flat faces may cut off without a warning [-]


class FillingError(ValueError):
    """A program does not fill a model; the text is what it says."""


STRAY = 0.01
"""Share of tets that fTetWild may leave apart from the rest, and that are left out."""


class Filled(NamedTuple):
    """A volume filled with linear tets, in the length unit of the model.

    `faces` are corners of the triangles on each face of the model that bounds the body,
    `solids` indices of the tets of each solid; the volume of the model is nan if
    unknown. `n_flat` tets are flat.
    """

    points: Float[HostArray, "n_nodes 3"]
    tets: Int[HostArray, "n_tets 4"]
    faces: Sequence[Int[HostArray, "_ 3"]] = ()
    solids: Sequence[Int[HostArray, " _"]] = ()
    volume: float = math.nan
    n_flat: int = 0


@keys(
    path=key(words='a CAD model: "finger.step" or "finger.stl"', key="file"),
    size=key("m", 'length of its edges: "3 mm"', "positive", required=True),
    length_unit=key(),
)
def mesh_cad(
    path: str | os.PathLike[str],
    *,
    size: float | None = None,
    length_unit: str | None = None,
    order: int = 2,
    kept_in: Path | None = None,
) -> meshes.TetMesh:
    """Fill a CAD model with tets by gmsh, and name its faces and solids.

    STEP files (.step, .stp) hold solids. Their faces become the surface groups
    "face 1", "face 2" and so on, where they bound the body; solids the tet groups
    "solid 1" and so on, joined where they touch. STL files (.stl) hold triangles; the
    mesh gets new ones, and edges of more than 40 degrees divide its faces.
    Where gmsh refuses an STL surface (holes, crossings), or its tets are flat, fTetWild
    fills it, if the package pytetwild is installed, within a thousandth of the model's
    size except over holes; a warning says how far off it is. FTetWild makes another
    mesh each time, so it is kept; a few tets that it leaves apart are left out.

    Round faces get 12 edges a turn or more, down to a quarter of the size. All edges
    are straight, those of quadratic tets too.

    Args:
        path: The file.
        size: Longest edges of the tets that gmsh aims at [m]; None for a thirtieth of
            the diagonal of the model.
        length_unit: Unit of an STL file, which does not state it: "m", "cm", "mm",
            "um" or "inch". None for a STEP file, which states it.
        order: 2 for quadratic tets, 1 for linear ones.
        kept_in: Folder in which a mesh of fTetWild is kept, and looked for by what it
            is made of; None to make it each time.

    Raises:
        FileNotFoundError: If there is no such file.
        ImportError: If gmsh is not installed.
        ValueError: If the file cannot be read or filled, has no solid, the size is not
            positive or makes too many tets, the unit is missing or stated twice, or
            gmsh crashes, or takes more time or memory than `SOFTCAL_MAX_MESHING_S`
            (600 s) and `SOFTCAL_MAX_MESHING_MB` (8000 MB) in the environment allow.

    Warns:
        MeshWarning: If fTetWild had to fill the surface, flat faces change the volume
            by more than 2 %, or triangles of an STL file are turned the wrong way.
    """
    path = Path(path)
    meshes.check_order(order)
    if size is not None and not (math.isfinite(size) and size > 0.0):
        raise ValueError(f"size must be positive and finite [m], got {size}.")
    unit = _unit(path, length_unit)
    check_file(path, "CAD model")
    metres, notes = METRES[unit], []
    model_size = None if size is None else size / metres
    try:
        filled = _filled(path, model_size, metres, kept_in, notes)
        mesh = _named(filled, metres)
        meshes.check_mesh(mesh)
    except (ValueError, ImportError) as error:
        raise type(error)(f"{path}: {escaped(str(error))}") from error
    share = meshes.volumes(mesh).sum() / (filled.volume * metres**3) - 1.0
    if abs(share) > _LOST:
        notes.append(
            f"the mesh has {100 * abs(share):.1f} % {'more' if share > 0 else 'less'} "
            "volume than the model, since its faces are flat; a smaller size follows "
            "round faces better."
        )
    for note in notes:
        warnings.warn(f"{path}: {note}", meshes.MeshWarning, stacklevel=2)
    return mesh if order == 1 else meshes.to_quadratic(mesh)


def _unit(path: Path, length_unit: str | None) -> str:
    """Return the unit in which the model is meshed."""
    suffix = path.suffix.lower()
    if suffix not in CAD_FORMATS:
        raise ValueError(
            f"CAD model {path} has the extension {suffix!r}; expected one of "
            f"{', '.join(CAD_FORMATS)}."
        )
    if suffix in _STEP:
        if length_unit is not None:
            raise ValueError(
                f"{path}: got the length unit {length_unit!r}, but a STEP file states "
                "its own. Leave it out."
            )
        return "mm"
    if length_unit not in METRES:
        raise ValueError(
            f"{path}: an STL file does not state its unit; expected a length unit, one "
            f"of {', '.join(METRES)}, got {length_unit!r}."
        )
    return length_unit


def _filled(
    path: Path,
    size: float | None,
    metres: float,
    kept_in: Path | None,
    notes: list[str],
) -> Filled:
    """Fill a model by gmsh, or its surface by fTetWild where gmsh cannot."""
    surface: Triangles | None = None
    faces: Sequence[HostArray] = ()
    try:
        if path.suffix.lower() in _STEP:
            given = {"path": str(path.absolute())}  # `fill` works in another folder
            filled = fill("gmsh, STEP", given, size)
            faces = filled.faces
        else:
            surface, turned = turned_outwards(read_stl(path))
            notes += turned
            if n := int((meshes.sides_of(surface.triangles).counts != 2).sum()):
                raise FillingError(f"it is open: {n} edges do not join two triangles.")
            filled = fill("gmsh, STL", surface.given, size)
        # FTetWild would make one solid of several.
        if not filled.n_flat or len(filled.solids) > 1:
            return filled
        said = f"{filled.n_flat} of its tets are flat."
        if surface is None:
            model = Triangles(filled.points, np.concatenate(faces))
            surface, _ = turned_outwards(model)
    except FillingError as error:
        if surface is None:  # where no memory is left, some parts of gmsh crash
            raise ValueError(
                f"{error} The file seems to be damaged, or its surfaces cross: open it "
                "in a CAD program, mend it, and export it again. If it is sound, it "
                f"may need more memory than the limit of {MESHING_MEGABYTES.most:g} MB,"
                f" which the environment variable {MESHING_MEGABYTES.variable} raises."
            ) from error
        said = str(error)
    said = f"gmsh cannot fill this surface: {said}"
    try:
        mesh = _wild_mesh(path, surface, size, kept_in, notes)
    except ImportError as error:
        raise ValueError(
            f"{said} Mend it (holes, crossings, repeated triangles), export a STEP "
            "file, or let fTetWild fill it as it is: pip install pytetwild."
        ) from error
    outer = meshes.boundary_faces(mesh)
    places = np.concatenate([mesh.points[outer].mean(axis=1), mesh.points[outer[:, 0]]])
    nearest, feet = surface.polydata.find_closest_cell(
        places, return_closest_point=True
    )
    gaps = metres * np.linalg.norm(feet - places, axis=1)
    notes.append(
        f"{said} So fTetWild filled it; the surface of the mesh lies up to "
        f"{readable_values([gaps.max()], 'm', digits=3)} from that of the file, at "
        f"{meshes.place(metres * places[gaps.argmax()])}: how it closes a hole is a "
        "guess, and outside is where triangles are turned to. Look at the picture that "
        "`softcal mesh` draws."
    )
    # Faces of a model keep their numbers: each triangle is of the face nearest to it.
    owner = np.repeat(np.arange(len(faces)), [len(face) for face in faces])
    of_face = [outer[owner[nearest[: len(outer)]] == k] for k in range(len(faces))]
    return Filled(mesh.points, mesh.tets, of_face)


def _wild_mesh(
    path: Path,
    surface: Triangles,
    size: float | None,
    kept_in: Path | None,
    notes: list[str],
) -> meshes.TetMesh:
    """Read the mesh of fTetWild that is kept of a surface, or make and keep it."""
    # A project file states the size with six digits.
    digest = digest_of(surface, f"size {size and f'{size:.6g}'}")
    file = kept_in and kept_in / f"{path.stem}.ftetwild-{digest[:12]}.msh"
    if file is None or not file.exists():
        made = fill("pytetwild", surface.given, size)
        tets = meshes.oriented(made.tets, made.points[made.tets])
        part = meshes.connected_parts(tets)
        largest = part == np.argmax(np.bincount(part))
        if np.sum(~largest) < STRAY * len(tets):
            used, tets = np.unique(tets[largest], return_inverse=True)
            made = made._replace(points=made.points[used])
        mesh = meshes.TetMesh(made.points, tets.reshape(-1, 4))
        meshes.check_mesh(mesh)
        if file is None:
            return mesh
        try:
            if not file.exists():  # another process may have made it meanwhile
                with replacing(file) as new:
                    meshes.write_mesh(mesh, new, length_unit="m")
        except OSError as error:
            notes.append(
                "fTetWild makes another mesh each time, and this one cannot be kept "
                f"({cause(error)}): make it once with `softcal mesh`, and name that "
                "file in the project."
            )
            return mesh
    return meshes.read_mesh(file, length_unit="m", order=1)


def _named(filled: Filled, metres: float) -> meshes.TetMesh:
    """Build the mesh [m], with its faces and solids as groups."""
    mesh = meshes.TetMesh(metres * filled.points, filled.tets)
    if filled.faces:
        faces = meshes.matching_faces(mesh, filled.faces)
    else:
        faces = meshes.surface_parts(mesh)
    for k, face in enumerate(faces):
        if len(face):  # one that was merged into others leaves its number free
            mesh = mesh.with_surface_group(f"face {k + 1}", face)
    if len(filled.solids) > 1:
        for k, tets in enumerate(filled.solids):
            mesh = mesh.with_tet_group(f"solid {k + 1}", tets)
    return mesh


def fill(by: str, given: dict[str, Any], size: float | None) -> Filled:
    """Fill a model by "gmsh, STEP", "gmsh, STL" or "pytetwild", in its unit."""
    package = by.split(",")[0]
    if importlib.util.find_spec(package) is None:
        raise ImportError(
            f"making a mesh of a CAD model needs {package}: pip install "
            "'softcal-jax[cad]'."
        )
    given = {"by": by, "size": size, **given, "sharp": meshes.SHARP, "most": TETS.most}
    name = "fTetWild" if by == "pytetwild" else "gmsh"
    try:
        made, _ = run_apart(PROGRAM, given)
    except OverflowError as error:
        raise TETS.error(*error.args) from error
    except TimeoutError as error:
        what = f"{name} has not filled it within"
        raise _at_limit(what, MESHING_SECONDS) from error
    except MemoryError as error:
        what = f"{name} needs more memory than there is, or than"
        raise _at_limit(what, MESHING_MEGABYTES) from error
    except RuntimeError as error:
        raise FillingError(f"{name} fails: {str(error).rstrip('.')}.") from error
    return Filled(**made)


def _at_limit(what: str, limit: Limit) -> LimitError:
    return LimitError(
        f"{what} the limit of {limit.most:g} {limit.unit}, as happens where a model is "
        "damaged. Export it again, take larger tets, or raise the limit with the "
        f"environment variable {limit.variable}."
    )
