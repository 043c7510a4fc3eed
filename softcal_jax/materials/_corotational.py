"""Laws that are linear in a strain seen in the rotated axes of each tet."""

from abc import abstractmethod
from typing import ClassVar, Literal, NamedTuple, get_args

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._text import check_known
from softcal_jax._typing import Array, Float, HostArray
from softcal_jax.elements import (
    axial,
    cofactor,
    determinant,
    matmul,
    rotation,
    skew,
    sum_of,
    symmetric,
)
from softcal_jax.materials._constants import as_components, as_matrix
from softcal_jax.materials._elasticity import AbstractElasticity, AbstractLinearLaw
from softcal_jax.materials._law import Matrix, Tensor, outer, turned
from softcal_jax.mesh import TetMesh

# hat(e_1), hat(e_2), hat(e_3): minus the permutation symbol.
_HAT = -np.cross(np.eye(3)[:, None], np.eye(3)[None])


class _Polar(NamedTuple):
    """F = R S, the stress sigma = C : (S - I), and M^-1 with M = tr(S) I - S."""

    R: Matrix
    S: Matrix
    sigma: Matrix
    M_inverse: Matrix


def _polar(elasticity: AbstractElasticity, F: Matrix) -> _Polar:
    R = rotation(F)
    S = symmetric(matmul(R.T, F))
    return _Polar(R, S, elasticity.stress(S - jnp.eye(3)), _spin_inverse(S))


def _spin_inverse(S: Matrix) -> Matrix:
    """Invert M = tr(S) I - S."""
    M = jnp.trace(S) * jnp.eye(3) - S
    return cofactor(M) / determinant(M)


def _times(M: Matrix, a: Float[Array, "3"]) -> Float[Array, "3"]:
    return sum_of(M[:, k] * a[k] for k in range(3))


def _left(A: Matrix, X: Float[Array, "n 3 3"]) -> Float[Array, "n 3 3"]:
    """Multiply A X_r."""
    return sum_of(A[None, :, k, None] * X[:, k, None, :] for k in range(3))


class Corotational(AbstractLinearLaw):
    """Linear law in the stretch of the polar decomposition F = R S.

    psi = 1/2 (S - I) : C : (S - I). With sigma = C : (S - I), the exact gradient is
    P = R (sigma - hat(c)), c = M^-1 axial(sigma S), M = tr(S) I - S; hat(c) vanishes
    for an isotropic C. The paper's element (Vanneste, Goury, Duriez, RA-L 2022,
    Sec. IV.A) in its energy-consistent form. Stress and tangent are closed forms. The
    tets of SOFA have another rotation, see `SofaCorotational`.
    """

    def strain(self, F: Matrix) -> Matrix:
        """Stretch less the identity, S - I [-]."""
        return symmetric(matmul(rotation(F).T, F)) - jnp.eye(3)

    def stress(self, F: Matrix) -> Matrix:
        """First Piola-Kirchhoff stress R (sigma - hat(c)) [Pa]."""
        return self.energy_and_stress(F)[1]

    def energy_and_stress(self, F: Matrix) -> tuple[Float[Array, ""], Matrix]:
        """Compute energy and stress from one polar decomposition."""
        R, S, sigma, M_inverse = _polar(self.elasticity, F)
        c = _times(M_inverse, axial(matmul(sigma, S)))
        energy = 0.5 * jnp.sum((S - jnp.eye(3)) * sigma)
        return energy, matmul(R, sigma - skew(c))

    def tangent(self, F: Matrix) -> Tensor:
        return self.stress_and_tangent(F)[1]

    def stress_and_tangent(self, F: Matrix) -> tuple[Matrix, Tensor]:
        """Compute stress and tangent from one polar decomposition.

        The tangent is R_im R_kn (C_mJnL - hat_rmJ Y_rnL - Y_rmJ hat_rnL). It splits
        R^T dP = hat(omega) (sigma - hat(c)) + dsigma - hat(dc), with
        omega = M^-1 axial(A) and dS = A - hat(omega) S for A = R^T dF, into C for a
        symmetric A and the contribution of a spin. With hat_r = hat(e_r),
        p = sigma - hat(c) and Q_r = sym(hat_r S):

            N = M^-1 (C : Q + sym(p^T hat))           dc = N : dS
            K = (tr(p) I / 2 - p / 2 + N : Q) M^-1    hat_r : R^T dP / 4 for A = hat_s
            Y = N - K hat / 2
        """
        # The barriers keep XLA from computing a factor again for each of 81 entries.
        polar = jax.lax.optimization_barrier(_polar(self.elasticity, F))
        R, S, sigma, M_inverse = polar
        p = sigma - skew(_times(M_inverse, axial(matmul(sigma, S))))
        hat = jnp.asarray(_HAT)
        right = sum_of(hat[:, :, k, None] * S[None, k, None, :] for k in range(3))
        p, Q = jax.lax.optimization_barrier((p, jax.vmap(symmetric)(right)))
        moment = jax.vmap(self.elasticity.stress)(Q)
        moment += jax.vmap(symmetric)(_left(p.T, hat))
        N = sum_of(M_inverse[:, s, None, None] * moment[None, s] for s in range(3))
        N = jax.lax.optimization_barrier(N)
        N_Q = sum_of(N[:, None, i, j] * Q[None, :, i, j] for i, j in np.ndindex(3, 3))
        K = matmul(0.5 * (jnp.trace(p) * jnp.eye(3) - p) + N_Q, M_inverse)
        K = jax.lax.optimization_barrier(K)
        Y = N - 0.5 * sum_of(K[:, s, None, None] * hat[None, s] for s in range(3))
        tangent = turned(_less_spins(self.elasticity.tensor(), Y), R)
        return matmul(R, p), tangent


