"""Models compared: scores of their folds, ranking, paired differences, the text."""

from collections.abc import Sequence

import numpy as np
from scipy.special import stdtrit

from softcal_jax._module import Module, Result
from softcal_jax._typing import HostArray
from softcal_jax.identifiability import Identifiability

LEVEL_OF_COMPARISON = 0.95
"""Probability at which two models are told apart [-]."""


class FoldScore(Module):
    """One configuration held out.

    Attributes:
        held_out: Its name.
        rms: Root mean square of the distances of its markers from their prediction; nan
            if the fold failed [m].
        noise_rms: The same for its measured coordinates, in units of the noise [-].
        fit_rms: Root mean square distance of the fitted markers [m].
        failure: Why the fold failed; empty if it did not.
    """

    held_out: str
    rms: float
    noise_rms: float
    fit_rms: float
    failure: str = ""


class ModelScore(Module):
    """Cross-validation of one model: of a layout of control points, a law or a mesh.

    Attributes:
        name: Its name.
        n_parameters: Number of parameters.
        folds: One entry per configuration.
        fit_rms: Root mean square marker distance with all configurations fitted; nan if
            that fit failed [m].
        fit_noise_rms: The same in units of the noise, per measured coordinate [-].
        fit_failure: Why the fit to all configurations failed; empty if it did not.
        identifiability: Identifiability from all configurations, with the stated noise,
            at the end of the fit to all; None if one of them has no equilibrium there.
    """

    name: str
    n_parameters: int
    folds: tuple[FoldScore, ...]
    fit_rms: float
    fit_noise_rms: float
    fit_failure: str
    identifiability: Identifiability | None

    @property
    def failed(self) -> tuple[FoldScore, ...]:
        """The folds that failed; they count in no average."""
        return tuple(fold for fold in self.folds if fold.failure)

    @property
    def good(self) -> tuple[FoldScore, ...]:
        """The folds that did not fail."""
        return tuple(fold for fold in self.folds if not fold.failure)

    @property
    def held_out_rms(self) -> float:
        """Root mean square over the good folds; nan if there is none [m]."""
        return root_mean_square([fold.rms for fold in self.good])

    @property
    def held_out_noise_rms(self) -> float:
        """The same in units of the noise, per measured coordinate [-]."""
        return root_mean_square([fold.noise_rms for fold in self.good])

    @property
    def score(self) -> float:
        """Mean squared prediction error in units of the noise, over good folds [-]."""
        return self.held_out_noise_rms**2

    @property
    def verdict(self) -> str:
        """Verdict of the identifiability; "not known" without one."""
        known = self.identifiability
        return "not known" if known is None else known.verdict


class PairedDifference(Module):
    """How much worse a model predicts than the best, over the same configurations.

    The squared prediction error of each held-out configuration, in units of the noise,
    less that of the best model: what all models find hard cancels. The interval is
    Student's, with the scatter over configurations; as fits of different folds share
    data it is approximate (Bengio and Grandvalet, J. Mach. Learn. Res. 5, 2004).

    Attributes:
        name: Name of the model.
        difference: Mean of the differences [-].
        standard_error: Standard error of that mean; infinite for fewer than two [-].
        n: Number of configurations that both predicted.
    """

    name: str
    difference: float
    standard_error: float
    n: int

    @property
    def half_width(self) -> float:
        """Half of the interval of `LEVEL_OF_COMPARISON`; infinite for n < 2 [-]."""
        if self.n < 2:
            return np.inf
        quantile = stdtrit(self.n - 1, 0.5 + 0.5 * LEVEL_OF_COMPARISON)
        return float(quantile * self.standard_error)

    @property
    def told_apart(self) -> bool:
        """Whether the data say that the model predicts worse than the best."""
        return self.difference > self.half_width

    @classmethod
    def of(cls, other: ModelScore, best: ModelScore) -> "PairedDifference":
        """Compare two models over the configurations that both predicted."""
        squares = {f.held_out: f.noise_rms**2 for f in best.good}
        pairs = [
            f.noise_rms**2 - squares[f.held_out]
            for f in other.good
            if np.isfinite(f.noise_rms * squares.get(f.held_out, np.nan))
        ]
        n = len(pairs)
        error = np.std(pairs, ddof=1) / np.sqrt(n) if n > 1 else np.inf
        mean = float(np.mean(pairs)) if pairs else np.nan
        return cls(other.name, mean, float(error), n)


class ModelComparison(Result):
    """Models by their error on held-out configurations, the smallest first.

    Attributes:
        models: Those without a failed fold first.
        differences: How much worse each later model predicts than the first.
    """

    models: tuple[ModelScore, ...]
    differences: tuple[PairedDifference, ...]

    @classmethod
    def ranked(cls, scores: Sequence[ModelScore]) -> "ModelComparison":
        """Rank scores by failed folds, then prediction error, then parameters."""
        error = lambda s: np.inf if np.isnan(s.score) else s.score
        key = lambda s: (len(s.failed) > 0, error(s), s.n_parameters)
        models = tuple(sorted(scores, key=key))
        return cls(models, tuple(PairedDifference.of(m, models[0]) for m in models[1:]))

    @property
    def best(self) -> ModelScore | None:
        """The model that predicts best; None if none predicted every configuration."""
        return None if self.models[0].failed else self.models[0]

    @property
    def undecided(self) -> tuple[str, ...]:
        """The models that the data cannot tell from the best."""
        others = zip(self.models[1:], self.differences, strict=True)
        return tuple(m.name for m, d in others if not (m.failed or d.told_apart))


def root_mean_square(values: Sequence[float] | HostArray) -> float:
    """Return the root mean square of the values that are known; nan without any."""
    known = np.asarray(values)[np.isfinite(values)]
    return float(np.sqrt(np.mean(known**2))) if known.size else np.nan
