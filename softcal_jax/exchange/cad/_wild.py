"""FTetWild, which fills surfaces that are not clean."""

import importlib.util
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from softcal_jax.exchange.cad._gmsh import Filled
from softcal_jax.exchange.cad._stl import Triangles

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


def fill_wild(triangles: Triangles, size: float) -> Filled:
    """Fill a surface with holes, crossings or repeated triangles, by pytetwild.

    FTetWild, Y. Hu et al., ACM Trans. Graph. 39 (2020).
    """
    if importlib.util.find_spec("pytetwild") is None:
        raise ImportError("No module named 'pytetwild'", name="pytetwild")
    # A process of its own: it leaves a file where it runs, and a crash would end ours.
    with tempfile.TemporaryDirectory() as folder:
        given, made = Path(folder, "given.npz"), Path(folder, "made.npz")
        np.savez(
            given,
            points=triangles.points,
            triangles=triangles.triangles,
            size=size,
            envelope=ENVELOPE,
        )
        done = subprocess.run(
            [sys.executable, "-c", _PROGRAM, str(given), str(made)],
            cwd=folder,
            capture_output=True,
            text=True,
        )
        if done.returncode != 0:
            last = (done.stderr.strip().splitlines() or ["it crashed"])[-1]
            raise ValueError(
                f"gmsh cannot fill this surface, and fTetWild fails: {last}."
            )
        with np.load(made) as found:
            points, tets = found["points"], found["tets"]
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
