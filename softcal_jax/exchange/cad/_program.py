"""Fills a CAD model with tets, in a process of its own: `main`, run by `_apart`.

Damaged models crash gmsh, or it meshes them for ever. What is given and made are
dictionaries; see `exchange.cad._mesh`.
"""

from math import sqrt
from typing import Any

import numpy as np

_TRIANGLE, _TET = 2, 4  # gmsh's numbers of the types of linear elements

_PER_TURN = 12
"""Edges around a full turn of a curved face: chords 3 % of its radius inside it."""

_FINEST = 0.25
"""Shortest edges at curved faces, over the size: small fillets are not followed."""

_USUAL = 30.0  # diagonal of a model over the size, where none is given

_FAR = 1e9  # longest diagonal of a model, in its unit

_REGULAR = 1.0 / (6.0 * sqrt(2.0))
"""Volume of the regular tet over the cube of its edge [-]."""

_ENVELOPE = 1e-3
"""How far fTetWild may move the surface, over the diagonal of the model [-]."""

_FLAT = 1e-6
"""Volume below which a tet is flat, over the regular tet, as for `check_mesh` [-]."""

_SLIVER = 1e-4  # the same below which it is mended, for such tets invert easily
_NARROW = 1e-3  # edges of it that shrink to a node, over the size
_SHARES = (1.0, 0.8, 0.64)  # of the size, tried until no tet is flat


def fill_step(gmsh: Any, given: Any) -> dict[str, Any]:
    """Fill the solids of a STEP file; the size and the result are in mm."""
    gmsh.option.setString("Geometry.OCCTargetUnit", "MM")
    shape = gmsh.model.occ
    shape.importShapes(given["path"])
    shape.synchronize()
    solids = gmsh.model.getEntities(3)
    if not solids:
        raise ValueError(
            "it has no solid, only surfaces or curves, and what lies inside them is not"
            " known. Export the body as a solid.",
        )
    if len(solids) > 1:  # so that they share faces where they touch
        shape.fragment(solids, [])
        shape.synchronize()
    area, volume = (
        sum(shape.getMass(*entity) for entity in gmsh.model.getEntities(dimension))
        for dimension in (2, 3)
    )
    given |= {"area": area, "volume": volume}
    low_high = np.reshape(gmsh.model.getBoundingBox(-1, -1), (2, 3))
    size, made = _size(given, low_high), {}
    for share in _SHARES:
        gmsh.model.mesh.clear()
        made = _filled(gmsh, volume, share * size)
        if not made["n_flat"]:
            break
    return made


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
    size = _size(given, points)
    # Gmsh cuts round surfaces in patches, which are no faces of the body.
    return {**_filled(gmsh, given["volume"], size), "faces": (), "solids": ()}


def fill_wild(given: Any) -> dict[str, Any]:
    """Fill a surface with holes, crossings or repeated triangles, by pytetwild.

    FTetWild, Y. Hu et al., ACM Trans. Graph. 39 (2020).
    """
    from pytetwild import tetrahedralize  # pyright: ignore[reportPrivateImportUsage]

    points, tets = tetrahedralize(
        given["points"],
        given["triangles"],
        edge_length_abs=_size(given, given["points"]),
        epsilon=_ENVELOPE,
        num_threads=1,
        quiet=True,
    )
    if not len(tets):
        raise RuntimeError("it makes no tets")
    used, tets = np.unique(tets, return_inverse=True)
    return {"points": np.asarray(points, float)[used], "tets": tets.reshape(-1, 4)}


def _size(given: Any, points: Any) -> float:
    """Return the size that is given, or the usual one for points of this extent.

    Too many tets are refused before hours are spent on them: regular ones would fill
    the volume, and a thin wall has three for two triangles of its surface.
    """
    size, across = given["size"], float(np.linalg.norm(np.ptp(points, axis=0)))
    if size is None:
        size = across / _USUAL
    thin = 1.5 * given["area"] / (0.25 * sqrt(3.0) * size**2)
    number = np.ceil(max(given["volume"] / (_REGULAR * size**3), thin))
    if number > given["most"]:
        what = f"edges of {size:g} are too short for a model {across:.3g} across"
        raise OverflowError(what, number)
    if across > _FAR:
        raise ValueError(f"it is {across:.3g} across: check its unit.")
    return size


