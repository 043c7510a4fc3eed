"""Tet meshes: made, read, checked, selected from, and searched for points.

Everything here runs on the host in NumPy, once, before the physics. Lengths are in
metres.
"""

from softcal_jax.mesh._generators import (
    Grid as Grid,
    beam as beam,
    fill as fill,
    oriented as oriented,
)
from softcal_jax.mesh._location import (
    MaterialPoints as MaterialPoints,
    locate as locate,
)
from softcal_jax.mesh._motion import (
    straightened as straightened,
    surface_motion as surface_motion,
)
from softcal_jax.mesh._reading import (
    MeshWarning as MeshWarning,
    mesh_files as mesh_files,
    read_mesh as read_mesh,
    read_tet_data as read_tet_data,
    write_mesh as write_mesh,
)
from softcal_jax.mesh._recovery import Recovery as Recovery, recovery as recovery
from softcal_jax.mesh._selection import (
    REGIONS as REGIONS,
    Annulus as Annulus,
    Box as Box,
    Cylinder as Cylinder,
    Plane as Plane,
    Sphere as Sphere,
    box_faces as box_faces,
    node_indices as node_indices,
    place as place,
    select_faces as select_faces,
    select_nodes as select_nodes,
)
from softcal_jax.mesh._self_contact import (
    SelfContact as SelfContact,
    self_contact as self_contact,
)
from softcal_jax.mesh._surfaces import (
    CAD_FACE as CAD_FACE,
    SHARP as SHARP,
    distances_along as distances_along,
    find_cavities as find_cavities,
    matching_faces as matching_faces,
    ring_around as ring_around,
    seen_from as seen_from,
    select_cavity as select_cavity,
    select_face as select_face,
    select_reachable as select_reachable,
    surface_parts as surface_parts,
)
from softcal_jax.mesh._tet_mesh import (
    TetMesh as TetMesh,
    check_order as check_order,
    to_linear as to_linear,
    to_quadratic as to_quadratic,
)
from softcal_jax.mesh._topology import (
    PARTS as PARTS,
    Tessellation as Tessellation,
    boundary_faces as boundary_faces,
    boundary_tets as boundary_tets,
    check_mesh as check_mesh,
    connected_parts as connected_parts,
    face_areas as face_areas,
    face_indices as face_indices,
    face_products as face_products,
    face_shares as face_shares,
    sides_of as sides_of,
    surface_shares as surface_shares,
    tessellate as tessellate,
    tet_faces as tet_faces,
    thin_share as thin_share,
    volumes as volumes,
)
