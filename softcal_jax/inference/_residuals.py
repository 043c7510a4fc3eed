"""Statistics of residuals, linearised at the optimum: do they fit the model?

Where the jitter is estimated from the residuals, chi-squared is in order whatever the
model. Two questions remain. Are the residuals of a configuration alike, beyond what
independent jitter and the stated offsets make of them (lack of fit; Draper and Smith,
Applied Regression Analysis, 1998, sec. 2.1; Bates and Watts, Nonlinear Regression
Analysis, 1988, sec. 1.3.2)? And do the others predict a configuration?
"""

import numpy as np
from scipy.special import chdtrc, fdtrc

from softcal_jax._module import Module
from softcal_jax._typing import Float, HostArray, Int
from softcal_jax.inference._linear_model import LinearModel
from softcal_jax.inference._rank import RANK, span
from softcal_jax.inference._whitening import whitened

ABSORBED = 1e-3
"""Share of an error common to a configuration below which parameters take it up [-].

No question of rank: a modulus moves a pose almost along its motion, and what is left
beside it is curvature, not an error of the pose.
"""

ROUNDING = 1e-9
"""Size of residuals, over the errors that they are left of, that is rounding [-]."""


class LackOfFit(Module):
    """Scatter between configurations compared with that within them.

    Attributes:
        ratio: Mean square of what all coordinates of a configuration share, its offset
            and its share of the motion, over that of the rest [-].
        between: Degrees of freedom of the former.
        within: Degrees of freedom of the latter.
        probability: Chance of a ratio as large if the model is right [-].
        jitter: Factor on the stated standard deviations by the scatter within
            configurations [-].
        shares: Share of each configuration in the former; they sum to one [-].
    """

    ratio: float
    between: int
    within: int
    probability: float
    jitter: float
    shares: Float[HostArray, " n_c"]


def lack_of_fit(
    linear: LinearModel,
    shared: Float[HostArray, "n n_between"],
    pose: Int[HostArray, " n_between"],
) -> LackOfFit | None:
    """Test whether the errors of configurations have something in common.

    The jitter is that of the scatter within configurations, where neither parameters
    nor offsets nor shares of the motion reach. With it, offsets as stated and what is
    considered, the rest is compared by an F test.

    Args:
        linear: The fit.
        shared: What the coordinates of a configuration may share: offsets, its motion.
        pose: Configuration of each of these columns.

    Returns:
        The test; None where nothing is left on either side.
    """
    explained = span(np.concatenate([linear.W[:, ~linear.held], shared], axis=1))
    rest = linear.r - explained @ (explained.T @ linear.r)
    within, squares = len(rest) - explained.shape[1], float(rest @ rest)
    if within < 1 or not squares > (ROUNDING * np.linalg.norm(linear.r)) ** 2:
        return None
    jitter = float(np.sqrt(squares / within))
    fit = linear.with_jitter(jitter)
    slope, seen = shared.T @ fit.errors_left(), shared.T @ fit.left(shared)
    by_others = shared.T @ fit.left(linear.considered.values)
    size = np.sqrt(np.maximum(np.diag(seen), 1e-300))
    scaled = (seen + by_others @ by_others.T) / np.outer(size, size)
    square, U = np.linalg.eigh(seen / np.outer(size, size))
    U = U[:, square > ABSORBED * max(square, default=0.0)]
    between = U.shape[1]
    if between == 0:
        return None
    common = U @ np.linalg.solve(U.T @ scaled @ U, U.T @ (slope / size)) / size
    n_fitted = int(np.max(linear.pose)) + 1
    parts = np.bincount(pose, common * slope, minlength=n_fitted)
    ratio = float(np.sum(parts)) / between
    return LackOfFit(
        ratio=ratio,
        between=between,
        within=within,
        probability=float(fdtrc(between, within, ratio)),
        jitter=jitter,
        shares=parts / max(float(np.sum(parts)), 1e-300),
    )


def jitter_freedom(linear: LinearModel) -> float:
    """Return the degrees of freedom that an estimate of s^2 has, s^4 tr(M^2) [-].

    They are 2 s^4 over the variance of that estimate (Satterthwaite, Biometrics
    Bulletin 2, 1946): all residuals tell of the jitter if they are independent, and
    those that offsets cover hardly do.

    Args:
        linear: The fit.
    """
    Q = span(np.concatenate([linear.W, linear.correlated.values], axis=1))
    within = linear.scale**2 * (Q.T @ linear.left(Q))
    return len(Q) - Q.shape[1] + float(np.sum(within**2))


class PosePrediction(Module):
    """The errors of one configuration, as the others predict them.

    Attributes:
        error: Predicted minus measured, in stated noise units; nan where the others do
            not determine a parameter that it takes [-].
        std: Its standard deviation by noise, parameters and what is considered [-].
        chi_squared: Sum of squares of what can be predicted, over its covariance [-].
        degrees_of_freedom: Number of these.
    """

    error: Float[HostArray, " n"]
    std: Float[HostArray, " n"]
    chi_squared: float
    degrees_of_freedom: int


def predicted_by_others(linear: LinearModel) -> list[PosePrediction]:
    """Predict the errors of each configuration from a fit to the others.

    For a linear model the errors of those that were left out are M_cc^-1 (M r)_c, with
    the covariance M_cc^-1, and with M W_c in place of M r they follow what is
    considered (block deletion: Cook and Weisberg, Residuals and Influence in
    Regression, 1982, sec. 3.5). An offset that the same recording shows elsewhere is
    taken off.

    Args:
        linear: The fit.
    """
    whole, followed = linear.errors_left(), linear.left(linear.considered.values)
    predictions = []
    for c in np.unique(linear.pose):
        of_pose = linear.pose == c
        ones = np.eye(len(linear.r))[:, of_pose]
        block = linear.left(ones)[of_pose]
        square, U = np.linalg.eigh(block)
        # Where nothing is left, the others do not determine what the pose takes.
        seen = square > ROUNDING / linear.scale**2
        root = U[:, seen] / np.sqrt(square[seen])
        y, B = root.T @ whole[of_pose], root.T @ followed[of_pose]
        blind = np.any(np.abs(U[:, ~seen]) > RANK, axis=1)
        spread = root @ np.concatenate([np.eye(len(y)), B], axis=1)
        predictions.append(
            PosePrediction(
                error=np.where(blind, np.nan, root @ y),
                std=np.where(blind, np.nan, np.linalg.norm(spread, axis=1)),
                chi_squared=float(np.sum(whitened(B, y) ** 2)),
                degrees_of_freedom=int(seen.sum()),
            )
        )
    return predictions


def chance(
    squares: float, n: int, *, of: int | None = None, jitter_is_of_all: bool = False
) -> float:
    """Return the probability of a sum of squares as large.

    Args:
        squares: Sum of n squares, over their covariance.
        n: Its degrees of freedom.
        of: Degrees of freedom of the jitter if it was estimated; None if stated.
        jitter_is_of_all: Whether these squares are among those that it was estimated
            from; they are taken out.
    """
    if n == 0:
        return float("nan")
    if of is None:
        return float(chdtrc(n, squares))
    if not jitter_is_of_all:
        return float(fdtrc(n, of, squares / n))
    others = of - n
    if others < 1:
        return float("nan")
    rest = max(of - squares, 1e-12) / others
    return float(fdtrc(n, others, squares / n / rest))
