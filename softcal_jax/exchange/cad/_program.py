"""Fills a CAD model with tets, in a process of its own: `python _program.py in out`.

Damaged models crash gmsh, or it meshes them for ever, so it runs beside the package,
of which this file imports nothing: it starts in a fraction of a second. What is given
and made, or why nothing is made, are pickled dictionaries; see `exchange.cad._mesh`.
"""

import pickle
import sys
from math import sqrt
from pathlib import Path
from typing import Any

import numpy as np

_TRIANGLE, _TET = 2, 4  # gmsh's numbers of the types of linear elements

_PER_TURN = 12
"""Edges around a full turn of a curved face: chords 3 % of its radius inside it."""

_FINEST = 0.25
"""Shortest edges at curved faces, over the size: small fillets are not followed."""

_USUAL = 30.0  # diagonal of a model over the size, where none is given

_REGULAR = 1.0 / (6.0 * sqrt(2.0))
"""Volume of the regular tet over the cube of its edge [-]."""


class RefusedError(Exception):
    """No mesh is made; `reason` says of what kind the text is."""

    def __init__(self, reason: str, text: str, number: float = np.nan):
        super().__init__(text)
        self.made = {"reason": reason, "text": text, "number": number}


def fill_step(gmsh: Any, given: Any) -> dict[str, Any]:
    """Fill the solids of a STEP file; the size and the result are in mm."""
    gmsh.option.setString("Geometry.OCCTargetUnit", "MM")
    shape = gmsh.model.occ
    shape.importShapes(given["path"])
    shape.synchronize()
    solids = gmsh.model.getEntities(3)
    if not solids:
        raise RefusedError(
            "model",
            "it has no solid, only surfaces or curves, and what lies inside them is not"
            " known. Export the body as a solid.",
        )
    if len(solids) > 1:  # so that they share faces where they touch
        shape.fragment(solids, [])
        shape.synchronize()
    volume = sum(shape.getMass(3, tag) for _, tag in gmsh.model.getEntities(3))
    low_high = np.reshape(gmsh.model.getBoundingBox(-1, -1), (2, 3))
    return _filled(gmsh, volume, _size(given, low_high, volume))


def fill_surface(gmsh: Any, given: Any) -> dict[str, Any]:
    """Fill the inside of a closed surface of triangles."""
    points, triangles = given["points"], given["triangles"]
    tag = gmsh.model.addDiscreteEntity(2)
    numbers = np.arange(1, len(points) + 1)
    gmsh.model.mesh.addNodes(2, tag, numbers, points.ravel())
    nodes = triangles.ravel() + 1
    gmsh.model.mesh.addElementsByType(tag, _TRIANGLE, [], nodes)
    gmsh.model.mesh.classifySurfaces(given["sharp"], True, True, np.pi)
    gmsh.model.mesh.createGeometry()
    surfaces = [tag for _, tag in gmsh.model.getEntities(2)]
    loop = gmsh.model.geo.addSurfaceLoop(surfaces)
    gmsh.model.geo.addVolume([loop])
    gmsh.model.geo.synchronize()
    size = _size(given, points, given["volume"])
    # Gmsh cuts round surfaces in patches, which are no faces of the body.
    return {**_filled(gmsh, given["volume"], size), "faces": [], "solids": []}


def fill_wild(given: Any) -> dict[str, Any]:
    """Fill a surface with holes, crossings or repeated triangles, by pytetwild.

    FTetWild, Y. Hu et al., ACM Trans. Graph. 39 (2020).
    """
    from pytetwild import tetrahedralize  # pyright: ignore[reportPrivateImportUsage]

    _limit_memory(given["megabytes"])
    points, tets = tetrahedralize(
        given["points"],
        given["triangles"],
        edge_length_abs=_size(given, given["points"], given["volume"]),
        epsilon=given["envelope"],
        num_threads=1,
        quiet=True,
    )
    if not len(tets):
        raise RefusedError("model", "fTetWild makes no tets of it")
    used, tets = np.unique(tets, return_inverse=True)
    made = {"points": np.asarray(points, float)[used], "tets": tets.reshape(-1, 4)}
    return {**made, "faces": [], "solids": [], "volume": np.nan}


