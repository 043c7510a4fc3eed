"""What fills CAD models with tets: gmsh, and fTetWild where a surface is not clean.

Gmsh is loaded, started and ended here alone.
"""

import importlib.util
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import pairwise
from math import sqrt
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from softcal_jax._limits import TETS
from softcal_jax._text import escaped
from softcal_jax._typing import Float, HostArray, Int
from softcal_jax.mesh import SHARP, ParserError, parse_mesh_file

_TRIANGLE, _TET = 2, 4
"""Gmsh's numbers of the types of linear elements."""

_PER_TURN = 12
"""Edges around a full turn of a curved face: chords 3 % of its radius inside it."""

_FINEST = 0.25
"""Shortest edges at curved faces, over the size: small fillets are not followed."""

_USUAL = 30.0
"""Diagonal of a model over the size, where none is given."""

_REGULAR = 1.0 / (6.0 * sqrt(2.0))
"""Volume of the regular tet over the cube of its edge [-]."""


ENVELOPE = 1e-3
"""How far the surface may move, over the diagonal of the model [-]."""

_PROGRAM = """\
import sys
import numpy as np
import pytetwild
given = np.load(sys.argv[1])
points, tets = pytetwild.tetrahedralize(
    given["points"], given["triangles"], edge_length_abs=float(given["size"]),
    epsilon=float(given["envelope"]), num_threads=1, quiet=True,
)
np.savez(sys.argv[2], points=points, tets=tets)
"""


class Triangles(NamedTuple):
    """A surface of triangles in the unit of its file, with each corner once."""

    points: Float[HostArray, "n_points 3"]
    triangles: Int[HostArray, "n_triangles 3"]

    @property
    def volume(self) -> float:
        """Volume that the triangles enclose, where their normals point outwards."""
        a, b, c = np.moveaxis(self.points[self.triangles] - self.points[0], 1, 0)
        return float(np.sum(a * np.cross(b, c)) / 6.0)

    @property
    def n_open_edges(self) -> int:
        """Number of edges that do not belong to exactly two triangles."""
        ends = np.stack([self.triangles, np.roll(self.triangles, -1, axis=1)], axis=-1)
        ends = np.sort(ends.reshape(-1, 2), axis=1)
        _, counts = np.unique(ends, axis=0, return_counts=True)
        return int(np.sum(counts != 2))


def read_stl(path: Path) -> Triangles:
    """Read an STL file, binary or text; corners at the same place become one.

    Raises:
        ValueError: If it cannot be read, or holds no triangles.
    """
    try:
        raw, _ = parse_mesh_file(path, "stl")
    except ParserError as error:
        raise ValueError(
            "it cannot be read as STL; it may be truncated or another kind of file. The"
            f" parser said: {error}"
        ) from error
    triangles = raw.cells_dict.get("triangle", np.zeros((0, 3), int))
    points = np.asarray(raw.points, float)
    if not len(triangles) or not np.isfinite(points).all():
        raise ValueError(
            f"it holds {len(triangles)} triangles, expected a closed surface of "
            "triangles with finite coordinates."
        )
    return Triangles(points, np.asarray(triangles, int))


class GmshError(ValueError):
    """Gmsh does not fill a model, or its surface is open; the text is what it says."""


class Filled(NamedTuple):
    """A volume filled with linear tets, in the length unit of the model.

    `faces` are corners of the triangles on each face of the model that bounds the body,
    `solids` indices of the tets of each solid; the volume of the model is nan if
    unknown.
    """

    points: Float[HostArray, "n_nodes 3"]
    tets: Int[HostArray, "n_tets 4"]
    faces: list[Int[HostArray, "_ 3"]]
    solids: list[Int[HostArray, " _"]]
    volume: float


@contextmanager
def _gmsh_model() -> Iterator[Any]:
    """Start gmsh silently with an empty model, and end it in any case.

    Ctrl-C and SIGTERM stay with Python. One thread makes the same mesh each time. What
    gmsh raises inside the block becomes a GmshError.
    """
    gmsh = _load()
    if gmsh.isInitialized():
        raise RuntimeError(
            "this program uses gmsh already, and gmsh has one state for all of it: end "
            "that with gmsh.finalize() first."
        )
    gmsh.initialize(readConfigFiles=False, interruptible=False)
    try:
        _restore_handlers()
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.option.setNumber("General.NumThreads", 1)
        try:
            yield gmsh
        except (ValueError, OSError):
            raise
        except Exception as error:  # gmsh raises this class itself
            said = escaped(" ".join(str(error).split()))
            raise GmshError(f"{said or 'it does not say why'}.") from error
    finally:
        gmsh.finalize()


def _restore_handlers() -> None:
    """Give signals back to the handlers that Python knows.

    Gmsh resets SIGTERM in C, where Python does not see it: from then on, the signal
    would kill the program without its handler.
    """
    if threading.current_thread() is not threading.main_thread():
        return  # only the main thread may choose
    for number in (signal.SIGINT, signal.SIGTERM):
        handler = signal.getsignal(number)
        if handler is not None:
            signal.signal(number, handler)


def _load() -> Any:
    try:
        import gmsh  # pyright: ignore[reportMissingImports]
    except ImportError as error:
        raise ImportError(
            "making a mesh of a CAD model needs gmsh: pip install 'softcal-jax[cad]'."
        ) from error
    except OSError as error:
        raise ImportError(
            f"gmsh is installed, but cannot be loaded ({error}). On Debian or Ubuntu: "
            "sudo apt install libgl1 libglu1-mesa libxcursor1 libxft2 libxinerama1"
        ) from error
    return gmsh


