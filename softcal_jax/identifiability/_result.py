"""What data can tell about the parameters (Sec. V-C), and how evenly."""

import math
from collections.abc import Sequence
from typing import Literal

import numpy as np

from softcal_jax._module import Module, Result
from softcal_jax._text import listed
from softcal_jax._typing import Bool, Float, HostArray
from softcal_jax.fields import WEAK_UP_TO
from softcal_jax.inference import RANK, ErrorBudget, LinearModel

Verdict = Literal["identifiable", "weakly identifiable", "not identifiable"]

IDENTIFIABLE_UP_TO = 1.0
"""Standard error, over the asked one, up to which a parameter is identifiable [-]."""

SHARE = 0.1
"""Squared component of a unit vector from which on its parameter is named [-]."""

MOST_NAMED = 4  # most parameters named for a direction, so that its text stays readable

LOST = 30.0
"""Standard error, over the asked one, above which a direction counts as unseen [-].

Three times a value or more is no knowledge of it, so such directions are
interchangeable and any basis of their span is as good as another.
"""


class Conditioning(Module):
    """How evenly the data see the parameters.

    Attributes:
        singular_values: Singular values of the noise-weighted W_ep, descending; 0 where
            there are fewer data than parameters [-].
        directions: Right singular vectors V as columns: directions of lambda_p. The
            last ones are what the data see least (the paper says U, which holds
            effector directions).
        condition_weighted: Condition number of the noise-weighted W_ep [-].
        condition_W_ep: Condition number of W_ep in metres; nan if not given [-].
        condition_W_ep_W_pp: Condition number of W_ep W_pp^-1 in metres per joule, as in
            Table I; nan if not given [-].
    """

    singular_values: Float[HostArray, " n_p"]
    directions: Float[HostArray, "n_p n_p"]
    condition_weighted: float
    condition_W_ep: float
    condition_W_ep_W_pp: float

    def __str__(self) -> str:
        """Condition numbers, in one line."""
        numbers = {
            "W_ep in noise units": self.condition_weighted,
            "W_ep": self.condition_W_ep,
            "W_ep W_pp^-1": self.condition_W_ep_W_pp,
        }
        shown = [f"{k} {v:.3g}" for k, v in numbers.items() if not np.isnan(v)]
        return f"Condition: {', '.join(shown)}."


def conditioning(
    W: Float[HostArray, "n_e n_p"],
    *,
    W_ep: Float[HostArray, "n_e n_p"] | None = None,
    W_pp: Float[HostArray, "n_p n_p"] | None = None,
) -> Conditioning:
    """Compute the SVD W = U Sigma V^T and condition numbers; Sec. V-C.

    Statistics need W in units of the noise. The paper gives the numbers of W_ep and
    W_ep W_pp^-1 with W_ep in metres, which depend on the scaling S of the parameters.
    The paper does not say how W_pp is stacked over configurations: here it is the sum
    of H_p K_c^-1 H_p^T, since all configurations share lambda_p and energies add up.
    A condition number is infinite where a singular value is zero (to rounding): fewer
    data than parameters, or a blind direction.

    Args:
        W: Compliances stacked over configurations, in units of the noise [-].
        W_ep: The same in metres [m].
        W_pp: Sum over configurations of H_p K_c^-1 H_p^T [J].
    """
    if not np.all(np.isfinite(W)):
        raise ValueError(
            "W_ep has entries that are not finite: a configuration had no equilibrium."
        )
    _, singular, Vt = np.linalg.svd(W)
    peak = np.argmax(np.abs(Vt), axis=1)
    signs = np.sign(Vt[np.arange(len(Vt)), peak])
    per_joule = np.nan
    if W_ep is not None and W_pp is not None:
        per_joule = _condition_per_joule(W_ep, W_pp)
    return Conditioning(
        singular_values=np.pad(singular, (0, W.shape[1] - len(singular))),
        directions=(signs[:, None] * Vt).T,
        condition_weighted=_condition(W),
        condition_W_ep=np.nan if W_ep is None else _condition(W_ep),
        condition_W_ep_W_pp=per_joule,
    )


def _condition(W: Float[HostArray, "n_e n_p"]) -> float:
    """Divide the largest by the smallest singular value; infinite below full rank.

    Only a deficit at rounding counts: a large number is reported as it is.
    """
    full = np.linalg.matrix_rank(W) == W.shape[1]
    return float(np.linalg.cond(W)) if full else np.inf


def _condition_per_joule(
    W_ep: Float[HostArray, "n_e n_p"], W_pp: Float[HostArray, "n_p n_p"]
) -> float:
    """Compute the condition number of W_ep W_pp^-1; infinite for a singular W_pp."""
    size = np.sqrt(np.maximum(np.diag(W_pp), 0.0))
    if not np.all(size > 0.0):
        return np.inf
    # Scale to a unit diagonal, so that a small scale does not look like blindness.
    unit = W_pp / np.outer(size, size)
    if np.linalg.matrix_rank(unit, hermitian=True) < len(size):
        return np.inf
    return _condition(np.linalg.solve(unit, (W_ep / size).T).T / size)


