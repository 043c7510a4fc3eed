"""CAD models, filled with tets: STEP by gmsh, STL by gmsh or fTetWild."""

from softcal_jax.exchange.cad._mesh import (
    CAD_FORMATS as CAD_FORMATS,
    mesh_cad as mesh_cad,
)
from softcal_jax.exchange.cad._surface import read_stl as read_stl
