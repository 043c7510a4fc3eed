"""Tet meshes: made, read, checked, selected from, and searched for points.

Everything here runs on the host in NumPy, once, before the physics. Lengths are in
metres.
"""

from softcal_jax.mesh._checks import check_mesh
from softcal_jax.mesh._conversion import check_order, merge, to_linear, to_quadratic
from softcal_jax.mesh._generators import beam, oriented
from softcal_jax.mesh._location import MaterialPoints, locate
from softcal_jax.mesh._meshio import MeshWarning, ParserError, parse_mesh_file
from softcal_jax.mesh._reading import mesh_files, read_mesh, read_tet_data
from softcal_jax.mesh._refinement import Refinement, finer, refine
from softcal_jax.mesh._selection import (
    Annulus,
    Box,
    Cylinder,
    Plane,
    Sphere,
    node_indices,
    select_faces,
    select_nodes,
)
from softcal_jax.mesh._surfaces import (
    CAD_FACE,
    SHARP,
    matching_faces,
    select_cavity,
    select_face,
    select_reachable,
    surface_parts,
)
from softcal_jax.mesh._tessellation import PARTS, Tessellation, tessellate
from softcal_jax.mesh._tet_mesh import TetMesh
from softcal_jax.mesh._topology import (
    boundary_faces,
    boundary_tets,
    face_indices,
    face_shares,
    surface_shares,
    tet_faces,
    volumes,
)
from softcal_jax.mesh._tripod import tripod
from softcal_jax.mesh._voxels import Filling, Grid, fill
from softcal_jax.mesh._writing import write_mesh

__all__ = [
    "CAD_FACE",
    "PARTS",
    "SHARP",
    "Annulus",
    "Box",
    "Cylinder",
    "Filling",
    "Grid",
    "MaterialPoints",
    "MeshWarning",
    "ParserError",
    "Plane",
    "Refinement",
    "Sphere",
    "Tessellation",
    "TetMesh",
    "beam",
    "boundary_faces",
    "boundary_tets",
    "check_mesh",
    "check_order",
    "face_indices",
    "face_shares",
    "fill",
    "finer",
    "locate",
    "matching_faces",
    "merge",
    "mesh_files",
    "node_indices",
    "oriented",
    "parse_mesh_file",
    "read_mesh",
    "read_tet_data",
    "refine",
    "select_cavity",
    "select_face",
    "select_faces",
    "select_nodes",
    "select_reachable",
    "surface_parts",
    "surface_shares",
    "tessellate",
    "tet_faces",
    "to_linear",
    "to_quadratic",
    "tripod",
    "volumes",
    "write_mesh",
]
