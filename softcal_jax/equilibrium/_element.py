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

from softcal_jax._typing import Array, Bool, Float
from softcal_jax.elements import cofactor, determinant, matmul, sum_of
from softcal_jax.materials import AbstractLaw, law_at_points

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
    H = sum_of(r[None, :, None] * dN[:, a, None] for a, r in enumerate(relative, 1))
    # Not again for each entry of what is computed of it.
    return jax.lax.optimization_barrier(jnp.eye(3)[None] + H)


def _scaled_to(theta: Float[Array, ""], F: Float[Array, "n_qp 3 3"]):
    """Volume ratios J, the factors (theta / J)^(1/3) that make all theta, and F^-T."""
    J = jax.vmap(determinant)(F)
    return J, jnp.cbrt(theta / J), jax.vmap(cofactor)(F) / J[:, None, None]


def _at_points(law: AbstractLaw, function, F: Float[Array, "n_qp 3 3"]):
    """Energy, stress or tangent of a law at the quadrature points of a tet."""
    plain, axes = law_at_points(law)
    return jax.vmap(function, in_axes=(axes, 0))(plain, F)


def _energies_and_stresses(law: AbstractLaw, F: Float[Array, "n_qp 3 3"]):
    return _at_points(law, lambda law, F: law.energy_and_stress(F), F)


def _stresses(law: AbstractLaw, F: Float[Array, "n_qp 3 3"]):
    return _at_points(law, lambda law, F: law.stress(F), F)


def _stresses_and_tangents(law: AbstractLaw, F: Float[Array, "n_qp 3 3"]):
    return _at_points(law, lambda law, F: law.stress_and_tangent(F), F)


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
    return element_energy_and_force(u, dN, w, law, formulation)[0]


def element_force(
    u: Float[Array, "n_en 3"],
    dN: Float[Array, "n_qp n_en 3"],
    w: Float[Array, " n_qp"],
    law: AbstractLaw,
    formulation: Formulation,
) -> Float[Array, "n_en 3"]:
    """Internal force of a tet, the gradient of its energy in u [N]."""
    return element_energy_and_force(u, dN, w, law, formulation)[1]


def element_energy_and_force(
    u: Float[Array, "n_en 3"],
    dN: Float[Array, "n_qp n_en 3"],
    w: Float[Array, " n_qp"],
    law: AbstractLaw,
    formulation: Formulation,
) -> tuple[Float[Array, ""], Float[Array, "n_en 3"]]:
    """Strain energy [J] of a tet, and its gradient in u [N]."""
    F = deformation_gradients(u, dN)
    if is_mixed(formulation, F.shape[0]):
        theta = mean_dilatation(u, dN, w)
        J, s, G = _scaled_to(theta, F)
        share = w * J / (theta * jnp.sum(w))
        psi, P_bar = _energies_and_stresses(law, _each(s) * F)
        P_bar = _each(s) * P_bar
        mean_stress = jnp.sum(P_bar * F, axis=(1, 2)) / 3.0
        pressure = jnp.sum(w * mean_stress)
        P = _each(w) * P_bar + _each(pressure * share - w * mean_stress) * G
    else:
        psi, P = _energies_and_stresses(law, F)
        P = _each(w) * P
    return jnp.sum(w * psi), _push(P, dN)


def element_stiffness(
    u: Float[Array, "n_en 3"],
    dN: Float[Array, "n_qp n_en 3"],
    w: Float[Array, " n_qp"],
    law: AbstractLaw,
    formulation: Formulation,
    before: Float[Array, "n_en 3"] | None = None,
    stepped: Bool[Array, ""] | None = None,
) -> Float[Array, "n_en 3 n_en 3"]:
    """Tangent stiffness of a tet, the Hessian of its energy in u [N/m].

    Args:
        u: Nodal displacements [m].
        dN: Shape gradients at the quadrature points [1/m].
        w: Quadrature weights, volume included [m3].
        law: Constitutive law.
        formulation: Of the volume change.
        before: Displacements from which a step led to `u`; the stress that bends with
            the tet is then the one that the step foresaw, see `_foreseen` [m].
        stepped: Whether `before` differs from `u` anywhere in the body; given with it.
    """
    F = deformation_gradients(u, dN)
    if is_mixed(formulation, F.shape[0]):
        return mixed_newton(u, mean_dilatation(u, dN, w), dN, w, law)[0]
    P, A = _stresses_and_tangents(law, F)
    if before is not None:
        began = deformation_gradients(before, dN)
        gap = jax.lax.cond(
            stepped,
            lambda: _second(F, P) - _foreseen(law, began, F),
            lambda: jnp.zeros_like(P),
        )
        A = A - jnp.eye(3)[None, :, None, :, None] * gap[:, None, :, None, :]
    return _pull(w[:, None, None, None, None] * A, dN)


