"""Energy, force and stiffness of one tet, from its law and its shape gradients.

Two formulations of the volume change:

* "displacement": F at every quadrature point is used unchanged.
* "mean-dilatation": the volume ratio of every point is replaced by the tet's mean,
  F_bar = (J_bar / J)^(1/3) F with J_bar = <J> (Nagtegaal, Parks and Rice 1974; in the
  energy-consistent form of Simo, Taylor and Pister 1985). One volume constraint per
  tet in place of four, so nearly incompressible quadratic tets do not lock; a potential
  remains, so the stiffness stays symmetric. Fibres keep F, see `AbstractLaw.parts`.

On linear tets, with a single quadrature point, both are the same.
"""

from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp

from softcal_jax._typing import Array, Bool, Float, HostArray
from softcal_jax.elements import cofactor, determinant, matmul, sum_of
from softcal_jax.materials import AbstractLaw

AnyArray = Array | HostArray
Formulation = Literal["displacement", "mean-dilatation"]


class Tet(NamedTuple):
    """One tet at rest; its law has one value of each field.

    Attributes:
        dN: Shape gradients dN_a/dX at the quadrature points [1/m].
        w: Weights of these points, volume included [m3].
        active: Whether it deforms and counts, see `Model`: 1 or 0.
        mixed: Whether the volume ratio of every point is replaced by the tet's mean.
    """

    dN: Float[Array, "n_qp n_en 3"]
    w: Float[Array, " n_qp"]
    law: AbstractLaw
    active: Float[Array, ""]
    mixed: bool


def deformation_gradients(
    u: Float[Array, "n_en 3"], dN: Float[Array, "n_qp n_en 3"]
) -> Float[Array, "n_qp 3 3"]:
    """Compute F = I + sum_a u_a dN_a/dX at the quadrature points [-].

    Differences of displacements within the tet keep rounding small. From positions, it
    would grow with the ratio of mesh size to tet size, and the residual of a nearly
    incompressible mesh would stagnate.
    """
    both = zip(jnp.unstack(u[1:] - u[:1]), jnp.unstack(dN[:, 1:], axis=1), strict=True)
    H = sum_of(r[None, :, None] * g[:, None, :] for r, g in both)
    # The barrier stops XLA from recomputing F for each entry of the result.
    return jax.lax.optimization_barrier(jnp.eye(3)[None] + H)


def _scaled_to(theta: Float[Array, ""], F: Float[Array, "n_qp 3 3"]):
    """Return the volume ratios J, the factors (theta / J)^(1/3), and F^-T."""
    J = jax.vmap(determinant)(F)
    return J, jnp.cbrt(theta / J), jax.vmap(cofactor)(F) / J[:, None, None]


def _stresses_and_tangents(
    law: AbstractLaw, F: Float[Array, "n_qp 3 3"]
) -> tuple[Float[Array, "n_qp 3 3"], Float[Array, "n_qp 3 3 3 3"]]:
    # One point after the other: the tensors of a block of tets stay in the cache.
    return jax.lax.map(law.stress_and_tangent, F)


def mean_dilatation(u: Float[Array, "n_en 3"], tet: Tet) -> Float[Array, ""]:
    """Compute the volume of a tet relative to its volume at rest, J_bar [-]."""
    J = jax.vmap(determinant)(deformation_gradients(u, tet.dN))
    return jnp.sum(tet.w * J) / jnp.sum(tet.w)


def element_energy_and_force(
    u: Float[Array, "n_en 3"], tet: Tet
) -> tuple[Float[Array, ""], Float[Array, "n_en 3"]]:
    """Compute the strain energy [J] of a tet and its gradient with respect to u [N]."""
    _, psi, P = _energies_and_stresses(u, tet)
    return jnp.sum(tet.w * psi), _push(P, tet.dN)


