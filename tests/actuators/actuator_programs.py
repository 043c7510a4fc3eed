"""Frames of rigid bodies, motions, and compiled programs of actuators."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from scipy.spatial.transform import Rotation

from softcal_jax.actuators import ActuatorArrays, actuator_arrays

TURN = Rotation.from_rotvec([0.4, -0.7, 1.1]).as_matrix()
AXIS_LENGTH = 0.3

# One program each, in place of one for each operation in them.
actuator_displacements = eqx.filter_jit(ActuatorArrays.displacements)
actuator_rows = eqx.filter_jit(ActuatorArrays.rows)
curvature_entries = eqx.filter_jit(ActuatorArrays.curvature)


def curvature_times(arrays, x, lambda_a, tangent):
    """The assembled d(H_a^T lambda_a)/dx times a direction, summed by NumPy."""
    out = np.zeros(x.shape)
    entries = curvature_entries(arrays, jnp.asarray(x), jnp.asarray(lambda_a))
    for nodes, K in zip(arrays.clique_nodes(), entries, strict=True):
        along = tangent[np.asarray(nodes)].reshape(len(nodes), -1)
        local = np.einsum("cpq,cq->cp", np.asarray(K), along)
        np.add.at(out, np.asarray(nodes), local.reshape(*nodes.shape, 3))
    return out


def with_frames(mesh, *frames):
    """Rest positions of the mesh's nodes and of frames (origin, axes in rows)."""
    nodes = [
        np.concatenate([origin[None], origin + AXIS_LENGTH * axes])
        for origin, axes in frames
    ]
    return np.concatenate([mesh.points, *nodes])


def arrays_of(mesh, *actuators):
    """Arrays of actuators on a mesh without rigid bodies."""
    return actuator_arrays(mesh, mesh.points, actuators, {})


def bent(points):
    """A smooth motion that is not affine."""
    x, y, z = points.T
    return points + 0.1 * np.stack([y * z + x**2, np.sin(x) - z, x * y - 0.5 * z], 1)


def area_vectors(points, faces):
    """Area times normal of flat faces."""
    a, b, c = (points[faces[:, i]] for i in range(3))
    return 0.5 * np.cross(b - a, c - a)
