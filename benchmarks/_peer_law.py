"""The law of the job for libraries that take stresses and tangents as arrays.

S = C : E with the Green strain E, P = F S, and A_iJkL = delta_ik S_JL +
F_iI F_kK C_IJKL. Tensors come first and tets last, as FElupe has them.
"""

import numpy as np

from softcal_jax._typing import HostArray


def roots(fields: HostArray) -> HostArray:
    """B = sqrt(E_t) I + (sqrt(E_l) - sqrt(E_t)) u u^T of each tet [sqrt(Pa)].

    Args:
        fields: E_t [Pa], E_l [Pa] and theta [rad] of each tet; theta turns in the
            print plane "xy".

    Returns:
        Row, column, tet.
    """
    E_t, E_l, theta = fields.T
    u = np.stack([np.cos(theta), np.sin(theta), np.zeros_like(theta)])
    outer = (np.sqrt(E_l) - np.sqrt(E_t)) * u[:, None] * u[None]
    return np.sqrt(E_t) * np.eye(3)[:, :, None] + outer


def stiffness(fields: HostArray, nu: float) -> HostArray:
    """C of each tet, with E : C : E = (tr(B E B E) + r (B : E)^2) / (1 + nu) [Pa].

    r is nu / (1 - 2 nu), see `ReducedTransverseIsotropic`.

    Args:
        fields: As of `roots`.
        nu: Poisson's ratio [-].

    Returns:
        Four axes, tet.
    """
    B = roots(fields)
    shear = np.einsum("IKt,JLt->IJKLt", B, B) + np.einsum("ILt,JKt->IJKLt", B, B)
    volume = np.einsum("IJt,KLt->IJKLt", B, B)
    return (0.5 * shear + nu / (1.0 - 2.0 * nu) * volume) / (1.0 + nu)


def second_stress(F: HostArray, C: HostArray) -> HostArray:
    """S at each point of each tet [Pa].

    Args:
        F: Deformation gradients: row, column, point, tet [-].
        C: Stiffness of each tet [Pa].
    """
    strain = 0.5 * (np.einsum("iIqt,iJqt->IJqt", F, F) - np.eye(3)[:, :, None, None])
    return np.einsum("IJKLt,KLqt->IJqt", C, strain)


def stress(F: HostArray, C: HostArray) -> HostArray:
    """P; arguments as of `second_stress` [Pa]."""
    return np.einsum("iIqt,IJqt->iJqt", F, second_stress(F, C))


def tangent(F: HostArray, C: HostArray) -> HostArray:
    """A; arguments as of `second_stress` [Pa]."""
    half = np.einsum("iIqt,IJKLt->iJKLqt", F, C)
    A = np.einsum("kKqt,iJKLqt->iJkLqt", F, half)
    S = second_stress(F, C)
    for i in range(3):
        A[i, :, i] += S
    return A
