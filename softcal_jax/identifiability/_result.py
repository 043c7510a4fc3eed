"""What data can tell about the parameters: the result and its text."""

import math

import numpy as np

from softcal_jax._module import Module, Result
from softcal_jax._typing import Float, HostArray
from softcal_jax.identifiability._spread import (
    WEAK_UP_TO,
    Conditioning,
    Direction,
    Spread,
    Verdict,
)
from softcal_jax.inference import ErrorBudget


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
    def headline(self) -> str:
        """The verdict in a sentence."""
        n_data, n_p = self.n_data, self.n_parameters
        return (
            f"{self.verdict.capitalize()} at these values: {n_data} measured "
            f"coordinate{'s' * (n_data != 1)} for {n_p} parameter{'s' * (n_p != 1)}."
        )

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

    def _words(self) -> str:
        return self.headline

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
