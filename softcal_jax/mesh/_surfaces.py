"""Distribution of a surface over its nodes."""

import numpy as np

from softcal_jax._typing import Float, HostArray, Int
from softcal_jax.elements import shape_functions, shape_gradients, triangle_rule
from softcal_jax.mesh._tet_mesh import TetMesh


def surface_shares(
    mesh: TetMesh, faces: Int[HostArray, "n_faces n_fn"]
) -> Float[HostArray, " n_nodes"]:
    """Integrate every shape function over faces [m2]; the sum is their area.

    Args:
        mesh: The mesh, in its reference state.
        faces: 3 or 6 nodes of each face.
    """
    rule = triangle_rule(4)
    n_fn = faces.shape[1]
    N = shape_functions(rule.barycentric, n_fn)
    dN = shape_gradients(rule.barycentric, n_fn)
    tangents = np.einsum("fai,qaj->fqji", mesh.points[faces], dN)
    area = 0.5 * np.linalg.norm(np.cross(tangents[:, :, 0], tangents[:, :, 1]), axis=-1)
    out = np.zeros(mesh.n_nodes)
    np.add.at(out, faces, (area * rule.weights) @ N)
    return out
