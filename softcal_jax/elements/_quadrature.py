"""Quadrature rules on the reference triangle and tet."""

from typing import NamedTuple

import numpy as np

from softcal_jax._typing import Float, HostArray


class QuadratureRule(NamedTuple):
    """Points and weights on a reference simplex of unit measure."""

    barycentric: Float[HostArray, "n_points n_corners"]
    weights: Float[HostArray, " n_points"]


def _permuted(n_corners: int, inner: float) -> HostArray:
    """Place one point per corner: `inner` on the others, the rest on that corner."""
    points = np.full((n_corners, n_corners), inner)
    np.fill_diagonal(points, 1.0 - (n_corners - 1) * inner)
    return points


def tet_rule(degree: int) -> QuadratureRule:
    """Return the rule on the tet that is exact for polynomials of `degree`.

    Degree 1: the centroid. Degree 2: the four-point rule. Degree 3 and 4: the
    eleven-point rule of Keast (Comput. Methods Appl. Mech. Eng. 55, 1986), used
    for errors and loads, not for stiffness.

    Args:
        degree: Polynomial degree integrated exactly, 1 to 4.

    Returns:
        Points and weights that sum to one.

    Raises:
        ValueError: If there is no rule of that degree.
    """
    if degree == 1:
        return QuadratureRule(np.full((1, 4), 0.25), np.ones(1))
    if degree == 2:
        inner = (5.0 - np.sqrt(5.0)) / 20.0
        return QuadratureRule(_permuted(4, inner), np.full(4, 0.25))
    if degree in (3, 4):
        a, b = (1.0 + np.sqrt(5.0 / 14.0)) / 4.0, (1.0 - np.sqrt(5.0 / 14.0)) / 4.0
        pairs = [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)]
        edge = np.full((6, 4), b)
        for row, (i, j) in enumerate(pairs):
            edge[row, [i, j]] = a
        points = np.vstack([np.full((1, 4), 0.25), _permuted(4, 1.0 / 14.0), edge])
        weights = np.array(
            [-148.0 / 1875.0] + [343.0 / 7500.0] * 4 + [56.0 / 375.0] * 6
        )
        return QuadratureRule(points, weights)
    raise ValueError(f"tet rules exist for degree 1 to 4, got {degree}.")


def triangle_rule(degree: int) -> QuadratureRule:
    """Return the rule on the triangle that is exact for polynomials of `degree`.

    Degree 1: the centroid. Degree 2: the three-point rule. Degree 3 and 4: the
    six-point rule of Dunavant (Int. J. Numer. Methods Eng. 21, 1985).

    Args:
        degree: Polynomial degree integrated exactly, 1 to 4.

    Returns:
        Points and weights that sum to one.

    Raises:
        ValueError: If there is no rule of that degree.
    """
    if degree == 1:
        return QuadratureRule(np.full((1, 3), 1.0 / 3.0), np.ones(1))
    if degree == 2:
        return QuadratureRule(_permuted(3, 1.0 / 6.0), np.full(3, 1.0 / 3.0))
    if degree in (3, 4):
        points = np.vstack(
            [_permuted(3, 0.445948490915965), _permuted(3, 0.091576213509771)]
        )
        weights = np.array([0.223381589678011] * 3 + [0.109951743655322] * 3)
        return QuadratureRule(points, weights / weights.sum())
    raise ValueError(f"triangle rules exist for degree 1 to 4, got {degree}.")
