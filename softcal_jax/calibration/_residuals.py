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
from softcal_jax.calibration._noise import whitened
from softcal_jax.calibration._reml import Residuals, basis

UNSEEN = 1e-9
"""Eigenvalue, over the largest, below which a direction is only rounding [-]."""


ABSORBED = 1e-3
"""Eigenvalue, over the largest, below which parameters take up a shared error [-].

A modulus moves a pose almost along its motion; what is left beside it is curvature.
"""


class LinearFit:
    """A fit that is linear in its parameters: errors r + W dz, covariance V.

    With V = s^2 I + A A^T and the prior P the residuals have M = V^-1 - V^-1 W C W^T
    V^-1, C = (W^T V^-1 W + P)^-1.
    """

    def __init__(self, errors: Residuals, A: Float[HostArray, "n k"], jitter: float):
        """Prepare the products with M.

        Args:
            errors: The linearised errors, in stated noise units.
            A: Correlated columns of the noise, likewise.
            jitter: s.
        """
        self.errors, self._B, self._jitter = errors, A / jitter, jitter
        VW = self._by_noise(errors.W)
        information = errors.W.T @ VW + errors.W_prior.T @ errors.W_prior
        size = np.sqrt(np.maximum(np.diag(information), 1e-300))
        scaled = information / np.outer(size, size)
        C = np.linalg.pinv(scaled, rcond=UNSEEN, hermitian=True)
        self._VW, self._C = VW, C / np.outer(size, size)

    def _by_noise(self, x: Float[HostArray, "n ..."]) -> Float[HostArray, "n ..."]:
        """Compute V^-1 x."""
        return whitened(self._B, whitened(self._B, x)) / self._jitter**2

    def left(self, x: Float[HostArray, "n ..."]) -> Float[HostArray, "n ..."]:
        """Compute M x."""
        return self._by_noise(x) - self._VW @ (self._C @ (self._VW.T @ x))

    def errors_left(self) -> Float[HostArray, " n"]:
        """Compute V^-1 times the errors at the best dz."""
        own = self.errors
        slope = self._VW.T @ own.r + own.W_prior.T @ own.r_prior
        return self._by_noise(own.r) - self._VW @ (self._C @ slope)

    def jitter_freedom(self) -> float:
        """Return the degrees of freedom that an estimate of s^2 has, s^4 tr(M^2) [-].

        They are 2 s^4 over the variance of that estimate (Satterthwaite, Biometrics
        Bulletin 2, 1946): all residuals tell of the jitter if they are independent, and
        those that offsets cover hardly do.
        """
        Q = basis(np.concatenate([self.errors.W, self._B], axis=1))
        within = self._jitter**2 * (Q.T @ self.left(Q))
        return len(Q) - Q.shape[1] + float(np.sum(within**2))


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
    errors: Residuals,
    *,
    A: Float[HostArray, "n k"],
    W_c: Float[HostArray, "n n_errors"],
    Z: Float[HostArray, "n n_between"],
    lane: Int[HostArray, " n_between"],
    n_c: int,
) -> LackOfFit | None:
    """Test whether the errors of configurations have something in common.

    The jitter is that of the scatter within configurations, where neither parameters
    nor offsets nor shares of the motion reach. With it, offsets as stated and what is
    held fixed and may be wrong, the rest is compared by an F test.

    Args:
        errors: The linearised errors, in stated noise units.
        A: Correlated columns of the noise, likewise.
        W_c: Change of the errors per standard deviation of what is held fixed.
        Z: What the coordinates of a configuration may share: offsets, its motion.
        lane: Configuration of each column of Z.
        n_c: Number of configurations.

    Returns:
        The test; None where nothing is left on either side.
    """
    both = basis(np.concatenate([errors.W, Z], axis=1))
    rest = errors.r - both @ (both.T @ errors.r)
    within, level = len(errors.r) - both.shape[1], np.linalg.norm(errors.r)
    squares = float(rest @ rest)
    if within < 1 or not squares > (UNSEEN * level) ** 2:
        return None
    jitter = float(np.sqrt(squares / within))
    fit = LinearFit(errors, A, jitter)
    slope, seen = Z.T @ fit.errors_left(), Z.T @ fit.left(Z)
    by_others = Z.T @ fit.left(W_c)
    size = np.sqrt(np.maximum(np.diag(seen), 1e-300))
    scaled = (seen + by_others @ by_others.T) / np.outer(size, size)
    # Directions that the parameters take up are left out.
    square, U = np.linalg.eigh(seen / np.outer(size, size))
    U = U[:, square > ABSORBED * max(square, default=0.0)]
    between = U.shape[1]
    if between == 0:
        return None
    common = U @ np.linalg.solve(U.T @ scaled @ U, U.T @ (slope / size)) / size
    parts = np.array([np.sum((common * slope)[lane == c]) for c in range(n_c)])
    ratio = float(np.sum(parts)) / between
    return LackOfFit(
        ratio=ratio,
        between=between,
        within=within,
        probability=float(fdtrc(between, within, ratio)),
        jitter=jitter,
        shares=parts / max(float(np.sum(parts)), 1e-300),
    )


class Prediction(Module):
    """The errors of one configuration, as the others predict them.

    Attributes:
        error: Predicted minus measured, in stated noise units; nan where the others do
            not determine a parameter that it takes [-].
        std: Its standard deviation by noise, parameters and what is held fixed [-].
        chi_squared: Sum of squares of what can be predicted, over its covariance [-].
        degrees_of_freedom: Number of these.
    """

    error: Float[HostArray, " n"]
    std: Float[HostArray, " n"]
    chi_squared: float
    degrees_of_freedom: int


def left_out(
    errors: Residuals,
    *,
    A: Float[HostArray, "n k"],
    W_c: Float[HostArray, "n n_errors"],
    jitter: float,
    lane: Int[HostArray, " n"],
) -> list[Prediction]:
    """Predict the errors of each configuration from a fit to the others.

    For a linear model the errors of those that were left out are M_cc^-1 (M r)_c, with
    the covariance M_cc^-1, and with M W_c in place of M r they follow what is held
    fixed (block deletion: Cook and Weisberg, Residuals and Influence in Regression,
    1982, sec. 3.5). An offset that the same recording shows elsewhere is taken off.

    Args:
        errors: The linearised errors, in stated noise units.
        A: Correlated columns of the noise, likewise.
        W_c: Change of the errors per standard deviation of what is held fixed.
        jitter: Factor on the stated standard deviations.
        lane: Configuration of each row.
    """
    fit = LinearFit(errors, A, jitter)
    whole, followed = fit.errors_left(), fit.left(W_c)
    predictions = []
    for c in np.unique(lane):
        own = lane == c
        ones = np.zeros((len(lane), int(own.sum())))
        ones[own] = np.eye(ones.shape[1])
        block = fit.left(ones)[own]
        square, U = np.linalg.eigh(block)
        seen = square > UNSEEN / jitter**2
        root = U[:, seen] / np.sqrt(square[seen])
        y, B = root.T @ whole[own], root.T @ followed[own]
        blind = np.any(np.abs(U[:, ~seen]) > 1e-6, axis=1)
        spread = root @ np.concatenate([np.eye(len(y)), B], axis=1)
        predictions.append(
            Prediction(
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
