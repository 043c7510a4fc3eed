"""The corotational law with the rotations of SOFA's linear tets."""

from typing import Literal, get_args

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._names import unknown_name
from softcal_jax._typing import Array, Float, HostArray
from softcal_jax.elements import matmul, rotation
from softcal_jax.materials._constants import as_components, as_matrix
from softcal_jax.materials._corotational import AbstractTurnedStress
from softcal_jax.materials._elasticity import AbstractElasticity
from softcal_jax.materials._law import Matrix, Tensor
from softcal_jax.mesh import TetMesh

SofaRotation = Literal["edge", "procrustes", "large"]
"""How SOFA takes the rotation of a tet, see `SofaCorotational`."""


class SofaCorotational(AbstractTurnedStress):
    """The corotational law of SOFA's linear tets: P = R sigma, but not R = polar(F).

    SOFA takes the rotation R from a matrix B of each tet at rest and now, F B, and
    turns the stress sigma = C : (sym(R^T F) - I) back by it:

    * "edge": R = polar(F B) polar(B)^T, the columns of B being the edges from the first
      node to the others: `TetrahedronFEMForceField` with the method "polar".
    * "procrustes": the same with B = sum_a (X_a - c)(X_a - c)^T over the four nodes, c
      their mean: the best rotation in the sense of least squares. It is that of
      `CorotationalFEMForceField`, which SOFA has had since v26.06.
    * "large": R = Q(F B) Q(B)^T, Q being the factor of the QR decomposition of the
      edges: `TetrahedronFEMForceField` with its default method "large", and the
      `TetrahedronAnisotropicForceField` of the plugin Anisotropy.

    "edge" depends on which node is first, "large" on the order of the first three. With
    the left polar decomposition B = L polar(B), R = polar(F L), so L is kept for the
    first two, and Q(B) for the last. On tets that are not regular R differs from
    polar(F) in the first order of the strain, even for an isotropic C; where L = I it
    is `ClassicalCorotational`. Take this law for a model that SOFA will run,
    `Corotational` otherwise. Read from the sources of SOFA v25.12.00 and v26.06.00.

    Attributes:
        rest: L or Q(B), a matrix per tet kept as nine fields [-]; see `of_mesh`.
        rotation: How R is taken.
    """

    rest: tuple[Float[Array, "..."], ...] = eqx.field(converter=as_components)
    rotation: SofaRotation = eqx.field(static=True)

    @classmethod
    def of_mesh(
        cls, mesh: TetMesh, elasticity: AbstractElasticity, rotation: SofaRotation
    ) -> "SofaCorotational":
        """Make the law for the tets of a mesh, in the order of their nodes.

        Raises:
            ValueError: If the mesh is not linear, or the rotation is unknown.
        """
        return cls(elasticity, _rest_matrices(mesh, rotation), rotation)

    def _turn(self, F: Matrix) -> tuple[Matrix, Matrix]:
        B = as_matrix(self.rest)
        if self.rotation == "large":
            return matmul(_orthogonal(matmul(F, B)), B.T), B
        return rotation(matmul(F, B)), B

    def tangent(self, F: Matrix) -> Tensor:
        """Derivative of the stress [Pa]; a closed form for the polar rotations."""
        if self.rotation == "large":
            return jax.jacfwd(self.stress)(F)
        return super().tangent(F)


def _orthogonal(edges: Float[Array, "3 3"]) -> Float[Array, "3 3"]:
    """Compute the factor Q of the QR decomposition of three columns."""
    unit = lambda v: v / jnp.sqrt(jnp.sum(v * v))
    x = unit(edges[:, 0])
    z = unit(jnp.cross(x, edges[:, 1]))
    return jnp.stack([x, jnp.cross(z, x), z], axis=1)


def _rest_matrices(
    mesh: TetMesh, rotation: SofaRotation
) -> Float[HostArray, "n_tets 3 3"]:
    """Compute L, scaled to a trace of 3, or Q(B) of each tet [-]."""
    if rotation not in get_args(SofaRotation):
        raise unknown_name("rotation", rotation, get_args(SofaRotation))
    if mesh.order != 1:
        raise ValueError(
            "the rotations of SOFA are those of linear tets, and the mesh is "
            "quadratic; take softcal_jax.mesh.to_linear(mesh)."
        )
    corners = mesh.points[mesh.tets]
    edges = np.swapaxes(corners[:, 1:] - corners[:, :1], 1, 2)
    if rotation == "large":
        Q, upper = np.linalg.qr(edges)
        return Q * np.sign(np.einsum("eii->ei", upper))[:, None, :]
    if rotation == "procrustes":
        away = corners - corners.mean(axis=1, keepdims=True)
        L = np.einsum("eai,eaj->eij", away, away)
    else:
        W, size, _ = np.linalg.svd(edges)
        L = np.einsum("eik,ek,ejk->eij", W, size, W)
    return 3.0 * L / np.trace(L, axis1=1, axis2=2)[:, None, None]
