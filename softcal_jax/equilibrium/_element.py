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
from softcal_jax.materials import AbstractLaw, turned

AnyArray = Array | HostArray
Formulation = Literal["displacement", "mean-dilatation"]


_LEAST_STRETCH = 0.2
"""Stretch below which a predicted strain is none, and the load is cut [-]."""


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


def element_energy_and_force(
    u: Float[Array, "n_en 3"], tet: Tet
) -> tuple[Float[Array, ""], Float[Array, "n_en 3"]]:
    """Compute the strain energy [J] of a tet and its gradient with respect to u [N]."""
    psi, P = _energies_and_stresses(deformation_gradients(u, tet.dN), tet)
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
    F = deformation_gradients(u, tet.dN)
    psi, P = _energies_and_stresses(F, tet)
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
    F = deformation_gradients(u, tet.dN)
    _, P = _energies_and_stresses(F, tet)
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
    F: Float[Array, "n_qp 3 3"], tet: Tet, theta: Float[Array, ""] | None = None
) -> tuple[Float[Array, " n_qp"], Float[Array, "n_qp 3 3"]]:
    """Compute energy densities, and first Piola-Kirchhoff stresses times weights.

    With another volume ratio `theta` than J_bar, for the pressure that belongs to it.
    """
    w = tet.w
    if not tet.mixed:
        psi, P = jax.vmap(tet.law.energy_and_stress)(F)
        return psi, _each(w) * P
    matrix, rest = tet.law.parts()
    mean = _mean_volume(F, w, theta)
    psi, P_bar = jax.vmap(matrix.energy_and_stress)(_each(mean.s) * F)
    P_bar = _each(mean.s) * P_bar
    mean_stress = jnp.sum(P_bar * F, axis=(1, 2)) / 3.0
    pressure = jnp.sum(w * mean_stress)
    P = _each(w) * P_bar + _each(pressure * mean.share - w * mean_stress) * mean.G
    if rest is not None:
        psi_rest, P_rest = jax.vmap(rest.energy_and_stress)(F)
        psi, P = psi + psi_rest, P + _each(w) * P_rest
    return psi, P


class _MeanVolume(NamedTuple):
    """What replaces the volume ratio of each point by theta, the mean J_bar or near it.

    Factors s = (theta / J)^(1/3), F^-T, and w J / (theta sum w), which sum to 1 if
    theta is J_bar.
    """

    s: Float[Array, " n_qp"]
    G: Float[Array, "n_qp 3 3"]
    share: Float[Array, " n_qp"]


def _mean_volume(F: Float[Array, "n_qp 3 3"], w, theta=None) -> _MeanVolume:
    J = jax.vmap(determinant)(F)
    theta = _dilatation(F, w) if theta is None else theta
    share = w * J / (theta * jnp.sum(w))
    return _MeanVolume(jnp.cbrt(theta / J), jax.vmap(cofactor)(F) / _each(J), share)


def _dilatation(F: Float[Array, "n_qp 3 3"], w) -> Float[Array, ""]:
    """Compute the volume of a tet relative to its volume at rest, J_bar [-]."""
    return jnp.sum(w * jax.vmap(determinant)(F)) / jnp.sum(w)


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
        return _each(_mean_volume(F, tet.w).s) * F

    def stiffness(F, dF):
        A = jax.lax.map(tet.law.tangent, F)
        return tet.active * jnp.einsum("q,qiJ,qiJkL,qkL", tet.w, dF, A, dF)

    F, dF = jax.jvp(gradients, (u,), (du,))
    left, _, right = jnp.linalg.svd(F)
    R = left @ right
    symmetric = lambda a: 0.5 * (a + jnp.swapaxes(a, 1, 2))
    straight = R @ symmetric(jnp.swapaxes(R, 1, 2) @ dF)
    rate = symmetric(dF @ jnp.linalg.inv(F))
    at_rest = jnp.broadcast_to(jnp.eye(3), F.shape)
    return jnp.stack([stiffness(F, straight), stiffness(at_rest, rate)])


class Strains(NamedTuple):
    """Strain E and second Piola-Kirchhoff stress of points, as unknowns beside u.

    The strain is stated by a stretch F0 with F0^T F0 = 2 E + 1 [-], the stress times
    the volume of its point [J]. Each tet has its volume ratio theta besides, which
    counts with mean dilatation. Of one tet, or of all, in blocks.
    """

    stretch: Float[Array, "..."]
    stress: Float[Array, "..."]
    theta: Float[Array, "..."]


def green_strain(F: Float[Array, "n_qp 3 3"]) -> Float[Array, "n_qp 3 3"]:
    return 0.5 * (_product(_transposed(F), F) - jnp.eye(3)[None])


