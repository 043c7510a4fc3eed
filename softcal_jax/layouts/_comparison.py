"""Scores of models: how well each predicts what it was not fitted to."""

from collections.abc import Sequence

import numpy as np

from softcal_jax._module import Module
from softcal_jax.identifiability import Identifiability


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
        n_parameters: Parameters.
        folds: One entry per configuration.
        fit_rms: Root mean square marker distance with all configurations fitted; nan if
            that fit failed [m].
        fit_noise_rms: The same in units of the noise, per measured coordinate [-].
        fit_failure: Why the fit to all configurations failed; empty if it did not.
        identifiability: Identifiability from all configurations, with the stated noise,
            where that fit ended; None if one has no equilibrium there.
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
        """The other folds."""
        return tuple(fold for fold in self.folds if not fold.failure)

    @property
    def held_out_rms(self) -> float:
        """Root mean square over the good folds; nan if there is none [m]."""
        return _root_mean([fold.rms for fold in self.good])

    @property
    def held_out_noise_rms(self) -> float:
        """The same in units of the noise, per measured coordinate [-]."""
        return _root_mean([fold.noise_rms for fold in self.good])

    @property
    def score(self) -> float:
        """Mean squared prediction error in units of the noise, over good folds [-]."""
        return self.held_out_noise_rms**2

    @property
    def standard_error(self) -> float:
        """Standard error of the score from its scatter over the folds [-].

        Infinite with fewer than two good folds.
        """
        squares = np.array([fold.noise_rms for fold in self.good]) ** 2
        if len(squares) < 2:
            return np.inf
        return float(np.std(squares, ddof=1) / np.sqrt(len(squares)))

    @property
    def verdict(self) -> str:
        """Verdict of the identifiability; "not known" without one."""
        if self.identifiability is None:
            return "not known"
        return self.identifiability.verdict


def ranked(scores: Sequence[ModelScore]) -> tuple[ModelScore, ...]:
    """Sort by whether folds failed, then prediction error, then parameters."""
    error = lambda s: np.inf if np.isnan(s.score) else s.score
    key = lambda s: (len(s.failed) > 0, error(s), s.n_parameters)
    return tuple(sorted(scores, key=key))


def number(value: float, form: str) -> str:
    """Format a number; "-" where there is none."""
    return "-" if np.isnan(value) else format(value, form)


def _root_mean(values: Sequence[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values)))) if len(values) else np.nan