def _less_spins(C: Tensor, Y: Float[Array, "3 3 3"]) -> Tensor:
    """Compute C_mJnL - hat_rmJ Y_rnL - Y_rmJ hat_rnL; hat_r has two entries only."""
    zero = jnp.zeros((3, 3))
    spins = [
        zero if m == J else _HAT[3 - m - J, m, J] * Y[3 - m - J]
        for m, J in np.ndindex(3, 3)
    ]
    spin = jnp.stack(spins).reshape(3, 3, 3, 3)
    return C - spin - spin.transpose(2, 3, 0, 1)


class AbstractTurnedStress(AbstractLinearLaw):
    """A law P = R sigma, with sigma = C : (sym(R^T F) - I) and R = polar(F L).

    It has no potential, and its tangent no symmetry. L is symmetric, positive definite
    and constant.
    """

    conservative: ClassVar[bool] = False

    @abstractmethod
    def _turn(self, F: Matrix) -> tuple[Matrix, Matrix]:
        """Compute R [-] and L, of any size."""

    def strain(self, F: Matrix) -> Matrix:
        """Symmetric part of R^T F, less the identity [-]."""
        return symmetric(matmul(self._turn(F)[0].T, F)) - jnp.eye(3)

    def stress(self, F: Matrix) -> Matrix:
        """First Piola-Kirchhoff stress R sigma [Pa]."""
        R, _ = self._turn(F)
        strain = symmetric(matmul(R.T, F)) - jnp.eye(3)
        return matmul(R, self.elasticity.stress(strain))

    def tangent(self, F: Matrix) -> Tensor:
        """Derivative of this stress [Pa].

        With U = R^T F, A = R^T dF, S = U L and M = tr(S) I - S, R^T dR is hat(omega)
        for omega = M^-1 axial(A L), and

            R^T dP = hat(omega) sigma + C : (A - hat(omega) U).
        """
        # The barriers keep XLA from computing a factor again for each of 81 entries.
        R, L = jax.lax.optimization_barrier(self._turn(F))
        U = matmul(R.T, F)
        S = symmetric(matmul(U, L))
        sigma = self.elasticity.stress(symmetric(U) - jnp.eye(3))
        M_inverse = _spin_inverse(S)

        def of_spin(e):
            """Return dP for R^T dR = hat(e), and dF for which axial(A L) grows by e."""
            hat = skew(e)
            dsigma = self.elasticity.stress(-symmetric(matmul(hat, U)))
            return matmul(R, matmul(hat, sigma) + dsigma), matmul(R, matmul(hat, L))

        dP, moment = jax.lax.optimization_barrier(jax.vmap(of_spin)(jnp.eye(3)))
        omega = sum_of(M_inverse[:, t, None, None] * moment[None, t] for t in range(3))
        omega = jax.lax.optimization_barrier(omega)
        spin = sum_of(outer(dP[r], omega[r]) for r in range(3))
        return turned(self.elasticity.tensor(), R) + spin


class ClassicalCorotational(AbstractTurnedStress):
    """The corotational force of the classical codes, P = R sigma, for parity only.

    It drops the term hat(c) of `Corotational`. For an isotropic C nothing changes. For
    an anisotropic C the force has no potential, the moments do not balance (P F^T is
    not symmetric) and the tangent has no major symmetry; a solver that relies on any of
    these cannot be used, and `energy_density` is not the potential of P. Take it to
    compare with such codes, otherwise `Corotational`; for SOFA take `SofaCorotational`.
    """

    def _turn(self, F: Matrix) -> tuple[Matrix, Matrix]:
        return rotation(F), jnp.eye(3)


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
    check_known("rotation", get_args(SofaRotation), rotation)
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