def _stretch(E: Float[Array, "3 3"]) -> Float[Array, "3 3"]:
    """Return the upper triangle F with F^T F = 2 E + 1; nan if that has none."""
    C = 2.0 * E + jnp.eye(3)
    a = jnp.sqrt(C[0, 0])
    b, c = C[0, 1] / a, C[0, 2] / a
    d = jnp.sqrt(C[1, 1] - b * b)
    e = (C[1, 2] - b * c) / d
    f, zero = jnp.sqrt(C[2, 2] - c * c - e * e), jnp.zeros(())
    rows = (a, b, c), (zero, d, e), (zero, zero, f)
    return jnp.stack([jnp.stack(row) for row in rows])


def predicted_strains(
    u: Float[Array, "n_en 3"],
    du: Float[Array, "n_en 3"],
    tet: Tet,
    strains: Strains,
    exact: Bool[Array, ""],
) -> tuple[Strains, Bool[Array, ""]]:
    """Predict strain and stress after a step, linearly, and whether they can be.

    If `exact`, the strain before the step is that of u, and not the one in `strains`.
    """
    F, dF = jax.jvp(lambda u: deformation_gradients(u, tet.dN), (u,), (du,))
    at_u, x = green_strain(F), _product(_transposed(F), dF)
    new = at_u + 0.5 * (x + _transposed(x))
    F = jnp.where(exact, F, strains.stretch)
    along = _product(_transposed(_inverse(F)), new - green_strain(F))

    def second(F, theta):
        return _product(_inverse(F), _energies_and_stresses(F, tet, theta)[1])

    stretch = jax.vmap(_stretch)(new)
    sound = jnp.all(jnp.diagonal(stretch, axis1=1, axis2=2) > _LEAST_STRETCH)
    if not tet.mixed:
        S, dS = jax.jvp(lambda F: second(F, None), (F,), (along,))
        return Strains(stretch, S + dS, strains.theta), sound
    J, dJ = jax.jvp(lambda F: _dilatation(F, tet.w), (F,), (along,))
    theta = jnp.where(exact, J, strains.theta)
    S, dS = jax.jvp(second, (F, theta), (along, J + dJ - theta))
    # First order is meaningless where a step would invert a tet: limit to a factor 4.
    return Strains(stretch, S + dS, jnp.clip(J + dJ, 0.25, 4.0)), sound


def newton_system(
    u: Float[Array, "n_en 3"],
    tet: Tet,
    strains: Strains | None = None,
) -> tuple[Float[Array, "n_en 3 n_en 3"], Float[Array, "n_en 3"]]:
    """Compute stiffness [N/m] and force [N] of a tet for a Newton step.

    A long step rotates a body only to first order, which stretches it; the law, asked
    at this spurious stretch, would spoil the next tangent. So strain and stress of the
    points are unknowns beside u, in the weak form of Hu and Washizu,

        r_u = B(u)^T S - f,    r_E = dW/dE(E) - S,    r_S = E(u) - E,

    condensed out point by point: the law is only asked at the strain E that the last
    step predicted, at any F0 with F0^T F0 = 2 E + 1, and turned by G = F F0^-1. With
    mean dilatation W couples the points. (Compare Magisano, Leonetti and Garcea,
    Comput. Methods Appl. Mech. Eng. 313, 2017; Pfefferkorn and others, Int. J. Numer.
    Methods Eng. 122, 2021.)

    Without `strains`, or if `exact`, they are Hessian and gradient of the strain energy
    at u, as they are where E = E(u).
    """
    F = deformation_gradients(u, tet.dN)
    if strains is None:
        at = _response(F, tet)
    else:
        at = _turned(_response(strains.stretch, tet, strains.theta), F, strains)
    K = _pull(at.tangent, tet.dN)
    if at.pairs is not None:
        K = K + at.pairs.pulled(tet.dN)
    return K, _push(at.stress, tet.dN)


class _Pairs(NamedTuple):
    """What mean dilatation adds to a tangent, as products of 3x3 tensors.

    Pushed to the nodes first: adding the products to the tangent, and pulling that,
    would take longer. At each point Y G + G Y, and G_iL swap_kJ; over all points the
    product of the sums of `volume` and `slope`, and its transpose.
    """

    Y: Float[Array, "n_qp 3 3"]
    G: Float[Array, "n_qp 3 3"]
    swap: Float[Array, "n_qp 3 3"]
    volume: Float[Array, "n_qp 3 3"]
    slope: Float[Array, "n_qp 3 3"]

    def along(self, dF: Float[Array, "n_qp 3 3"]) -> Float[Array, "n_qp 3 3"]:
        """Multiply with a change of F at all points."""
        Y, G, swap, volume, slope = self
        at_point = lambda X: jnp.sum(X * dF, axis=(1, 2), keepdims=True)
        swapped = _product(_product(G, _transposed(dF)), swap)
        both = volume * jnp.sum(slope * dF) + slope * jnp.sum(volume * dF)
        return Y * at_point(G) + G * at_point(Y) + swapped + both

    def pulled(self, dN: Float[Array, "n_qp n_en 3"]) -> Float[Array, "n_en 3 n_en 3"]:
        """Contract both reference indices with shape gradients."""
        nodal = jnp.einsum("cqiJ,qaJ->cqai", jnp.stack(self), dN)
        (y, G, swap), (g, h) = nodal[:3], jnp.sum(nodal[3:], axis=1)
        left, right = [y, g[None]], [G, h[None]]
        rows, columns = map(jnp.concatenate, (left + right, right + left))
        K = jnp.einsum("cai,cbk->aibk", rows, columns)
        return K + jnp.einsum("qak,qbi->aibk", swap, G)


