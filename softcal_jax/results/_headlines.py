"""The sentence that each result begins with, and sentences on what it misses."""

from functools import singledispatch

import numpy as np

from softcal_jax._text import listed
from softcal_jax._units import readable, readable_values
from softcal_jax.calibration import MultiStartResult, SimulationResult
from softcal_jax.control import (
    OUTCOMES,
    GoalFit,
    InverseResult,
    TrajectoryResult,
    coordinate_names,
)
from softcal_jax.designs import DesignResult
from softcal_jax.identifiability import (
    Assessment,
    Identifiability,
    Ranking,
)
from softcal_jax.inference import Difference
from softcal_jax.layouts import ModelComparison

_LISTED = 4  # missed goals that a message lists

_OUTCOMES: dict[str, str] = {
    "trust": "Trust these values: the fit converged, and every check passed.",
    "take with care": "Take these values with care:",
    "do not use": "Do not use these values:",
}
"""What may be done with the values; it ends with a colon where reasons follow."""

_COARSE = 0.3
"""Difference over a value, or in rad, that must be seen if agreement is to say much."""


@singledispatch
def headline(result: object) -> str:
    """Say what a result comes to, in a sentence or two.

    Raises:
        TypeError: If it is no result of this package.
    """
    raise TypeError(f"a {type(result).__name__} is no result that has a headline.")


@headline.register
def _(result: MultiStartResult) -> str:
    n, lost = len(result.cost), np.isinf(result.cost)
    unfinished = ~result.converged & ~lost
    text = f"{n} starts, {result.converged.sum()} converged, {len(result.optima)} "
    text += "distinct optima."
    if result.missed < 1.0:
        share = f"{100.0 * result.missed:.0f} %"
        text += f" Of further starts, {share} are expected to end at others."
    if unfinished.any():
        lowest = result.cost[unfinished].min()
        text += f" {unfinished.sum()} not converged, lowest cost {lowest:.3g}."
    if lost.any():
        text += f" {lost.sum()} without equilibrium at the start."
    return text


@headline.register
def _(result: SimulationResult) -> str:
    n = len(result.configurations)
    n_converged = sum(pose.converged for pose in result.configurations)
    if n_converged < n:
        return f"{n_converged} of {n} configurations have an equilibrium."
    every = "The configuration has" if n == 1 else f"All {n} configurations have"
    return f"{every} an equilibrium."


@headline.register
def _(result: DesignResult) -> str:
    n, missed = len(result.goals), result.unmet
    if not result.fit.converged:
        return "Not designed: the search did not converge."
    if missed:
        return f"Not designed: {len(missed)} of {n} goals are missed."
    if result.lost:
        return "Not designed: a robust design was not found."
    if not result.met:
        return "Not designed: a limit is exceeded."
    return f"Designed: all {n} goals are met." if n > 1 else "Designed: it is met."


@headline.register
def _(result: InverseResult) -> str:
    text = f"configuration {result.configuration.name!r}: {OUTCOMES[result.outcome]}"
    unmet = result.unmet
    for fit in unmet[:_LISTED]:
        text += f"; {fit.name!r} is off by {off_words(fit)}"
    if len(unmet) > _LISTED:
        text += f"; {len(unmet) - _LISTED} more are off by less"
    if unmet and result.held_by:
        text += f"; held by {', '.join(result.held_by)}"
    if unmet and result.blind is not None:
        text += f"; held by a {result.blind}"
    return text + "."


@headline.register
def _(result: TrajectoryResult) -> str:
    n, missed = len(result.points), len(result.unmet)
    return f"{n - missed} of {n} goals are met."


@headline.register
def _(result: Identifiability) -> str:
    n_data, n_p = result.n_data, result.n_parameters
    return (
        f"{result.verdict.capitalize()} at these values: {n_data} measured "
        f"coordinate{'s' * (n_data != 1)} for {n_p} parameter{'s' * (n_p != 1)}."
    )


@headline.register
def _(result: Assessment) -> str:
    return _OUTCOMES[result.outcome]


