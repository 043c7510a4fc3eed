"""Energy, force and stiffness of one tet, from its law and its shape gradients.

Two formulations of the volume change:

* "displacement": F at every quadrature point as it is.
* "mean-dilatation": the volume ratio of every point is replaced by the tet's mean,
  F_bar = (J_bar / J)^(1/3) F with J_bar = <J> (Nagtegaal, Parks and Rice 1974; in the
  energy-consistent form of Simo, Taylor and Pister 1985). One volume constraint per
  tet in place of four, so nearly incompressible quadratic tets do not lock; a potential
  exists for every law, so force and stiffness stay symmetric.

On linear tets, with their single point, both are the same.
"""

from typing import Literal

import jax
import jax.numpy as jnp

from softcal_jax._typing import Array, Float
from softcal_jax.elements import cofactor, determinant
from softcal_jax.materials import AbstractLaw

Formulation = Literal["displacement", "mean-dilatation"]


def deformation_gradients(
    u: Float[Array, "n_en 3"], dN: Float[Array, "n_qp n_en 3"]
) -> Float[Array, "n_qp 3 3"]:
    """Deformation gradient F = I + sum_a u_a dN_a/dX at the quadrature points [-].

    From differences of displacements inside the tet: from positions, the rounding of
    F would be that of the size of the body over that of the tet, and the residual of a
    nearly incompressible body would not come down.
    """
    relative = u[1:] - u[:1]
    H = jnp.sum(relative[None, :, :, None] * dN[:, 1:, None, :], axis=1)
    return jnp.eye(3) + H


def _scaled_to(
    theta: Float[Array, ""], F: Float[Array, "n_qp 3 3"]
) -> tuple[Float[Array, " n_qp"], Float[Array, " n_qp"]]:
    """Volume ratios J, and the factors (theta / J)^(1/3) that make them all theta."""
    J = jax.vmap(determinant)(F)
    return J, jnp.cbrt(theta / J)


def mean_dilatation(
    u: Float[Array, "n_en 3"],
    dN: Float[Array, "n_qp n_en 3"],
    w: Float[Array, " n_qp"],
) -> Float[Array, ""]:
    """Volume of a tet over its volume at rest, J_bar [-]."""
    J = jax.vmap(determinant)(deformation_gradients(u, dN))
    return jnp.sum(w * J) / jnp.sum(w)


def is_mixed(formulation: Formulation, n_qp: int) -> bool:
    """Whether the mean volume ratio enters; with one point it is the only one."""
    return formulation == "mean-dilatation" and n_qp > 1


def element_energy(
    u: Float[Array, "n_en 3"],
    dN: Float[Array, "n_qp n_en 3"],
    w: Float[Array, " n_qp"],
    law: AbstractLaw,
    formulation: Formulation,
) -> Float[Array, ""]:
    """Strain energy of a tet, sum_q w_q psi(F_q) [J]."""
    F = deformation_gradients(u, dN)
    if is_mixed(formulation, F.shape[0]):
        F = _scaled_to(mean_dilatation(u, dN, w), F)[1][:, None, None] * F
    return sum(w[q] * law.energy_density(F[q]) for q in range(F.shape[0]))


def element_force(
    u: Float[Array, "n_en 3"],
    dN: Float[Array, "n_qp n_en 3"],
    w: Float[Array, " n_qp"],
    law: AbstractLaw,
    formulation: Formulation,
) -> Float[Array, "n_en 3"]:
    """Internal force of a tet, the gradient of its energy in u [N]."""
    F = deformation_gradients(u, dN)
    n_qp = F.shape[0]
    if is_mixed(formulation, n_qp):
        theta = mean_dilatation(u, dN, w)
        J, s = _scaled_to(theta, F)
        share = w * J / (theta * jnp.sum(w))
        G = [cofactor(F[q]) / J[q] for q in range(n_qp)]
        P_bar = [s[q] * law.stress(s[q] * F[q]) for q in range(n_qp)]
        trace = [jnp.sum(P_bar[q] * F[q]) / 3.0 for q in range(n_qp)]
        pressure = sum(w[q] * trace[q] for q in range(n_qp))
        P = [
            w[q] * (P_bar[q] - trace[q] * G[q]) + pressure * share[q] * G[q]
            for q in range(n_qp)
        ]
    else:
        P = [w[q] * law.stress(F[q]) for q in range(n_qp)]
    return sum(_push(P[q], dN[q]) for q in range(n_qp))


