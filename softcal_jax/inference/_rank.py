"""What rows of a linear system determine: one rule for every rank in the statistics.

A column that is smaller than `NO_EFFECT` times the largest is what a factorization
leaves of zero. The others are scaled to unit length, so that the unit of an unknown
decides nothing, and a direction is seen if its singular value is above `RANK` times the
largest. Compliances are exact to about 1e-9, and their squares, which weigh a
direction, to the square root of that; what lies below a millionth is rounding, and an
error a million times that of the best direction is no knowledge.
"""

import numpy as np

from softcal_jax._module import Module
from softcal_jax._typing import Bool, Float, HostArray

NO_EFFECT = 1e-12
"""Length of a column, over the largest, below which it has no effect [-]."""

RANK = 1e-6
"""Singular value of columns of unit length, over the largest, that is rounding [-]."""


class Determined(Module):
    """What rows R determine of the unknowns, (R^T R)^-1 = F F^T along what is seen.

    Attributes:
        factor: F, one column per direction that is seen.
        basis: Orthonormal basis of the column space, R F in exact arithmetic.
        unseen: Orthonormal directions of the unknowns that no row sees, as rows.
        blind: Unknowns with a component in one of these.
    """

    factor: Float[HostArray, "n_unknowns rank"]
    basis: Float[HostArray, "n rank"]
    unseen: Float[HostArray, "n_unseen n_unknowns"]
    blind: Bool[HostArray, " n_unknowns"]


def determined(rows: Float[HostArray, "n n_unknowns"]) -> Determined:
    """Decompose rows, all finite, by the rule of this module."""
    n, n_unknowns = rows.shape
    size = np.linalg.norm(rows, axis=0)
    active = np.flatnonzero(size > NO_EFFECT * np.max(size, initial=0.0))
    unit = rows[:, active] / size[active]
    # At least as many rows as columns, so that directions without a row are listed.
    padding = np.zeros((max(0, len(active) - n), len(active)))
    U, singular, Vt = np.linalg.svd(
        np.concatenate([unit, padding]), full_matrices=False
    )
    seen = singular > RANK * np.max(singular, initial=0.0)
    factor = np.zeros((n_unknowns, int(seen.sum())))
    factor[active] = Vt[seen].T / singular[seen] / size[active, None]
    blind = np.ones(n_unknowns, bool)
    blind[active] = np.max(np.abs(Vt[~seen]), axis=0, initial=0.0) > RANK
    astray = np.zeros((int((~seen).sum()), n_unknowns))
    astray[:, active] = Vt[~seen] / size[active]
    without_effect = np.delete(np.eye(n_unknowns), active, axis=0)
    unseen, _ = np.linalg.qr(np.concatenate([astray, without_effect]).T)
    return Determined(factor, U[:n, seen], unseen.T, blind)


def span(columns: Float[HostArray, "n k"]) -> Float[HostArray, "n rank"]:
    """Return an orthonormal basis of the space that columns span."""
    return determined(columns).basis
