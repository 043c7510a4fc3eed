"""Statistics of residuals, linearised at the optimum: do they fit, and what is noise?

Where the jitter is estimated from the residuals, chi-squared looks right whatever the
model. Two questions remain. Are the residuals of a configuration alike, beyond what
independent jitter and the stated offsets make of them (lack of fit; Draper and Smith,
Applied Regression Analysis, 1998, sec. 2.1; Bates and Watts, Nonlinear Regression
Analysis, 1988, sec. 1.3.2)? And is each configuration predicted by the others?

The components of the noise are those of restricted maximum likelihood. The errors of a
fit, linear in its parameters, are r + W dz with the covariance
V = s_0^2 I + sum_i s_i^2 A_i A_i^T. The likelihood of what is left of r once dz has
been eliminated,

    -2 l = log|V| + log|W^T V^-1 W + P| + min_dz (r + W dz)^T V^-1 (r + W dz) + prior,

does not underestimate the variances, as the whole likelihood does (Patterson and
Thompson, Biometrika 58, 1971; Harville, J. Am. Stat. Assoc. 72, 1977). Without columns
A_i it gives s_0^2 = r^T r / (n - p), and for a balanced one-way layout the estimators
of the analysis of variance.
"""

from collections.abc import Sequence

import jax
import numpy as np
from scipy.special import chdtrc, fdtrc

from softcal_jax._module import Module
from softcal_jax._text import listed
from softcal_jax._typing import Array, Float, HostArray, Int
from softcal_jax._units import readable_unit
from softcal_jax.fields import ParameterSpace
from softcal_jax.inference._least_squares import RANK, determined, span, whitened
from softcal_jax.inference._linear_model import LinearModel
from softcal_jax.inference._uncertainty import UNLIKELY, Uncertainty

ABSORBED = 1e-3
"""Share of a common error of a configuration that the fit must leave to be tested [-].

This is no rank: a modulus moves a pose almost along its motion, and the little that the
fit leaves of such an error is curvature.
"""

ROUNDING = 1e-9
"""Size of residuals, over that of the errors before the fit, that is rounding [-]."""

NO_DIFFERENCE = 1e-6
"""Standard error of a difference that is rounding, over that of the values [-]."""

DETERMINED = 5.0
"""Standard error from which a recording alone does not determine a parameter [-].

In units of the error that is asked for by default: half the value of a modulus.
"""


REACH = float(np.log(1e4))
"""How far the logarithm of a factor of the noise may go from its first value [-]."""

SAME = 1e-6  # difference of -2 l that says nothing about a component [-]


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

    The jitter is that of the scatter within configurations, which neither parameters
    nor offsets nor shares of the motion explain. With this jitter, the stated offsets
    and the considered errors, an F test judges the scatter between configurations.
    None where nothing is left on either side.

    Args:
        linear: The fit.
        shared: What the coordinates of a configuration may share: offsets, its motion.
        pose: Configuration of each of these columns.
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
    """
    Q = span(np.concatenate([linear.W, linear.correlated.values], axis=1))
    within = linear.scale**2 * (Q.T @ linear.left(Q))
    return len(Q) - Q.shape[1] + float(np.sum(within**2))


class PosePrediction(Module):
    """The errors of one configuration, as the others predict them.

    Attributes:
        error: Predicted minus measured, in stated noise units; nan where the others do
            not determine a parameter that it depends on [-].
        std: Its standard deviation by noise, parameters and what is considered [-].
        chi_squared: Sum of squares of what can be predicted, over its covariance [-].
        degrees_of_freedom: Number of these squares.
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
    """
    whole, followed = linear.errors_left(), linear.left(linear.considered.values)
    predictions = []
    for c in np.unique(linear.pose):
        of_pose = linear.pose == c
        ones = np.eye(len(linear.r))[:, of_pose]
        block = linear.left(ones)[of_pose]
        square, U = np.linalg.eigh(block)
        # Errors of which the fit leaves only rounding are not predicted by the others.
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
    """Return the probability of a sum of n squares as large, over their covariance.

    Args:
        squares: The sum.
        n: Its degrees of freedom.
        of: Degrees of freedom of the jitter if it was estimated; None if stated.
        jitter_is_of_all: Whether it was estimated from these, too; they are taken out.
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


class RecordingEstimate(Module):
    """A parameter from one recording alone, to first order about the fit of all.

    Attributes:
        recording: Name of the recording.
        parameter: Name of the parameter.
        value: Its value from this recording, in SI.
        standard_error: Its standard error by all causes, in SI.
        fit: Its value from all recordings, in SI.
        apart: Difference from the fit of all, in standard errors of this difference.
            What both have in common, like an error of the loads, cancels in it; 0 for
            the only recording that was fitted [-].
        unit: SI unit.
        probability: Chance of a difference as large [-].
    """

    recording: str
    parameter: str
    value: float
    standard_error: float
    fit: float
    apart: float
    unit: str
    probability: float