def fill_step(path: Path, size: float | None) -> Filled:
    """Fill the solids of a STEP file; the size and the result are in mm."""
    with _gmsh_model() as gmsh:
        gmsh.option.setString("Geometry.OCCTargetUnit", "MM")
        shape = gmsh.model.occ
        shape.importShapes(str(path))
        shape.synchronize()
        solids = gmsh.model.getEntities(3)
        if not solids:
            raise ValueError(
                "it has no solid, only surfaces or curves, and what lies inside them is"
                " not known. Export the body as a solid."
            )
        if len(solids) > 1:  # so that they share faces where they touch
            shape.fragment(solids, [])
            shape.synchronize()
        volume = sum(shape.getMass(3, t) for _, t in gmsh.model.getEntities(3))
        return _filled(gmsh, volume, size)


def fill_stl(path: Path, triangles: Triangles, size: float) -> Filled:
    """Fill the inside of an STL surface; lengths are in the unit of the file."""
    if n := triangles.n_open_edges:
        raise GmshError(f"it is not closed, {n} edges do not join two triangles.")
    with _gmsh_model() as gmsh:
        gmsh.merge(str(path))
        gmsh.model.mesh.classifySurfaces(SHARP, True, True, np.pi)
        gmsh.model.mesh.createGeometry()
        surfaces = [tag for _, tag in gmsh.model.getEntities(2)]
        loop = gmsh.model.geo.addSurfaceLoop(surfaces)
        gmsh.model.geo.addVolume([loop])
        gmsh.model.geo.synchronize()
        filled = _filled(gmsh, abs(triangles.volume), size)
    # Gmsh cuts round surfaces in patches, which are no faces of the body, and triangles
    # may be turned either way, so that what they enclose is not known.
    return filled._replace(faces=[], volume=np.nan)


def fill_wild(triangles: Triangles, size: float) -> Filled:
    """Fill a surface with holes, crossings or repeated triangles, by pytetwild.

    FTetWild, Y. Hu et al., ACM Trans. Graph. 39 (2020).
    """
    if importlib.util.find_spec("pytetwild") is None:
        raise ImportError("No module named 'pytetwild'", name="pytetwild")
    # A process of its own: it leaves a file where it runs, and a crash would end ours.
    with tempfile.TemporaryDirectory() as folder:
        given, made = Path(folder, "given.npz"), Path(folder, "made.npz")
        np.savez(given, **triangles._asdict(), size=size, envelope=ENVELOPE)
        command = [sys.executable, "-c", _PROGRAM, str(given), str(made)]
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
        if done.returncode != 0:
            last = (done.stderr.strip().splitlines() or ["it crashed"])[-1]
            raise ValueError(
                f"gmsh cannot fill this surface, and fTetWild fails: {last}."
            )
        with np.load(made) as arrays:
            points, tets = arrays["points"], arrays["tets"]
    if not len(tets):
        raise ValueError("gmsh cannot fill this surface, and fTetWild makes no tets.")
    used, tets = np.unique(tets, return_inverse=True)
    return Filled(
        points=np.asarray(points, float)[used],
        tets=tets.reshape(-1, 4),
        faces=[],
        solids=[],
        volume=np.nan,  # that of the triangles, if they enclose one, is not known
    )


def usual_size(extent: Float[HostArray, "3"]) -> float:
    """Choose the length of edges of tets for a model of this extent."""
    return float(np.linalg.norm(extent)) / _USUAL


def check_number(volume: float, size: float) -> None:
    """Raise before gmsh spends hours on too many tets."""
    TETS.check(f"edges of {size:g} are too short", volume / (_REGULAR * size**3))


def _filled(gmsh: Any, volume: float, size: float | None) -> Filled:
    """Fill the volumes of the model, and collect its tets and outer faces."""
    if size is None:
        low_high = np.reshape(gmsh.model.getBoundingBox(-1, -1), (2, 3))
        size = usual_size(np.ptp(low_high, axis=0))
    check_number(volume, size)
    gmsh.option.setNumber("Mesh.MeshSizeMax", size)
    gmsh.option.setNumber("Mesh.MeshSizeMin", _FINEST * size)
    gmsh.option.setNumber("Mesh.MeshSizeFromCurvature", _PER_TURN)
    gmsh.model.mesh.generate(3)
    tags, coordinates, _ = gmsh.model.mesh.getNodes()
    nodes_of = lambda kind, tag: gmsh.model.mesh.getElementsByType(kind, tag)[1]
    by_solid = [nodes_of(_TET, tag).astype(int) for _, tag in gmsh.model.getEntities(3)]
    tets = np.concatenate(by_solid).reshape(-1, 4)
    if not len(tets):
        raise GmshError("it made no tets.")
    outer = [
        tag
        for _, tag in gmsh.model.getEntities(2)
        if len(gmsh.model.getAdjacencies(2, tag)[0]) == 1
    ]
    triangles = [nodes_of(_TRIANGLE, tag).astype(int).reshape(-1, 3) for tag in outer]
    used, tets = np.unique(tets, return_inverse=True)
    index = np.full(int(tags.max()) + 1, -1)
    index[used] = np.arange(len(used))
    places = np.empty((len(index), 3))
    places[tags.astype(int)] = coordinates.reshape(-1, 3)
    ends = np.cumsum([0, *(len(nodes) // 4 for nodes in by_solid)])
    return Filled(
        points=places[used],
        tets=tets.reshape(-1, 4),
        faces=[index[corners] for corners in triangles],
        solids=[np.arange(a, b) for a, b in pairwise(ends)],
        volume=volume,
    )