class TetStates(NamedTuple):
    """Strain energy [J], mean Cauchy stress [Pa] and F at quadrature points of tets.

    Energy and stress are 0 if the tet does not deform.
    """

    energy: Float[AnyArray, "*n_tets"]
    cauchy: Float[AnyArray, "*n_tets 3 3"]
    F: Float[AnyArray, "*n_tets n_qp 3 3"]


def element_state(u: Float[Array, "n_en 3"], tet: Tet) -> TetStates:
    """Compute energy, stress and deformation of a tet.

    sigma = P F^T / J, so its integral over the deformed tet is that of P F^T at rest.
    """
    F, psi, P = _energies_and_stresses(u, tet)
    force = jnp.sum(jax.vmap(matmul)(P, jnp.swapaxes(F, 1, 2)), axis=0)
    volume = jnp.sum(tet.w * jax.vmap(determinant)(F))
    energy = jnp.sum(tet.w * psi)
    return TetStates(tet.active * energy, tet.active * force / volume, F)


class TetStresses(NamedTuple):
    """Stress and deformation of tets.

    Attributes:
        stress: First Piola-Kirchhoff stress P at the quadrature points [Pa].
        F: Mean deformation gradient [-].
        excess: J - J_bar at the points with "mean-dilatation", else None [-].
        pressure_slope: Derivative of the pressure by the displacement gradient at the
            points, times their shares of the volume, else None [Pa].
    """

    stress: Float[Array, "*n_tets n_qp 3 3"]
    F: Float[Array, "*n_tets 3 3"]
    excess: Float[Array, "*n_tets n_qp"] | None = None
    pressure_slope: Float[Array, "*n_tets n_qp 3 3"] | None = None


def element_stresses(u: Float[Array, "n_en 3"], tet: Tet) -> TetStresses:
    """Compute stress and deformation of a tet."""
    F, _, P = _energies_and_stresses(u, tet)
    P, share = P / _each(tet.w), tet.w / jnp.sum(tet.w)
    mean = jnp.sum(_each(share) * F, axis=0)
    if not tet.mixed:
        return TetStresses(P, mean)
    J, matrix = jax.vmap(determinant)(F), tet.law.parts()[0]

    def pressure(scale):
        scaled = scale * mean
        return jnp.sum(matrix.stress(scaled) * scaled) / (3.0 * determinant(scaled))

    _, per_stretch = jax.jvp(pressure, (jnp.ones(()),), (jnp.ones(()),))
    bulk = per_stretch / (3.0 * determinant(mean))  # J grows by three times the stretch
    slope = bulk * _each(share) * jax.vmap(cofactor)(F)
    return TetStresses(P, mean, J - jnp.sum(share * J), slope)


def _energies_and_stresses(
    u: Float[Array, "n_en 3"], tet: Tet
) -> tuple[Float[Array, "n_qp 3 3"], Float[Array, " n_qp"], Float[Array, "n_qp 3 3"]]:
    """Compute F, energy densities, and first Piola-Kirchhoff stresses times weights."""
    F, w = deformation_gradients(u, tet.dN), tet.w
    if tet.mixed:
        matrix, rest = tet.law.parts()
        theta = mean_dilatation(u, tet)
        J, s, G = _scaled_to(theta, F)
        share = w * J / (theta * jnp.sum(w))
        psi, P_bar = jax.vmap(matrix.energy_and_stress)(_each(s) * F)
        P_bar = _each(s) * P_bar
        mean_stress = jnp.sum(P_bar * F, axis=(1, 2)) / 3.0
        pressure = jnp.sum(w * mean_stress)
        P = _each(w) * P_bar + _each(pressure * share - w * mean_stress) * G
        if rest is not None:
            psi_rest, P_rest = jax.vmap(rest.energy_and_stress)(F)
            psi, P = psi + psi_rest, P + _each(w) * P_rest
    else:
        psi, P = jax.vmap(tet.law.energy_and_stress)(F)
        P = _each(w) * P
    return F, psi, P