class Direction(Module):
    """A combination of parameters, and how well the data see it.

    Attributes:
        components: Its unit vector, in units of the asked standard errors [-].
        ratio: Largest standard error, over the asked one, that it alone gives to a
            parameter; infinite where neither data nor prior see it [-].
        verdict: Verdict on the ratio.
        words: Its main parameters, in words.
    """

    components: Float[HostArray, " n_p"]
    ratio: float
    verdict: Verdict
    words: str


class Spread(Module):
    """Covariance of parameters in units of their asked standard errors.

    Attributes:
        factor: F of the covariance F F^T, which holds along what is seen [-].
        unseen: Orthonormal directions that neither data nor prior see, as rows [-].
        blind: Parameters with a component in one of these.
    """

    factor: Float[HostArray, "n_p n"]
    unseen: Float[HostArray, "n_unseen n_p"]
    blind: Bool[HostArray, " n_p"]

    def errors(self) -> Float[HostArray, " n_p"]:
        """Return standard errors of the parameters, infinite for blind ones [-]."""
        return np.where(self.blind, np.inf, np.linalg.norm(self.factor, axis=1))

    def along(self, rows: Float[HostArray, "n n_p"]) -> Float[HostArray, " n"]:
        """Return standard errors of linear functions of the parameters [-].

        `rows` are their derivatives by the parameters, in units of the asked errors.
        """
        size = np.linalg.norm(rows, axis=1)
        astray = np.linalg.norm(rows @ self.unseen.T, axis=1) > RANK * size
        return np.where(astray, np.inf, np.linalg.norm(rows @ self.factor, axis=1))


def verdict(ratio: float) -> Verdict:
    """Judge a standard error over the asked one [-]."""
    if ratio <= IDENTIFIABLE_UP_TO:
        return "identifiable"
    return "weakly identifiable" if ratio <= WEAK_UP_TO else "not identifiable"


def spread_of(linear: LinearModel) -> Spread:
    """Compute the covariance of an estimate from data and priors.

    It is the covariance C by noise and priors, plus D D^T with D = -G W_c by considered
    errors, as in `ErrorBudget`. Bounds are no measurement: a direction that neither
    data nor prior see has no finite error. Unknowns are in units of their asked
    standard errors, so that moduli and angles are comparable.
    """
    seen = linear.solution
    moved = -linear.pull() @ linear.considered.values
    factor = np.concatenate([linear.scale * seen.factor, moved], axis=1)
    return Spread(factor, seen.unseen, seen.blind)


def information(linear: LinearModel) -> Float[HostArray, "n_p n_p"]:
    """Compute the information of the data alone: an inverse covariance, without priors.

    W^T U (I + B B^T)^-1 U^T W with whitened W = U S V^T and B = U^T W_c, which exists
    where the covariance does not.
    """
    fit = linear.of_fit()
    W, W_c = (fit.whiten(x) / fit.scale for x in (fit.W, fit.considered.values))
    U, singular, Vt = np.linalg.svd(W, full_matrices=False)
    B = U.T @ W_c
    A = singular[:, None] * Vt
    return A.T @ np.linalg.solve(np.eye(len(B)) + B @ B.T, A)


def named_directions(spread: Spread, names: Sequence[str]) -> tuple[Direction, ...]:
    """Find the principal directions of a covariance, best seen first (Sec. V-C).

    If only the noise is uncertain, they are right singular vectors of the whitened W.
    The unseen directions have an arbitrary basis; it is replaced by one whose vectors
    each follow few parameters.
    """
    *_, basis = np.linalg.svd(spread.unseen)
    within = basis[len(spread.unseen) :]
    V, std, _ = np.linalg.svd(within @ spread.factor, full_matrices=False)
    rows = V.T @ within
    far = std * np.max(np.abs(rows), axis=1, initial=0.0) > LOST
    lost = np.concatenate([rows[far], spread.unseen])
    rows = np.concatenate([rows[~far], _separated(lost) if len(lost) else lost])
    ratios = spread.along(rows) * np.max(np.abs(rows), axis=1, initial=0.0)
    directions = []
    for row in np.argsort(ratios, kind="stable"):
        v = rows[row] * np.sign(rows[row, np.argmax(np.round(np.abs(rows[row]), 6))])
        ratio = float(ratios[row])
        words = direction_words(v, names)
        directions.append(Direction(v, ratio, verdict(ratio), words))
    return tuple(directions)


def _separated(V: Float[HostArray, "n n_p"]) -> Float[HostArray, "n n_p"]:
    """Find orthonormal rows of the same span, each close to one parameter.

    With P the projector on the span, P e_i is its vector closest to parameter i. The
    longest is taken first and removed from P (a QR with column pivoting).
    """
    P = V.T @ V
    rows = []
    for _ in V:
        pivot = np.argmax(np.round(np.diag(P), 6))
        rows.append(P[pivot] / np.linalg.norm(P[pivot]))
        P = P - np.outer(rows[-1], rows[-1])
    return np.stack(rows)