@headline.register
def _(result: Ranking) -> str:
    if not result.gains:
        return "No candidate can be ranked."
    if not result.helps:
        return "No candidate lowers the errors: know what is held fixed better."
    best = result.gains[0]
    return f"Candidate {best.name!r} tells most: {best.effect}."


@headline.register
def _(result: ModelComparison) -> str:
    best = result.best
    if best is None:
        return "No model predicts every configuration, so none can be preferred."
    size = readable_values([best.held_out_rms], "m", digits=3) + ", "
    first = (
        f"{best.name!r} has the smallest held-out error: "
        f"{size * bool(np.isfinite(best.held_out_rms))}"
        f"{best.held_out_noise_rms:.2f} times the noise."
    )
    rivals = [model for model in result.models[1:] if not model.failed]
    close = [model for model in rivals if model.name in result.undecided]
    worse = [model for model in rivals if model.name not in result.undecided]
    names = lambda models: listed([repr(model.name) for model in models])
    if not rivals:
        return f"{first} No other model predicts every configuration."
    if not close:
        return f"{first} The data distinguish it from {names(worse)}."
    text = f"{first} The data cannot distinguish it from {names(close)}"
    text += f", but can from {names(worse)}." if worse else "."
    fewest = min([best, *close], key=lambda m: (m.n_parameters, m.score))
    if fewest.n_parameters < best.n_parameters:
        text += f" Of these, {fewest.name!r} has the fewest parameters."
    return text


@headline.register
def _(result: Difference) -> str:
    chi2 = f"chi-squared {result.chi_squared:.3g} for {result.directions}"
    by = lambda i, sizes: (
        f"{result.names[i]} by {readable(float(f'{sizes[i]:.2g}'), result.units[i])}"
    )
    if result.contradicted:
        return (
            f"The model contradicts the data of {listed(result.contradicted)}: such "
            "values hold at most for the loads and shape that they were fitted to. "
            f"Between A and B: {chi2}."
        )
    if result.agree:
        size = np.where(np.array(result.units) == "rad", 1.0, np.abs(result.of_a))
        coarse = np.flatnonzero(result.unseen > _COARSE * size).tolist()
        hidden = [by(i, result.unseen) for i in coarse]
        text = f"Both agree within their errors ({chi2})"
        if hidden:
            return f"{text}, but a difference could hide: {listed(hidden)}."
        return f"{text}, as material properties would."
    largest = np.argsort(-np.abs(result.worst / result.unseen))[:4].tolist()
    changes = [by(i, result.worst) for i in largest]
    return (
        f"They do not agree ({chi2}): the values of at least one robot hold only "
        "for its loads and shape. From A to B they differ most in "
        f"{listed(changes)} ({result.worst_size:.1f} standard errors)."
    )


def missed_words(result: DesignResult) -> tuple[str, ...]:
    """Say what goals are off by, and what holds them there, one sentence each."""
    reasons = [f"{g.label} is off by {off_words(g)}." for g in result.unmet[:_LISTED]]
    if len(result.unmet) > _LISTED:
        reasons.append(f"{len(result.unmet) - _LISTED} more are off by less.")
    if result.lost:
        reasons.append(f"This is the one of least error as ordered: {result.lost}")
    if result.robust and result.unmet:
        reasons.append("As ordered it is farther off, to be closer as printed.")
    reasons += [f"{peak}." for peak in result.peaks if not peak.kept]
    if result.held_by:
        reasons.append(f"They are held by {listed(result.held_by)}.")
    return (*reasons, *(f"{trade}." for trade in result.trades))


def off_words(fit: GoalFit) -> str:
    """Say how far it is off in each direction, in words: x 0.12 mm, turn x 0.3 deg."""
    values = zip(coordinate_names(fit.effector), fit.residual, strict=True)
    unit, seen = fit.effector.unit, fit.effector.seen
    show = lambda value: readable(float(f"{value:.3g}"), unit)
    parts = [
        f"{name} {show(value)}".strip()
        for (name, value), counts in zip(values, seen, strict=True)
        if counts
    ]
    distance = fit.effector.distance(fit.reached)
    far = len(parts) > 1 and bool(np.isfinite(distance))
    return ", ".join(parts) + f" ({show(distance)} in all)" * far