def disagreeing(estimates: Sequence[RecordingEstimate]) -> list[RecordingEstimate]:
    """Return estimates too far from the fit for chance: `UNLIKELY` over all of them."""
    allowed = UNLIKELY / max(len(estimates), 1)
    return [e for e in estimates if e.probability < allowed]


def recording_estimates(
    linear: LinearModel,
    recordings: Sequence[str | None],
    *,
    space: ParameterSpace,
    z: Float[Array, " n_p"],
    asked: Float[HostArray, " n_p"],
    spread: Uncertainty,
) -> tuple[RecordingEstimate, ...]:
    """Estimate parameters from each recording alone, fitted or held out.

    With the gains G_k of one recording and G of all, their estimates differ by
    (G_k E_k - G) times the errors, where E_k selects its rows. The covariance of these
    errors is that of the noise, plus W_c W_c^T of what is considered.

    Returns none if the residuals show no noise, and none of a parameter that fewer than
    two recordings determine.

    Args:
        linear: The fit, with the rows of recordings that were held out.
        recordings: Recording of each configuration, None for those to leave out.
        space: The parameters.
        z: Where the fit ended, scaled [-].
        asked: Standard errors that are asked for, see `fields.asked_errors` [-].
        spread: Its uncertainty by the noise.
    """
    names = [name for name in dict.fromkeys(recordings) if name is not None]
    if not spread.has_noise or len(names) < 2:
        return ()
    of_row = np.array(recordings, object)[linear.pose]
    whole = np.nan_to_num(linear.gain())
    by_prior = np.nan_to_num(linear.covariance()) * linear.prior_weights
    jitter = np.eye(len(linear.r))
    noise = linear.scale * np.concatenate([jitter, linear.correlated.values], axis=1)
    per_error = np.concatenate([noise, linear.considered.values], axis=1)
    size = lambda L: np.linalg.norm(L @ per_error, axis=1)
    fits = np.asarray(space.from_scaled(jax.device_put(z)))
    slopes, optimum = space.slopes(z), np.asarray(z)
    estimates: dict[int, list[RecordingEstimate]] = {}
    for name in names:
        rows = of_row == name
        alone = linear.only(rows).by_data_alone().all_fitted()
        gain = np.zeros(whole.shape)
        gain[:, rows] = alone.gain()
        shift, std = -gain @ linear.r, size(gain)
        apart = np.hypot(size(gain - whole), np.linalg.norm(by_prior, axis=1))
        moved = jax.device_put(optimum + np.nan_to_num(shift))
        values = np.asarray(space.from_scaled(moved))
        # For the only recording that was fitted, the difference is mere rounding.
        different = apart > NO_DIFFERENCE * std
        shares = np.where(different, shift / np.where(different, apart, 1.0), 0.0)
        for i in np.flatnonzero(std < DETERMINED * asked):
            estimate = RecordingEstimate(
                recording=name,
                parameter=space.names[i],
                value=float(values[i]),
                standard_error=float(slopes[i] * std[i]),
                fit=float(fits[i]),
                apart=float(shares[i]),
                unit=space.parameters[i].unit,
                probability=spread.chance(float(shares[i])),
            )
            estimates.setdefault(int(i), []).append(estimate)
    return tuple(e for each in estimates.values() if len(each) > 1 for e in each)


def agreement_sentences(estimates: Sequence[RecordingEstimate]) -> list[str]:
    """Say for each parameter what recordings alone give, and whether they agree."""
    sentences, doubtful = [], disagreeing(estimates)
    for name in dict.fromkeys(e.parameter for e in estimates):
        of_name = [e for e in estimates if e.parameter == name]
        factor, unit = readable_unit([of_name[0].fit], of_name[0].unit)
        each = ", ".join(
            f"{e.recording} {factor * e.value:.4g} +- {factor * e.standard_error:.2g}"
            f" ({abs(e.apart):.1f} standard errors from the fit)"
            for e in of_name
        )
        far = [e.recording for e in of_name if e in doubtful]
        differ = f"; {listed(far)} disagree{'s' * (len(far) == 1)}" if far else ""
        head = f"{name} by each recording alone" + f" [{unit}]" * bool(unit)
        sentences.append(f"{head}: {each}{differ}.")
    return sentences


class _Reduced:
    """The noise in the space of W and the columns A_i; what is left is only jitter."""

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