def stiffness_of_law(
    u: Float[Array, "n_en 3"], du: Float[Array, "n_en 3"], tet: Tet
) -> Float[Array, "2"]:
    """Compute the stiffness of a tet's law along a motion `du` from `u`, and at rest.

    The first is dF : A : dF without the rotation in dF, by which structures buckle; the
    second the same at rest for the same rate of strain [J].
    """

    def gradients(u):
        F = deformation_gradients(u, tet.dN)
        if not tet.mixed:
            return F
        return _each(_scaled_to(mean_dilatation(u, tet), F)[1]) * F

    def stiffness(F, dF):
        _, A = _stresses_and_tangents(tet.law, F)
        return tet.active * jnp.einsum("q,qiJ,qiJkL,qkL", tet.w, dF, A, dF)

    F, dF = jax.jvp(gradients, (u,), (du,))
    left, _, right = jnp.linalg.svd(F)
    R = left @ right
    symmetric = lambda a: 0.5 * (a + jnp.swapaxes(a, 1, 2))
    straight = R @ symmetric(jnp.swapaxes(R, 1, 2) @ dF)
    rate = symmetric(dF @ jnp.linalg.inv(F))
    at_rest = jnp.broadcast_to(jnp.eye(3), F.shape)
    return jnp.stack([stiffness(F, straight), stiffness(at_rest, rate)])


def element_stiffness(
    u: Float[Array, "n_en 3"],
    tet: Tet,
    before: Float[Array, "n_en 3"] | None = None,
    stepped: Bool[Array, ""] | None = None,
) -> Float[Array, "n_en 3 n_en 3"]:
    """Compute the tangent stiffness of a tet, the Hessian of its energy [N/m].

    With `before`, the displacements at which the step to `u` began, the geometric
    stiffness uses the stress predicted by that step, see `_foreseen`; `stepped` then
    tells whether `before` differs from `u` anywhere in the mesh.
    """
    if tet.mixed:
        return mixed_newton(u, mean_dilatation(u, tet), tet)[0]
    F = deformation_gradients(u, tet.dN)
    P, A = _stresses_and_tangents(tet.law, F)
    if before is not None:
        began = deformation_gradients(before, tet.dN)
        gap = jax.lax.cond(
            stepped,
            lambda: _second(F, P) - _foreseen(tet.law, began, F),
            lambda: jnp.zeros_like(P),
        )
        A = A - jnp.eye(3)[None, :, None, :, None] * gap[:, None, :, None, :]
    return _pull(tet.w[:, None, None, None, None] * A, tet.dN)


def _second(
    F: Float[Array, "n_qp 3 3"], P: Float[Array, "n_qp 3 3"]
) -> Float[Array, "n_qp 3 3"]:
    """Compute the second Piola-Kirchhoff stress F^-1 P [Pa]."""
    J, G = jax.vmap(determinant)(F), jax.vmap(cofactor)(F)
    return jax.vmap(matmul)(jnp.swapaxes(G, 1, 2), P) / _each(J)


def _foreseen(
    law: AbstractLaw, before: Float[Array, "n_qp 3 3"], F: Float[Array, "n_qp 3 3"]
) -> Float[Array, "n_qp 3 3"]:
    """Predict the second Piola-Kirchhoff stress at the end of a step, linearly [Pa].

    A long step rotates a slender body only to first order, which stretches it. The
    stress of this spurious stretch spoils the tangent at the end of the step. A mixed
    Newton method with independent stresses at the quadrature points, condensed out,
    uses the linear prediction instead (Magisano, Leonetti and Garcea, Comput. Methods
    Appl. Mech. Eng. 313, 2017).
    """
    second = lambda F: _second(F, jax.vmap(law.stress)(F))
    stress, change = jax.jvp(second, (before,), (F - before,))
    return stress + change


def _each(a: Float[Array, " n_qp"]) -> Float[Array, "n_qp 1 1"]:
    return a[:, None, None]