def _second(
    F: Float[Array, "n_qp 3 3"], P: Float[Array, "n_qp 3 3"]
) -> Float[Array, "n_qp 3 3"]:
    """Second Piola-Kirchhoff stress F^-1 P [Pa]."""
    J, G = jax.vmap(determinant)(F), jax.vmap(cofactor)(F)
    return jax.vmap(matmul)(jnp.swapaxes(G, 1, 2), P) / _each(J)


def _foreseen(
    law: AbstractLaw, before: Float[Array, "n_qp 3 3"], F: Float[Array, "n_qp 3 3"]
) -> Float[Array, "n_qp 3 3"]:
    """Second Piola-Kirchhoff stress that a step from `before` foresees at its end [Pa].

    A long step in a slender body turns it only to first order, which stretches it; the
    stress of that stretch, which the next step takes away, is in the tangent at the
    end of the step and misleads it. Newton's method on stresses of their own at the
    quadrature points, condensed out, has the stress there that was foreseen (Magisano,
    Leonetti and Garcea, Comput. Methods Appl. Mech. Eng. 313, 2017).
    """
    second = lambda F: _second(F, _stresses(law, F))
    stress, change = jax.jvp(second, (before,), (F - before,))
    return stress + change


def _each(a: Float[Array, " n_qp"]) -> Float[Array, "n_qp 1 1"]:
    """One number per quadrature point, to multiply a tensor per point."""
    return a[:, None, None]


def _push(
    P: Float[Array, "n_qp 3 3"], dN: Float[Array, "n_qp n_en 3"]
) -> Float[Array, "n_en 3"]:
    """Nodal forces of the stresses at the quadrature points."""
    return sum_of(
        P[q, None, :, J] * dN[q, :, None, J]
        for q in range(P.shape[0])
        for J in range(3)
    )


def _pull(
    A: Float[Array, "n_qp 3 3 3 3"], dN: Float[Array, "n_qp n_en 3"]
) -> Float[Array, "n_en 3 n_en 3"]:
    """Stiffness of the tangents: both reference slots contracted with gradients.

    No tensor is fused into the contraction that follows, which would compute it again
    for every node.
    """
    A = jax.lax.optimization_barrier(A)
    half = jax.lax.optimization_barrier(jnp.einsum("qaJ,qiJkL->qaikL", dN, A))
    return jnp.einsum("qaikL,qbL->aibk", half, dN)


def _outer(a: Float[Array, "*q m 3"], b: Float[Array, "*q n 3"]):
    """Tensor product over the last two axes."""
    return a[..., :, :, None, None] * b[..., None, None, :, :]


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
    # With eta = d ln theta and G = F^-T, dF_bar = s (dF + (eta - G : dF) / 3 F).
    F = deformation_gradients(u, dN)
    J, s, G = _scaled_to(theta, F)
    share = w * J / (theta * jnp.sum(w))
    gap = jnp.sum(share) - 1.0  # J_bar / theta - 1
    P_bar, A = _stresses_and_tangents(law, _each(s) * F)
    P_bar, A = _each(s) * P_bar, (s**2)[:, None, None, None, None] * A
    A_F = jnp.sum(A * F[:, None, None], axis=(3, 4))
    Q = A_F + P_bar
    mean_stress = jnp.sum(P_bar * F, axis=(1, 2)) / 3.0
    both = jnp.sum(Q * F, axis=(1, 2)) / 9.0
    pressure = jnp.sum(w * mean_stress)
    curvature = jnp.sum(w * both) - pressure

    swapped = jnp.swapaxes(_outer(G, G), 2, 4)  # G_iL G_kJ
    wide = lambda a: a[:, None, None, None, None]
    A_eff = (
        wide(w) * A
        - _outer(_each(w / 3.0) * G, Q)
        - _outer(Q, _each(w / 3.0) * G)
        + wide(w * both + pressure * share) * _outer(G, G)
        + wide(w * mean_stress - pressure * share) * swapped
    )
    force = _push(_each(w) * P_bar + _each(pressure * share - w * mean_stress) * G, dN)
    g = _push(_each(share) * G, dN)
    h = _push(_each(w / 3.0) * Q - _each(w * both) * G, dN)
    K = _pull(A_eff, dN) + _outer(g, h) + _outer(h, g) + curvature * _outer(g, g)
    return K, force + (h + curvature * g) * gap