def _filled(gmsh: Any, volume: float, size: float) -> dict[str, Any]:
    """Fill the volumes of the model, and collect its tets and outer faces."""
    gmsh.option.setNumber("Mesh.MeshSizeMax", size)
    gmsh.option.setNumber("Mesh.MeshSizeMin", _FINEST * size)
    gmsh.option.setNumber("Mesh.MeshSizeFromCurvature", _PER_TURN)
    gmsh.model.mesh.generate(3)
    tags, coordinates, _ = gmsh.model.mesh.getNodes()
    nodes_of = lambda kind, tag: gmsh.model.mesh.getElementsByType(kind, tag)[1]
    volumes = [tag for _, tag in gmsh.model.getEntities(3)]
    by_solid = [nodes_of(_TET, tag).astype(int).reshape(-1, 4) for tag in volumes]
    if not sum(map(len, by_solid)):
        raise RuntimeError("it makes no tets")
    outer = [
        tag
        for _, tag in gmsh.model.getEntities(2)
        if len(gmsh.model.getAdjacencies(2, tag)[0]) == 1
    ]
    triangles = [nodes_of(_TRIANGLE, tag).astype(int).reshape(-1, 3) for tag in outer]
    places = np.zeros((int(tags.max()) + 1, 3))
    places[tags.astype(int)] = coordinates.reshape(-1, 3)
    n, cells = len(by_solid), _mended(places, [*by_solid, *triangles], _NARROW * size)
    used, tets = np.unique(np.concatenate(cells[:n]), return_inverse=True)
    points, tets = places[used], tets.reshape(-1, 4)
    ends = np.cumsum([len(solid) for solid in cells[:n]])
    return {
        "points": points,
        "tets": tets,
        "faces": [np.searchsorted(used, corners) for corners in cells[n:]],
        "solids": np.split(np.arange(len(tets)), ends[:-1]),
        "volume": volume,
        "n_flat": int(np.sum(_shapes(points[tets]) < _FLAT)),
    }


def _shapes(corners: Any) -> Any:
    """Divide volumes of tets by those of regular tets of the same rms edges [-]."""
    edges = corners[:, [0, 0, 0, 1, 1, 2]] - corners[:, [1, 2, 3, 2, 3, 3]]
    rms = np.sqrt((edges**2).sum(axis=-1).mean(axis=-1))
    volume = np.linalg.det(corners[:, 1:] - corners[:, :1]) / 6.0
    return volume / (_REGULAR * np.maximum(rms, np.finfo(float).tiny) ** 3)


def _mended(places: Any, cells: list[Any], narrow: float) -> list[Any]:
    """Make one node of the ends of short edges of slivers.

    Cells, of tets and of triangles, that had both ends vanish.
    """
    tets = np.concatenate([cell for cell in cells if cell.shape[1] == 4])
    slivers = tets[_shapes(places[tets]) < _SLIVER]
    ends = slivers[:, [[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]]].reshape(-1, 2)
    short = np.linalg.norm(np.diff(places[ends], axis=1), axis=(1, 2)) < narrow
    kept = np.arange(len(places))
    for a, b in ends[short]:
        kept[kept == kept[b]] = kept[a]
    ordered = [np.sort(kept[cell], axis=1) for cell in cells]
    whole = [(cell[:, 1:] != cell[:, :-1]).all(axis=1) for cell in ordered]
    return [kept[cell[rows]] for cell, rows in zip(cells, whole, strict=True)]


def main(given: Any) -> dict[str, Any]:
    """Fill what is given; one thread makes the same mesh each time."""
    if given["by"] == "pytetwild":
        return fill_wild(given)
    try:
        import gmsh  # pyright: ignore[reportMissingImports]
    except OSError as error:
        raise ImportError(
            f"gmsh is installed, but cannot be loaded ({error}). On Debian or Ubuntu: "
            "sudo apt install libgl1 libglu1-mesa libxcursor1 libxft2 libxinerama1"
        ) from error
    gmsh.initialize(readConfigFiles=False, interruptible=False)
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.option.setNumber("General.NumThreads", 1)
    return (fill_step if "path" in given else fill_surface)(gmsh, given)
