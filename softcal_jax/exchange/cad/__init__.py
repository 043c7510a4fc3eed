"""CAD models, filled with tets: STEP by gmsh, STL by gmsh or fTetWild."""

from softcal_jax.exchange.cad._gmsh import read_stl
from softcal_jax.exchange.cad._mesh import CAD_FORMATS, mesh_cad

__all__ = ["CAD_FORMATS", "mesh_cad", "read_stl"]
