"""Where a body is held, and which way it goes on behind."""

import jax
import numpy as np

from softcal_jax._typing import Bool, Float, HostArray
from softcal_jax.configurations import ConfigurationArrays
from softcal_jax.elements import TET_EDGES
from softcal_jax.equilibrium import Model
from softcal_jax.fields import Poses, grounded_bodies
from softcal_jax.mesh import TetMesh, boundary_faces


def held_nodes(
    model: Model, configurations: ConfigurationArrays
) -> Bool[HostArray, "n_c n_nodes"]:
    """Flag the nodes that cannot move, or only with a grounded body.

    Args:
        model: The model.
        configurations: One lane per configuration.
    """
    bodies, n_nodes = model.mechanism.bodies, model.mesh.n_nodes
    held = np.array(np.asarray(configurations.fixed)[:, :n_nodes].all(axis=2))
    poses = Poses(model, jax.tree.map(np.asarray, configurations), ())
    held[:, bodies.attached] |= grounded_bodies(poses)[:, bodies.body]
    return held


def outward_motion(
    mesh: TetMesh, held: Bool[HostArray, " n_nodes"]
) -> Float[HostArray, "n_nodes 3"]:
    """Compute unit normals of the faces at which the deforming part is held [-].

    They point out of it, into the clamp. Nodes in the middle of an edge get the mean of
    its ends, so that edges stay straight; all others get zero.

    Args:
        mesh: The mesh.
        held: The held nodes.
    """
    motion = np.zeros((mesh.n_nodes, 3))
    deforming = ~held[mesh.tets].all(axis=1)
    if not np.any(held) or not np.any(deforming):
        return motion
    part = TetMesh(mesh.points, mesh.tets[deforming])
    faces = boundary_faces(part)
    corners = faces[held[faces].all(axis=1)][:, :3]
    a, b, c = np.moveaxis(mesh.points[corners], 1, 0)
    np.add.at(motion, corners, np.cross(b - a, c - a)[:, None])
    size = np.linalg.norm(motion, axis=1, keepdims=True)
    motion = np.divide(motion, size, out=motion, where=size > 0.0)
    if mesh.order == 2:
        ends = mesh.tets[:, np.array(TET_EDGES)]
        motion[mesh.tets[:, 4:]] = motion[ends].mean(axis=2)
    return motion
