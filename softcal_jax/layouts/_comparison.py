"""Comparison of layouts: the scores of their folds, the ranking and its text."""

from collections.abc import Sequence

import numpy as np

from softcal_jax._module import Module
from softcal_jax._text_table import aligned
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
        n_points: Control points of a layout; 0 where laws or meshes are compared.
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
    n_points: int
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
    def n_blind(self) -> int | None:
        """Number of unidentifiable directions of the parameters; None if unknown."""
        if self.identifiability is None:
            return None
        return len(self.identifiability.blind)

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


class LayoutComparison(Module):
    """Layouts by their error on held-out configurations, the smallest first.

    Attributes:
        layouts: Those without a failed fold first.
    """

    layouts: tuple[ModelScore, ...]

    @classmethod
    def ranked(cls, scores: Sequence[ModelScore]) -> "LayoutComparison":
        """Rank scores by failed folds, then prediction error, then parameters."""
        return cls(ranked(scores))

    @property
    def best(self) -> ModelScore | None:
        """The layout that predicts best; None if none predicted every fold."""
        first = self.layouts[0]
        return None if first.failed else first

    @property
    def preferred(self) -> ModelScore | None:
        """The layout with fewest parameters within a standard error of the best."""
        best = self.best
        if best is None:
            return None
        limit = best.score + best.standard_error
        close = [s for s in self.layouts if not s.failed and s.score <= limit]
        return min(close, key=lambda s: (s.n_parameters, s.score))

    def __str__(self) -> str:
        """Write the choice in words, a table, and the folds that failed."""
        lines = [*_conclusion(self), *_table(self.layouts)]
        for score in self.layouts:
            if score.failed:
                lines.append(
                    f"{score.name!r} is judged by {len(score.good)} of "
                    f"{len(score.folds)} folds alone and ranks last:"
                )
            lines += [f"  {f.held_out} held out: {f.failure}." for f in score.failed]
            if score.fit_failure:
                lines.append(
                    f"{score.name!r}, all configurations fitted: {score.fit_failure}."
                )
        return "\n".join(lines)


def _conclusion(comparison: LayoutComparison) -> list[str]:
    """Write the choice, and the reasons against the others."""
    best, preferred = comparison.best, comparison.preferred
    if best is None or preferred is None:
        return ["No layout can be preferred: each has folds that failed."]
    lines = [
        f"{best.name!r} ({_points(best)}) predicts best: held-out error "
        f"{1e3 * best.held_out_rms:.3g} mm, {best.held_out_noise_rms:.2f} times the "
        "noise."
    ]
    if preferred.name != best.name:
        lines.append(
            f"Prefer {preferred.name!r} ({_points(preferred)}): it is within one "
            "standard error of the best, with fewer parameters."
        )
    for other in comparison.layouts:
        if other.name != preferred.name and not other.failed:
            lines += _against(other, preferred)
    if preferred.n_blind:
        lines.append(
            f"Beware: {_blind(preferred)} of {preferred.name!r}; a prediction that "
            "moves along them is a guess."
        )
    if preferred.held_out_noise_rms > 3.0:
        lines.append(
            "Even this one predicts far worse than the noise: try more control points, "
            "other places, or another law."
        )
    return lines


def _against(other: ModelScore, preferred: ModelScore) -> list[str]:
    """Write why a layout was not preferred, unless its error alone says so."""
    closer = other.fit_noise_rms < preferred.fit_noise_rms
    if other.n_parameters > preferred.n_parameters:
        reason = f"but {_blind(other)}" if other.n_blind else "but predicts no better"
        return [f"{other.name!r} fits {'closer' if closer else 'no closer'}, {reason}."]
    ratio = other.fit_noise_rms / max(preferred.fit_noise_rms, 1e-300)
    if other.n_parameters < preferred.n_parameters and ratio > 1.2:
        return [f"{other.name!r} misfits: {other.fit_noise_rms:.2f} times the noise."]
    return []


def _points(score: ModelScore) -> str:
    return f"{score.n_points} control point{'s' * (score.n_points != 1)}"


def _blind(score: ModelScore) -> str:
    are = "is" if score.n_blind == 1 else "are"
    return f"{score.n_blind} of {score.n_parameters} directions {are} blind"


def _table(scores: Sequence[ModelScore]) -> list[str]:
    """Write a table, one line per layout."""
    head = ("layout", "points", "parameters", "held-out [mm]", "in noise", "fit [mm]")
    head += ("blind", "verdict", "failed folds")
    rows = [
        (
            s.name,
            str(s.n_points),
            str(s.n_parameters),
            number(1e3 * s.held_out_rms, ".4g"),
            number(s.held_out_noise_rms, ".2f"),
            number(1e3 * s.fit_rms, ".4g"),
            "-" if s.n_blind is None else str(s.n_blind),
            s.verdict,
            f"{len(s.failed)} of {len(s.folds)}" if s.failed else "none",
        )
        for s in scores
    ]
    return aligned([head, *rows])