def element_stiffness(
    u: Float[Array, "n_en 3"],
    dN: Float[Array, "n_qp n_en 3"],
    w: Float[Array, " n_qp"],
    law: AbstractLaw,
    formulation: Formulation,
) -> Float[Array, "n_en 3 n_en 3"]:
    """Tangent stiffness of a tet, the Hessian of its energy in u [N/m]."""
    F = deformation_gradients(u, dN)
    if is_mixed(formulation, F.shape[0]):
        return mixed_newton(u, mean_dilatation(u, dN, w), dN, w, law)[0]
    return sum(_pull(w[q] * law.tangent(F[q]), dN[q]) for q in range(F.shape[0]))


def _push(
    P: Float[Array, "3 3"], dN: Float[Array, "n_en 3"]
) -> Float[Array, "n_en 3"]:
    """Nodal forces of a stress."""
    return jnp.sum(P[None] * dN[:, None, :], axis=2)


def _pull(
    A: Float[Array, "3 3 3 3"], dN: Float[Array, "n_en 3"]
) -> Float[Array, "n_en 3 n_en 3"]:
    """Contract both reference slots of a tangent with the shape gradients."""
    half = jnp.sum(A[None] * dN[:, None, :, None, None], axis=2)
    return jnp.sum(half[:, :, None] * dN[None, None, :, None, :], axis=4)


def _outer(a, b):
    return a[:, :, None, None] * b[None, None]


def mixed_newton(
    u: Float[Array, "n_en 3"],
    theta: Float[Array, ""],
    dN: Float[Array, "n_qp n_en 3"],
    w: Float[Array, " n_qp"],
    law: AbstractLaw,
) -> tuple[Float[Array, "n_en 3 n_en 3"], Float[Array, "n_en 3"]]:
    """Newton system of a tet whose volume ratio `theta` is an unknown of its own.

    Three-field form of Simo, Taylor and Pister (Comput. Methods Appl. Mech. Eng. 51,
    1985): W(u, theta) = sum_q w_q psi((theta / J_q)^(1/3) F_q) with theta = J_bar(u)
    enforced by a pressure; theta and the pressure are condensed out of the Newton
    step. The point of it is that a large step is judged by its linear volume change:
    with theta tied to u, a nearly incompressible body resists every rotation that the
    step has not yet completed.

    With theta = J_bar(u) the stiffness is the Hessian of `element_energy` and the force
    is `element_force`.

    Args:
        u: Nodal displacements [m].
        theta: Volume ratio of the tet [-].
        dN: Shape gradients at the quadrature points [1/m].
        w: Quadrature weights, volume included [m3].
        law: Constitutive law.

    Returns:
        Condensed stiffness [N/m] and force [N].
    """
    F = deformation_gradients(u, dN)
    n_qp = F.shape[0]
    J, s = _scaled_to(theta, F)
    volume = jnp.sum(w)
    share = w * J / (theta * volume)
    gap = jnp.sum(share) - 1.0  # J_bar / theta - 1
    points = []
    pressure = curvature = jnp.zeros_like(theta)
    # With eta = d ln theta and G = F^-T, dF_bar = s (dF + (eta - G : dF) / 3 F).
    for q in range(n_qp):
        G = cofactor(F[q]) / J[q]
        P_bar = s[q] * law.stress(s[q] * F[q])
        A = s[q] ** 2 * law.tangent(s[q] * F[q])
        A_F = jnp.sum(A * F[q][None, None], axis=(2, 3))
        trace = jnp.sum(P_bar * F[q])
        both = (jnp.sum(A_F * F[q]) + trace) / 9.0
        points.append((G, P_bar, A, A_F + P_bar, trace / 3.0, both))
        pressure = pressure + w[q] * trace / 3.0
        curvature = curvature + w[q] * both
    K, f, g, h = 0.0, 0.0, 0.0, 0.0
    for q, (G, P_bar, A, Q, trace, both) in enumerate(points):
        GG = _outer(G, G)
        GxG = G[:, None, None, :] * G.T[None, :, :, None]
        A_eff = w[q] * (A - (_outer(G, Q) + _outer(Q, G)) / 3.0 + both * GG + trace * GxG)
        K = K + _pull(A_eff + pressure * share[q] * (GG - GxG), dN[q])
        f = f + _push(w[q] * (P_bar - trace * G) + pressure * share[q] * G, dN[q])
        g = g + _push(share[q] * G, dN[q])
        h = h + _push(w[q] * (Q / 3.0 - both * G), dN[q])
    curvature = curvature - pressure
    K = K + _outer(g, h) + _outer(h, g) + curvature * _outer(g, g)
    return K, f + (h + curvature * g) * gap
