"""FTetWild, which fills surfaces that are not clean."""

import numpy as np

from softcal_jax.mesh._gmsh import Filled
from softcal_jax.mesh._stl import Triangles

ENVELOPE = 1e-3
"""How far the surface may move, over the diagonal of the model [-]."""


def fill_wild(triangles: Triangles, size: float) -> Filled:
    """Fill a surface with holes, crossings or repeated triangles.

    FTetWild, Y. Hu et al., ACM Trans. Graph. 39 (2020).

    Raises:
        ImportError: If pytetwild is not installed.
        ValueError: If it makes no tets.
    """
    import pytetwild  # pyright: ignore[reportMissingImports]

    points, tets = pytetwild.tetrahedralize(  # pyright: ignore[reportPrivateImportUsage]
        triangles.points,
        triangles.triangles,
        edge_length_abs=size,
        epsilon=ENVELOPE,
        num_threads=1,
        quiet=True,
    )
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
