"""The one linear model of a fit, of which everything statistical is a function.

After an equilibrium, every measured coordinate is off by

    r + W dz + W_c dc + e,   cov e = s^2 (I + B B^T),

with the fitted unknowns z (Eq. 9), what is considered and not fitted, dc with unit
variance (Schmidt, Adv. Control Systems 3, 1966; Tapley, Schutz, Born, Statistical
Orbit Determination, 2004, ch. 6), and noise e of which the columns B are marginalised.
Priors of z are rows of their own. The best dz, its covariance by each cause, what is
left of r, and what any subset of rows would give follow by generalised least squares
(Seber and Wild, Nonlinear Regression, 1989, sec. 2.1.4).
"""

from dataclasses import replace
from functools import cached_property

import numpy as np

from softcal_jax._module import Module
from softcal_jax._text import check_known
from softcal_jax._typing import Bool, Float, HostArray, Int
from softcal_jax.inference._least_squares import (
    Determined,
    Whitened,
    determined,
    span,
    whitened,
    whitened_rows,
)

NOISE = "noise"
"""Name of the cause "independent errors" in the budget, the jitter."""

ATTACHMENTS = "attachments"
"""Name of the unknown offsets of points and frames whose displacement is fitted.

They are no cause of an error: a fit to displacements does not feel them.
"""


class ErrorColumns(Module):
    """Errors of several causes: change of each row per standard deviation of an error.

    Attributes:
        values: One column per error, in stated standard deviations of the rows [-].
        causes: What each error is counted under, like "loads".
        names: Name of each, like "load_factor tip".
    """

    values: Float[HostArray, "n n_errors"]
    causes: tuple[str, ...] = ()
    names: tuple[str, ...] = ()

    def of(self, cause: str) -> Float[HostArray, "n n_of_cause"]:
        """Return the columns of one cause."""
        return self.values[:, [column_cause == cause for column_cause in self.causes]]

    def only(self, rows: Bool[HostArray, " n"]) -> "ErrorColumns":
        """Return some of the rows, and of the errors those that change them."""
        values = self.values[rows]
        used = np.flatnonzero(np.any(values != 0.0, axis=0))
        causes = tuple(self.causes[k] for k in used)
        names = tuple(self.names[k] for k in used)
        return ErrorColumns(values[:, used], causes, names)


def no_errors(n: int) -> ErrorColumns:
    """Return columns of no error for `n` rows."""
    return ErrorColumns(np.zeros((n, 0)))