def direction_words(v: Float[HostArray, " n_p"], names: Sequence[str]) -> str:
    """Describe a unit vector, as in "E_t of CP 1 up while theta of CP 2 down".

    Parameters with a squared component of at least `SHARE` are named, the largest
    first, or the largest few if there are none.
    """
    # Rounded, so that equal components keep the order of the parameters.
    order = sorted(range(len(v)), key=lambda i: -round(float(v[i] ** 2), 6))
    large = [i for i in order if v[i] ** 2 >= SHARE] or order
    named, more = large[:MOST_NAMED], len(large[MOST_NAMED:])
    sign = np.sign(v[named[0]])
    up = [names[i] for i in named if v[i] * sign > 0]
    down = [names[i] for i in named if v[i] * sign < 0]
    rest = f" and {more} more" if more > 0 else ""
    if down:
        return f"{listed(up)} up while {listed(down)} down{rest}"
    together = " up together" if len(up) > 1 or rest else ""
    return f"{listed(up)}{rest}{together}"


class ParameterOutlook(Module):
    """How well one parameter can be determined, in SI units.

    Attributes:
        name: Its name.
        value: Value at which it was judged.
        standard_error: Predicted from the data and its prior, if it has one; infinite
            where neither sees it.
        data_only: Predicted from the data alone.
        prior: Standard deviation of its stated prior; None without one.
        asked: Standard error that is asked for, see `asked_errors`.
        relative: Standard error over value [-]; None for an angle or a value of zero.
        ratio: Standard error over the asked one [-].
        verdict: Verdict on the ratio.
        unit: SI unit.
    """

    name: str
    value: float
    standard_error: float
    data_only: float
    prior: float | None
    asked: float
    relative: float | None
    ratio: float
    verdict: Verdict
    unit: str


class Identifiability(Result):
    """What data can tell about the parameters, to first order at one value of them.

    Attributes:
        verdict: Verdict on the worst parameter.
        parameters: One entry per parameter.
        directions: From the best to the worst seen.
        spread: Covariance of the parameters in units of the asked standard errors.
        asked: Asked standard errors of the scaled parameters [-].
        precision: Standard error that is asked for, relative to the value [-].
        has_prior: Whether a parameter has a stated prior, which counts like a
            measurement.
        informed: Number of directions along which the data tell more than the prior;
            without one, enough for "weakly identifiable".
        conditioning: Singular values and condition numbers.
        n_data: Number of measured coordinates.
        budget: Standard errors split by cause, before anything is measured; afterwards
            it is that of the calibration.
    """

    verdict: Verdict
    parameters: tuple[ParameterOutlook, ...]
    directions: tuple[Direction, ...]
    spread: Spread
    asked: Float[HostArray, " n_p"]
    precision: float
    has_prior: bool
    informed: int
    conditioning: Conditioning
    n_data: int
    budget: ErrorBudget | None = None

    @property
    def covariance(self) -> Float[HostArray, "n_p n_p"]:
        """Covariance of the scaled parameters; inf for blind ones, nan with others."""
        factor, blind = self.spread.factor, self.spread.blind
        full = factor @ factor.T * np.outer(self.asked, self.asked)
        full[blind] = full[:, blind] = np.nan
        full[blind, blind] = np.inf
        return full

    @property
    def n_parameters(self) -> int:
        """Number of parameters."""
        return len(self.parameters)

    @property
    def correlation(self) -> Float[HostArray, "n_p n_p"]:
        """Correlation of the parameters [-]; nan for those that nothing sees."""
        std = np.sqrt(np.diag(self.covariance))
        with np.errstate(invalid="ignore"):  # infinite over infinite
            return self.covariance / np.outer(std, std)

    @property
    def blind(self) -> tuple[Direction, ...]:
        """The directions that are not identifiable, the worst last."""
        return tuple(d for d in self.directions if d.verdict == "not identifiable")

    @property
    def advice(self) -> tuple[str, ...]:
        """What to do, in sentences; empty if nothing needs to be done."""
        if self.n_data == 0:
            return ("Nothing is measured: add markers to the configurations.",)
        if self.verdict == "identifiable":
            return ()
        worst = max(self.parameters, key=lambda p: p.ratio)
        if self.budget is not None and math.isfinite(worst.ratio):
            advice = self.budget.advice(worst.name)
            return (advice[0].upper() + advice[1:],)
        missing, first = self.n_parameters - self.n_data, ""
        if missing > 0:
            more = f"{missing} measured coordinate{'s' * (missing > 1)}"
            first = f"The data lack at least {more}. "
        return (
            f"{first}Add a configuration (another load or orientation, the other end "
            "clamped) or markers: `softcal identify` says which. Or calibrate fewer "
            "parameters.",
        )

    @property
    def scale(self) -> str:
        """What the verdicts mean, in words."""
        text = (
            "Identifiable: standard error at most the target (precision "
            f"{self.precision:g}); weakly identifiable: at most {WEAK_UP_TO:g} times "
            "the target. Bounds do not count as data."
        )
        if self.has_prior:
            text += " A stated prior counts as a measurement."
        return text