class _Response(NamedTuple):
    """First Piola-Kirchhoff stress and tangent of points, times their volumes.

    `by_volume` is what the stress misses as long as theta is not J_bar.
    """

    stress: Float[Array, "n_qp 3 3"]
    tangent: Float[Array, "n_qp 3 3 3 3"]
    pairs: _Pairs | None = None
    by_volume: Float[Array, "n_qp 3 3"] | None = None


def _response(
    F: Float[Array, "n_qp 3 3"], tet: Tet, theta: Float[Array, ""] | None = None
) -> _Response:
    """Ask the law for the Hessian of the energy of a tet, as a function of its F.

    With mean dilatation this is the three-field form of Simo, Taylor and Pister
    (Comput. Methods Appl. Mech. Eng. 51, 1985), theta and the pressure condensed out. A
    nearly incompressible body is then judged by its linear change of volume.
    """
    w = tet.w
    # One point after the other: the tensors of a block of tets stay in the cache.
    ask = lambda law, F: jax.lax.map(law.stress_and_tangent, F)
    if not tet.mixed:
        P, A = ask(tet.law, F)
        return _Response(_each(w) * P, _of_tensors(w) * A)
    # With eta = d ln J_bar and G = F^-T, dF_bar = s (dF + (eta - G : dF) / 3 F).
    matrix, rest = tet.law.parts()
    s, G, share = _mean_volume(F, w, theta)
    P_bar, A = ask(matrix, _each(s) * F)
    P_bar = _each(s) * P_bar
    Q = _each(s**2) * jnp.einsum("qiJkL,qkL->qiJ", A, F) + P_bar
    mean_stress = jnp.sum(P_bar * F, axis=(1, 2)) / 3.0
    both = jnp.sum(Q * F, axis=(1, 2)) / 9.0
    pressure = jnp.sum(w * mean_stress)
    curvature = jnp.sum(w * both) - pressure
    G, P_bar, Q = jax.lax.optimization_barrier((G, P_bar, Q))
    slope = _each(w / 3.0) * Q - _each(w * both) * G
    pairs = _Pairs(
        Y=_each(0.5 * (pressure * share - w * both)) * G - slope,
        G=G,
        swap=_each(w * mean_stress - pressure * share) * G,
        volume=_each(share) * G,
        slope=slope + 0.5 * curvature * _each(share) * G,
    )
    P, A = _each(w) * P_bar - pairs.swap, _of_tensors(w * s**2) * A
    if rest is not None:
        P_rest, A_rest = ask(rest, F)
        P, A = P + _each(w) * P_rest, A + _of_tensors(w) * A_rest
    by_volume = (pairs.slope + 0.5 * curvature * pairs.volume) * (jnp.sum(share) - 1.0)
    return _Response(P, A, pairs, by_volume)


def _turned(at: _Response, F: Float[Array, "n_qp 3 3"], strains: Strains) -> _Response:
    """Take what the law says of strains to the state F, and add r_E and r_S."""
    inverse = _inverse(strains.stretch)
    turn = _product(F, inverse)
    gap = green_strain(F) - green_strain(strains.stretch)
    gap = _product(_transposed(inverse), gap)
    by_gap = jnp.einsum("qiJkL,qkL->qiJ", at.tangent, gap)
    S, pairs = _product(inverse, at.stress), at.pairs
    if pairs is not None and at.by_volume is not None:
        by_gap = by_gap + pairs.along(gap) + at.by_volume
        pairs = _Pairs(*(_product(turn, each) for each in pairs))
    stress = S + _product(inverse, by_gap - _product(gap, S))
    paired = lambda X, S: X[:, :, None, :, None] * _transposed(S)[:, None, :, None]
    square, one = _product(turn, _transposed(turn)), jnp.eye(3)[None]
    A = jax.vmap(turned)(at.tangent, turn)
    A = A + paired(one, strains.stress) - paired(square, S)
    return _Response(_product(F, stress), A, pairs, at.by_volume)


_product = jax.vmap(matmul)


def _transposed(A: Float[Array, "n_qp 3 3"]) -> Float[Array, "n_qp 3 3"]:
    return jnp.swapaxes(A, 1, 2)


def _inverse(F: Float[Array, "n_qp 3 3"]) -> Float[Array, "n_qp 3 3"]:
    return _transposed(jax.vmap(cofactor)(F)) / _each(jax.vmap(determinant)(F))


def _of_tensors(a: Float[Array, " n_qp"]) -> Float[Array, "n_qp 1 1 1 1"]:
    return a[:, None, None, None, None]


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