def _push(
    P: Float[Array, "n_qp 3 3"], dN: Float[Array, "n_qp n_en 3"]
) -> Float[Array, "n_en 3"]:
    return sum_of(
        P[q, None, :, J] * dN[q, :, None, J]
        for q in range(P.shape[0])
        for J in range(3)
    )


def _pull(
    A: Float[Array, "n_qp 3 3 3 3"], dN: Float[Array, "n_qp n_en 3"]
) -> Float[Array, "n_en 3 n_en 3"]:
    """Contract both reference indices of weighted tangents with shape gradients.

    The barriers stop XLA from fusing a tensor into the contraction that follows, which
    would recompute it for every node.
    """
    A = jax.lax.optimization_barrier(A)
    half = jax.lax.optimization_barrier(jnp.einsum("qaJ,qiJkL->qaikL", dN, A))
    return jnp.einsum("qaikL,qbL->aibk", half, dN)


def mixed_newton(
    u: Float[Array, "n_en 3"], theta: Float[Array, ""], tet: Tet
) -> tuple[Float[Array, "n_en 3 n_en 3"], Float[Array, "n_en 3"]]:
    """Compute stiffness [N/m] and force [N] of a tet with an independent volume ratio.

    Three-field form of Simo, Taylor and Pister (Comput. Methods Appl. Mech. Eng. 51,
    1985): W(u, theta) = sum_q w_q psi((theta / J_q)^(1/3) F_q) with theta = J_bar(u)
    enforced by a pressure; theta and the pressure are condensed out of the Newton
    step. A large step is then judged by its linear volume change. With theta tied to u,
    a nearly incompressible body would resist every rotation that the step completes
    only to first order.

    At theta = J_bar(u) they are Hessian and gradient of the strain energy.
    """
    # With eta = d ln theta and G = F^-T, dF_bar = s (dF + (eta - G : dF) / 3 F). All
    # terms but A are pushed to the nodes first: adding products of 3x3 tensors to A
    # would take longer than A and its pull.
    dN, w = tet.dN, tet.w
    F = deformation_gradients(u, dN)
    J, s, G = _scaled_to(theta, F)
    share = w * J / (theta * jnp.sum(w))
    gap = jnp.sum(share) - 1.0  # J_bar / theta - 1
    matrix, rest = tet.law.parts()
    P_bar, A = _stresses_and_tangents(matrix, _each(s) * F)
    P_bar = _each(s) * P_bar
    Q = _each(s**2) * jnp.einsum("qiJkL,qkL->qiJ", A, F) + P_bar
    mean_stress = jnp.sum(P_bar * F, axis=(1, 2)) / 3.0
    both = jnp.sum(Q * F, axis=(1, 2)) / 9.0
    pressure = jnp.sum(w * mean_stress)
    curvature = jnp.sum(w * both) - pressure
    G, P_bar, Q = jax.lax.optimization_barrier((G, P_bar, Q))

    turn = _each(w * mean_stress - pressure * share) * G
    slope = _each(w / 3.0) * Q - _each(w * both) * G
    Y = _each(0.5 * (pressure * share - w * both)) * G - slope
    P, A = _each(w) * P_bar - turn, (w * s**2)[:, None, None, None, None] * A
    if rest is not None:
        P_rest, A_rest = _stresses_and_tangents(rest, F)
        P, A = P + _each(w) * P_rest, A + w[:, None, None, None, None] * A_rest
    y, G_a, turn_a = jnp.einsum("cqiJ,qaJ->cqai", jnp.stack([Y, G, turn]), dN)
    sums = jnp.stack([P, _each(share) * G, slope])
    force, g, h = jnp.einsum("cqiJ,qaJ->cai", sums, dN)
    left, right = [y, g[None]], [G_a, (h + 0.5 * curvature * g)[None]]
    rows, columns = map(jnp.concatenate, (left + right, right + left))
    K = _pull(A, dN) + jnp.einsum("cai,cbk->aibk", rows, columns)
    K = K + jnp.einsum("qak,qbi->aibk", turn_a, G_a)
    return K, force + (h + curvature * g) * gap
