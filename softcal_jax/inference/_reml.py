"""Restricted maximum likelihood of the components of a noise.

The errors of a fit, linear in its parameters, are r + W dz with the covariance
V = s_0^2 I + sum_i s_i^2 A_i A_i^T. The likelihood of what is left of r once dz has
been eliminated,

    -2 l = log|V| + log|W^T V^-1 W + P| + min_dz (r + W dz)^T V^-1 (r + W dz) + prior,

does not underestimate the variances, as the whole likelihood does (Patterson and
Thompson, Biometrika 58, 1971; Harville, J. Am. Stat. Assoc. 72, 1977). Without columns
A_i it gives s_0^2 = r^T r / (n - p), and for a balanced one-way layout the estimators
of the analysis of variance.
"""

from collections.abc import Sequence

import numpy as np

from softcal_jax._typing import Float, HostArray
from softcal_jax.inference._least_squares import determined, span
from softcal_jax.inference._linear_model import LinearModel

REACH = float(np.log(1e4))
"""How far the logarithm of a factor may go from its first value [-]."""

SAME = 1e-6  # difference of -2 l that says nothing about a component [-]


class _Reduced:
    """The same problem in the space of W and the columns; the rest is only jitter."""

    def __init__(self, linear: LinearModel, columns: Sequence[HostArray]):
        free = ~linear.held
        W, W_prior = linear.W[:, free], np.diag(linear.prior_weights[free])
        # Directions of the parameters that nothing determines do not count.
        seen = determined(np.concatenate([W, W_prior])).factor
        Q = span(np.concatenate([W, *columns], axis=1))
        self.W, self.W_prior = Q.T @ W @ seen, W_prior @ seen
        self.prior, self.y = linear.from_prior[free], Q.T @ linear.r
        self.blocks = [np.eye(Q.shape[1])]
        self.blocks += [(Q.T @ A) @ (Q.T @ A).T for A in columns]
        self.beside = len(linear.r) - Q.shape[1]
        rest = linear.r - Q @ self.y
        self.rest = float(rest @ rest)

    def criterion(self, variances: Float[HostArray, " n"]):
        """Return -2 l, and its derivatives in the variances."""
        V = sum(v * B for v, B in zip(variances, self.blocks, strict=True))
        inverse = np.linalg.inv(V)
        VW = inverse @ self.W
        information = self.W.T @ VW + self.W_prior.T @ self.W_prior
        C = np.linalg.inv(information)
        dz = -C @ (VW.T @ self.y + self.W_prior.T @ self.prior)
        left, apart = self.y + self.W @ dz, self.prior + self.W_prior @ dz
        u = inverse @ left
        value = np.linalg.slogdet(V)[1] + np.linalg.slogdet(information)[1]
        value += float(left @ u) + float(apart @ apart)
        value += self.beside * np.log(variances[0]) + self.rest / variances[0]
        projected = inverse - VW @ C @ VW.T
        slopes = [np.sum(projected * B) - u @ B @ u for B in self.blocks]
        slopes[0] += self.beside / variances[0] - self.rest / variances[0] ** 2
        return value, np.array(slopes)


def restricted_likelihood(
    linear: LinearModel,
    columns: Sequence[Float[HostArray, "_ _"]],
    factors: Sequence[float],
    free: Sequence[bool],
) -> list[float]:
    """Find factors on standard deviations that make the residuals most likely.

    Args:
        linear: The fit; its own correlated errors do not count.
        columns: Columns A_i of each correlated component, for a factor of one.
        factors: First values of all factors: that of the jitter, then of `columns` [-].
        free: Which of them are estimated; the others stay.

    Returns:
        All factors; 0 where the residuals show nothing of a component.
    """
    # Here, so that commands which do not need it do not wait for it.
    from scipy.optimize import minimize

    reduced, start = _Reduced(linear, columns), np.array(factors, float)
    which = np.flatnonzero(free)
    # Among the residuals that no column explains the jitter is alone.
    if free[0] and reduced.beside > 0 and reduced.rest > 0.0:
        start[0] = np.sqrt(reduced.rest / reduced.beside)

    def of_logarithms(logs):
        variances = start**2
        variances[which] = np.exp(2.0 * logs)
        value, slopes = reduced.criterion(variances)
        return value, 2.0 * slopes[which] * variances[which]

    first = np.log(start[which])
    optimum = minimize(
        of_logarithms,
        first,
        jac=True,
        method="L-BFGS-B",
        bounds=[(log - REACH, log + REACH) for log in first],
        options={"ftol": 1e-15, "gtol": 1e-10, "maxiter": 500},
    )
    result = start.copy()
    result[which] = np.exp(optimum.x)
    lowest = optimum.fun
    for i in which[which > 0]:
        # The logarithm never reaches zero.
        without = np.where(np.arange(len(result)) == i, 0.0, result)
        value, _ = reduced.criterion(without**2)
        if value <= lowest + SAME:
            result, lowest = without, value
    return [float(factor) for factor in result]


def freedom_between(linear: LinearModel, A: Float[HostArray, "n k"]) -> tuple[int, int]:
    """Count the residual directions that show columns A, and those free of them."""
    W = linear.W[:, ~linear.held]
    rank = span(np.concatenate([W, A], axis=1)).shape[1]
    return rank - span(W).shape[1], len(linear.r) - rank