class LinearModel(Module):
    """Errors of measured coordinates to first order in every unknown; see the module.

    Attributes:
        names: The fitted unknowns.
        poses: The configurations.
        pose: Index of the configuration of each row.
        fitted: Which rows were fitted; the others, of configurations that were held
            out, have no weight.
        r: Simulated minus measured values, in stated standard deviations [-].
        W: Their change per unit of lambda_p [-].
        correlated: Errors that are marginalised: offsets of recordings, creep,
            mountings of markers; per `scale` of the noise.
        considered: Errors that are considered.
        scale: s, the standard deviation of independent errors over the stated one [-].
        from_prior: Distances from the priors, in their standard deviations [-].
        prior_weights: 1 / standard deviations of the priors, 0 without one [-].
        held: Unknowns on a bound; they count as known.
    """

    names: tuple[str, ...]
    poses: tuple[str, ...]
    pose: Int[HostArray, " n"]
    fitted: Bool[HostArray, " n"]
    r: Float[HostArray, " n"]
    W: Float[HostArray, "n n_p"]
    correlated: ErrorColumns
    considered: ErrorColumns
    scale: float
    from_prior: Float[HostArray, " n_p"]
    prior_weights: Float[HostArray, " n_p"]
    held: Bool[HostArray, " n_p"]

    def only(self, rows: Bool[HostArray, " n"]) -> "LinearModel":
        """Return the model of some rows alone, and of the errors that change them."""
        cut = {name: getattr(self, name)[rows] for name in ("pose", "fitted", "r", "W")}
        return replace(
            self,
            **cut,
            correlated=self.correlated.only(rows),
            considered=self.considered.only(rows),
        )

    def without(self, *poses: str) -> "LinearModel":
        """Return the model as if configurations had not been measured.

        Raises:
            ValueError: If there is no configuration of such a name.
        """
        check_known("configuration", self.poses, *poses)
        left_out = [self.poses.index(name) for name in poses]
        return self.only(~np.isin(self.pose, left_out))

    def of_fit(self) -> "LinearModel":
        """Return the model of the fitted rows."""
        return self if self.fitted.all() else self.only(self.fitted)

    def per(self, unit: Float[HostArray, " n_p"]) -> "LinearModel":
        """Return the model with unknowns in other units, given per lambda_p [-]."""
        return replace(self, W=self.W * unit, prior_weights=self.prior_weights * unit)

    def by_data_alone(self) -> "LinearModel":
        """Return the model without priors."""
        none = np.zeros(len(self.names))
        return replace(self, from_prior=none, prior_weights=none)

    def all_fitted(self) -> "LinearModel":
        """Return the model as if all of its rows were fitted."""
        return replace(self, fitted=np.ones(len(self.r), bool))

    def with_scale(self, scale: float) -> "LinearModel":
        """Return the model with another `scale` of all errors of the noise [-]."""
        return replace(self, scale=scale)

    def with_free(self, *columns: int) -> "LinearModel":
        """Return the model with unknowns free, all by default, on a bound or not."""
        held = self.held.copy()
        held[list(columns) or slice(None)] = False
        return replace(self, held=held)

    def with_jitter(self, scale: float) -> "LinearModel":
        """Return the model with another `scale` of independent errors alone [-]."""
        per_scale = self.correlated.values * (self.scale / scale)
        correlated = replace(self.correlated, values=per_scale)
        return replace(self, scale=scale, correlated=correlated)

    def whiten(self, x: Float[HostArray, "n ..."]) -> Float[HostArray, "n ..."]:
        """Compute (I + B B^T)^-1/2 x: errors become independent, of size s each."""
        return whitened(self.correlated.values, x)

    def whitened(self) -> Whitened:
        """Return rows of fitted data and of priors, each of standard deviation s."""
        fit = self.of_fit()
        return whitened_rows(
            fit.correlated.values,
            error=fit.r,
            W=fit.W,
            from_prior=self.scale * self.from_prior,
            prior_rows=self.scale * np.diag(self.prior_weights),
        )

    def squares(self) -> float:
        """Compute the sum of squared errors of data and priors, in units of s [-]."""
        return float(np.sum(self.whitened().error ** 2)) / self.scale**2

    def slope(self) -> Float[HostArray, " n_p"]:
        """Compute half the derivative of `squares` by the unknowns [-]."""
        error, W = map(np.asarray, self.whitened())
        return W.T @ error / self.scale**2

    def curvature(self) -> Float[HostArray, "n_p n_p"]:
        """Compute half the second derivative of `squares`: W^T V^-1 W + P [-]."""
        W = np.asarray(self.whitened().W)
        return W.T @ W / self.scale**2

    @property
    def n_data(self) -> int:
        """Number of fitted coordinates, less those used up by attachments."""
        fit = self.of_fit()
        return len(fit.r) - span(fit.correlated.of(ATTACHMENTS)).shape[1]

    @cached_property
    def _free(self) -> Int[HostArray, " n_free"]:
        return np.flatnonzero(~self.held)

    @cached_property
    def solution(self) -> Determined:
        """What the rows of fitted data and priors determine of the free unknowns."""
        return determined(np.asarray(self.whitened().W)[:, self._free])

    @cached_property
    def known(self) -> Bool[HostArray, " n_p"]:
        """Which unknowns have a standard error: free, and in no unseen direction."""
        known = np.zeros(len(self.names), bool)
        known[self._free] = ~self.solution.blind
        return known

    def covariance(self, cause: str = "") -> Float[HostArray, "n_p n_p"]:
        """Compute C = (W^T V^-1 W + P)^-1: that by noise and priors [-].

        Given a cause, compute that by this one alone; see `deviations`. NaN for
        unknowns that have no standard error.

        Raises:
            ValueError: If there is no such cause.
        """
        if cause:
            by_cause = self.deviations()
            check_known("cause", by_cause, cause)
            return by_cause[cause] @ by_cause[cause].T
        C = np.full((len(self.names),) * 2, np.nan)
        F = self.solution.factor[~self.solution.blind]
        C[np.ix_(self.known, self.known)] = self.scale**2 * F @ F.T
        return C

    def pull(self) -> Float[HostArray, "n_p n"]:
        """Compute C W^T V^-1 along directions that are seen; zero for held-out rows."""
        fit, solution = self.of_fit(), self.solution
        of_data = solution.basis[: len(fit.r)]
        pull = np.zeros((len(self.names), len(self.r)))
        pull[np.ix_(self._free, self.fitted)] = solution.factor @ fit.whiten(of_data).T
        return pull

    def gain(self) -> Float[HostArray, "n_p n"]:
        """Compute G = C W^T V^-1: if the rows change by d, the estimate moves by -G d.

        NaN for unknowns that have no standard error; zero for rows that are held out.
        """
        return np.where(self.known[:, None], self.pull(), np.nan)

    def step(self) -> Float[HostArray, " n_p"]:
        """Compute the dz that minimises the errors; NaN for what is not known [-]."""
        dz, solution = np.full(len(self.names), np.nan), self.solution
        error = self.whitened().error
        dz[self._free] = -solution.factor @ (solution.basis.T @ error)
        dz[~self.known] = np.nan
        return dz

    def deviations(self) -> dict[str, Float[HostArray, "n_p n_errors"]]:
        """Compute how far each error moves the unknowns, by cause [-].

        Per standard deviation of each, NaN where there is no standard error. The jitter
        and what the priors leave come first, as `NOISE`; then marginalised errors, then
        considered ones. Their squares sum to the covariance by all causes.
        """
        gain = self.gain()
        by_prior = np.nan_to_num(self.covariance()) * self.prior_weights
        by_prior[~self.known] = np.nan
        parts = {NOISE: np.concatenate([self.scale * gain, by_prior], axis=1)}
        for columns, size in ((self.correlated, self.scale), (self.considered, 1.0)):
            for cause in dict.fromkeys(columns.causes):
                if cause != ATTACHMENTS:
                    parts[cause] = -size * gain @ columns.of(cause)
        return parts

    def standard_errors(self) -> Float[HostArray, " n_p"]:
        """Compute the standard errors of the unknowns by all causes, scaled [-]."""
        parts = [*self.deviations().values()]
        return np.linalg.norm(np.concatenate(parts, axis=1), axis=1)

    def left(self, x: Float[HostArray, "n ..."]) -> Float[HostArray, "n ..."]:
        """Compute M x, M = V^-1 - V^-1 W C W^T V^-1: what the fit leaves of rows.

        All rows must be fitted.
        """
        white = self.whiten(x)
        of_data = self.solution.basis[: len(self.r)]
        return self.whiten(white - of_data @ (of_data.T @ white)) / self.scale**2

    def considered_covariance(self) -> Float[HostArray, "n_errors n_errors"]:
        """Compute (I + W_c^T M W_c)^-1: of the considered errors, were they fitted.

        All rows must be fitted.
        """
        W_c = self.considered.values
        return np.linalg.inv(np.eye(W_c.shape[1]) + W_c.T @ self.left(W_c))

    def chi_squared(self) -> tuple[float, int]:
        """Compute the squares left with all errors counted, and their number [-].

        e^T M e - b^T (I + W_c^T M W_c)^-1 b with b = W_c^T M e: the matrix inversion
        lemma, for a covariance with considered errors. All rows must be fitted.
        """
        error, basis = np.asarray(self.whitened().error), self.solution.basis
        squares = float(np.sum((error - basis @ (basis.T @ error)) ** 2))
        b = self.considered.values.T @ self.errors_left()
        n = self.n_data + int(np.sum(self.prior_weights != 0.0)) - basis.shape[1]
        return squares / self.scale**2 - float(b @ self.considered_covariance() @ b), n

    def errors_left(self) -> Float[HostArray, " n"]:
        """Compute V^-1 times the errors at the best dz; all rows must be fitted."""
        error, basis = np.asarray(self.whitened().error), self.solution.basis
        rest = (error - basis @ (basis.T @ error))[: len(self.r)]
        return self.whiten(rest) / self.scale**2


def independent(
    W: Float[HostArray, "n n_p"],
    names: tuple[str, ...],
    *,
    r: Float[HostArray, " n"] | None = None,
    scale: float = 1.0,
) -> LinearModel:
    """Make the model of one configuration with independent errors and no prior.

    Args:
        W: Compliances in stated standard deviations, per unit of lambda_p [-].
        names: The unknowns.
        r: Errors likewise; 0 by default [-].
        scale: Standard deviation of the errors over the stated one [-].
    """
    n, n_p = W.shape
    return LinearModel(
        names=names,
        poses=("",),
        pose=np.zeros(n, int),
        fitted=np.ones(n, bool),
        r=np.zeros(n) if r is None else r,
        W=W,
        correlated=no_errors(n),
        considered=no_errors(n),
        scale=scale,
        from_prior=np.zeros(n_p),
        prior_weights=np.zeros(n_p),
        held=np.zeros(n_p, bool),
    )