def _size(given: Any, points: Any, volume: float) -> float:
    """Return the size that is given, or the usual one for points of this extent.

    Too many tets are refused before hours are spent on them.
    """
    size = given["size"]
    if size is None:
        size = float(np.linalg.norm(np.ptp(points, axis=0))) / _USUAL
    number = volume / (_REGULAR * size**3)
    if number > given["most"]:
        raise RefusedError("tets", f"edges of {size:g} are too short", number=number)
    return size


def _filled(gmsh: Any, volume: float, size: float) -> dict[str, Any]:
    """Fill the volumes of the model, and collect its tets and outer faces."""
    gmsh.option.setNumber("Mesh.MeshSizeMax", size)
    gmsh.option.setNumber("Mesh.MeshSizeMin", _FINEST * size)
    gmsh.option.setNumber("Mesh.MeshSizeFromCurvature", _PER_TURN)
    gmsh.model.mesh.generate(3)
    tags, coordinates, _ = gmsh.model.mesh.getNodes()
    nodes_of = lambda kind, tag: gmsh.model.mesh.getElementsByType(kind, tag)[1]
    by_solid = [nodes_of(_TET, tag).astype(int) for _, tag in gmsh.model.getEntities(3)]
    tets = np.concatenate(by_solid).reshape(-1, 4)
    if not len(tets):
        raise RefusedError("gmsh", "it made no tets.")
    outer = [
        tag
        for _, tag in gmsh.model.getEntities(2)
        if len(gmsh.model.getAdjacencies(2, tag)[0]) == 1
    ]
    triangles = [nodes_of(_TRIANGLE, tag).astype(int).reshape(-1, 3) for tag in outer]
    used, tets = np.unique(tets, return_inverse=True)
    places = np.empty((int(tags.max()) + 1, 3))
    places[tags.astype(int)] = coordinates.reshape(-1, 3)
    sizes = [len(nodes) // 4 for nodes in by_solid]
    return {
        "points": places[used],
        "tets": tets.reshape(-1, 4),
        "faces": [np.searchsorted(used, corners) for corners in triangles],
        "solids": np.split(np.arange(sum(sizes)), np.cumsum(sizes)[:-1]),
        "volume": volume,
    }


def _by_gmsh(fill: Any, given: Any) -> dict[str, Any]:
    """Fill with gmsh, silently; one thread makes the same mesh each time."""
    try:
        import gmsh  # pyright: ignore[reportMissingImports]
    except OSError as error:
        raise RefusedError("import", str(error)) from error
    _limit_memory(given["megabytes"])
    gmsh.initialize(readConfigFiles=False, interruptible=False)
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.option.setNumber("General.NumThreads", 1)
    try:
        return fill(gmsh, given)
    except (RefusedError, MemoryError):
        raise
    except Exception as error:  # gmsh raises this class itself
        said = " ".join(str(error).split()) or "it does not say why"
        raise RefusedError("gmsh", f"{said}.") from error


def _limit_memory(megabytes: float) -> None:
    """Let the process take no more memory from here on, where the system can do so."""
    if sys.platform != "linux" or megabytes == np.inf:
        return
    import resource

    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    most = int(1e6 * megabytes)
    most = most if hard == resource.RLIM_INFINITY else min(most, hard)
    resource.setrlimit(resource.RLIMIT_AS, (most, hard))


def main(given_at: str, made_at: str) -> None:
    """Fill what the first file holds; the second gets tets, or a reason."""
    given = pickle.loads(Path(given_at).read_bytes())
    try:
        if given["by"] == "pytetwild":
            made = fill_wild(given)
        else:
            fill = fill_step if given["by"] == "gmsh, STEP" else fill_surface
            made = _by_gmsh(fill, given)
    except RefusedError as error:
        made = error.made
    Path(made_at).write_bytes(pickle.dumps(made))


if __name__ == "__main__":
    main(*sys.argv[1:])
