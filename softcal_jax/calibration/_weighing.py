"""Fit and noise in turn: the noise weighs the errors of the fit that it is found from.

A component of the noise that is not known is found by restricted maximum likelihood
from the errors linearised at the optimum, and a share of the motion is one of that
simulated there. These weights move the optimum a little, so the fit goes on from it,
until neither changes.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from softcal_jax._typing import Bool, Float, HostArray
from softcal_jax.calibration._evaluation import Evaluator, in_other_units
from softcal_jax.calibration._noise import FIRST_SHARE, CorrelatedNoise
from softcal_jax.calibration._problem import CalibrationProblem
from softcal_jax.calibration._reml import (
    Residuals,
    freedom_between,
    restricted_likelihood,
)
from softcal_jax.calibration._runs import settle
from softcal_jax.calibration._state import (
    CalibrationSettings,
    CalibrationState,
    initial_state,
)
from softcal_jax.calibration._uncertainty import EXACT
from softcal_jax.configurations import Configuration
from softcal_jax.fields import OFFSET

SETTLED = 0.01
"""Relative change of a standard deviation at which the noise has settled [-]."""

MOST_ROUNDS = 10
"""Most estimates of the noise."""

FEWEST_OFFSETS = 4
"""Fewest residuals from which offsets are estimated: one recording has three."""

FEWEST_SHARES = 3
"""Fewest residuals from which a share of the motion is estimated."""


class Unknown(NamedTuple):
    """Which components of the noise are estimated.

    Attributes:
        jitter: Whether the factor on the stated standard deviations is.
        offset: Whether the offset of the recordings is.
        share: Configurations whose share of the motion is, one share for all.
    """

    jitter: bool
    offset: bool
    share: Bool[HostArray, " n_c"]


class Weighed(NamedTuple):
    """End of a fit with its noise.

    Attributes:
        state: End of the fit, in units of the noise.
        noise: The noise.
        unknown: What of it was estimated in the end.
        scale: Factor on the stated standard deviations of coordinates that was
            estimated beside correlated noise; None if it was not [-].
        notes: What went otherwise than asked for.
        settled: Whether the noise stood still in the end.
    """

    state: CalibrationState
    noise: CorrelatedNoise
    unknown: Unknown
    scale: float | None
    notes: tuple[str, ...]
    settled: bool

    def of_others(
        self,
        begin: CorrelatedNoise,
        others: CorrelatedNoise,
        configurations: Sequence[Configuration],
    ) -> CorrelatedNoise:
        """Return the noise of other configurations with what was found.

        Args:
            begin: The noise of the fitted ones to begin with.
            others: That of the others to begin with.
            configurations: These others.
        """
        which, noise = self.unknown.share, self.noise
        largest = lambda a: float(np.max(np.abs(a), initial=0.0))
        ratio = lambda a, b: largest(a) / largest(b) if largest(b) > 0.0 else 1.0
        shares = (np.asarray(n.share)[which] for n in (noise, begin))
        return others.scaled(
            jitter=float(noise.jitter),
            offset=ratio(noise.offset, begin.offset),
            share=ratio(*shares),
            of=np.array([c.relative_std == "estimated" for c in configurations]),
        )


def unknown_noise(
    configurations: Sequence[Configuration], *, jitter: bool, offset: bool
) -> Unknown:
    """Say which components of the noise of configurations are to be estimated."""
    share = np.array([c.relative_std == "estimated" for c in configurations])
    return Unknown(jitter, offset, share)


def weighed_fit(
    evaluate: Evaluator,
    settings: CalibrationSettings,
    state: CalibrationState,
    *,
    unknown: Unknown,
    motion: Float[HostArray, "n_c n_rows 3"],
    note: Callable[[CalibrationState, CorrelatedNoise], None],
) -> Weighed:
    """Take steps to the optimum, update the noise, and go on until both stand still.

    Args:
        evaluate: Evaluator of the calibration, with the noise to begin with.
        settings: Settings of the outer loop.
        state: State to begin with.
        unknown: What of the noise is estimated.
        motion: Measured motion of the points [m].
        note: Called with state and noise after each step.
    """
    noise, scale, notes, settled = evaluate.problem.noise, None, [], True
    n_points = evaluate.problem.configurations.effectors.nodes.shape[-2]
    assert noise is not None
    for n in range(MOST_ROUNDS):
        told = lambda state, noise=noise: note(state, noise)
        state = settle(evaluate, settings, state, told)
        if not state.converged:
            break
        errors = linear_errors(evaluate.problem, state)
        if n == 0:
            unknown, notes = _enough(errors, evaluate.problem, unknown)
        new = _estimated(errors, evaluate.problem, unknown)
        known = new is not None and unknown.jitter
        scale = float(noise.jitter) if known else None
        new = (new or noise).following(motion, state.evaluation.delta_e, n_points)
        if _change(noise, new) <= SETTLED:
            break
        if n == MOST_ROUNDS - 1:
            settled = False
            notes.append(
                "The noise did not settle beside the fit: it still "
                f"changes by {100.0 * _change(noise, new):.0f} %. State the `std` of "
                'the effectors with noise = "stated", or the offset of recordings.'
            )
            break
        before = evaluate.numbered
        noise, evaluate = new, evaluate.with_noise(new)
        evaluation = in_other_units(evaluate.numbered, state.evaluation, before)
        state = initial_state(settings, state.z, evaluation)
    notes += _found(noise, unknown)
    return Weighed(
        state=state,
        noise=noise,
        unknown=unknown,
        scale=scale,
        notes=tuple(notes),
        settled=settled,
    )


def linear_errors(problem: CalibrationProblem, state: CalibrationState) -> Residuals:
    """Return errors and compliances in units of the stated standard deviations."""
    at, space = state.evaluation, problem.space
    weight = np.asarray(problem.configurations.effectors.inverse_std).ravel()
    seen = weight > 0.0
    free = ~space.at_bound(state.z)
    prior = np.asarray(space.prior_weights())
    known = prior[free] > 0.0
    return Residuals(
        r=(weight * np.asarray(at.delta_e).ravel())[seen],
        W=(weight[:, None] * np.asarray(at.compliance))[np.ix_(seen, free)],
        r_prior=(np.asarray(at.prior) / np.asarray(problem.level))[free][known],
        W_prior=np.diag(prior[free])[known],
    )


class _Columns(NamedTuple):
    """Columns of the noise by component, in stated units, and which is estimated."""

    offsets: Float[HostArray, "n k"]
    shares: Float[HostArray, "n l"]
    stated: Float[HostArray, "n m"]


def _columns(problem: CalibrationProblem, unknown: Unknown) -> _Columns:
    assert problem.noise is not None
    seen = np.ravel(problem.configurations.effectors.inverse_std) > 0.0
    A = float(problem.noise.jitter) * problem.noise_columns()[seen]
    n_c = len(unknown.share)
    is_offset = np.arange(A.shape[1]) < 3 * n_c
    is_share = np.zeros(A.shape[1], bool)
    is_share[3 * n_c : 4 * n_c] = unknown.share
    offsets = is_offset & unknown.offset
    used = np.any(A != 0.0, axis=0)
    pick = lambda which: A[:, which & used]
    return _Columns(pick(offsets), pick(is_share), pick(~offsets & ~is_share))


def _enough(
    errors: Residuals, problem: CalibrationProblem, unknown: Unknown
) -> tuple[Unknown, list[str]]:
    """Drop what the data cannot tell, with a note that says what counts instead."""
    columns, notes = _columns(problem, unknown), []

    def too_few(
        what: str, A: HostArray, fewest: int, *, taken: str, remedy: str
    ) -> bool:
        between, within = freedom_between(errors, A)
        if between >= fewest and within >= 1:
            return False
        notes.append(
            f"{what} cannot be estimated: of the residuals that parameters leave, at "
            f"least {fewest} must show it and one must not, and there are {between} "
            f"and {within}. {taken} is taken; state `{remedy}`, or measure more."
        )
        return True

    if unknown.offset and too_few(
        "The offset of the recordings",
        columns.offsets,
        FEWEST_OFFSETS,
        taken=f"{1e3 * OFFSET:g} mm",
        remedy="recordings",
    ):
        unknown = unknown._replace(offset=False)
    if unknown.share.any() and too_few(
        "The share of the motion",
        columns.shares,
        FEWEST_SHARES,
        taken=f"{100.0 * FIRST_SHARE:g} %",
        remedy="relative_std",
    ):
        unknown = unknown._replace(share=np.zeros_like(unknown.share))
    correlated = np.concatenate(_columns(problem, unknown), axis=1)
    if unknown.jitter and correlated.shape[1] > 0:
        _, within = freedom_between(errors, correlated)
        if within < 1:
            notes.append(
                "Jitter cannot be told from offsets: each residual that parameters "
                "leave may be either. Their ratio is taken as stated, and their size "
                "from the residuals; measure more points in each recording."
            )
            unknown = unknown._replace(jitter=False)
    return unknown, notes


def _estimated(
    errors: Residuals, problem: CalibrationProblem, unknown: Unknown
) -> CorrelatedNoise | None:
    """Estimate what is unknown of a noise; None where nothing is, or can be."""
    noise = problem.noise
    assert noise is not None
    columns = _columns(problem, unknown)
    parts = [columns.offsets, columns.shares, columns.stated]
    used = [part.shape[1] > 0 for part in parts]
    dof = len(errors.r) - errors.W.shape[1] + len(errors.r_prior)
    level = 0.0
    if len(errors.r):
        level = float(np.sqrt(np.mean(_without_offsets(errors.r, problem) ** 2)))
    # Alone the jitter weighs nothing: `uncertainty` finds it in closed form.
    if not (any(used) or len(errors.r_prior)) or dof <= 0 or level < EXACT:
        return None
    free = [unknown.jitter, used[0], used[1], False]
    if not any(free):
        return None
    jitter, offset, share, _ = restricted_likelihood(
        errors, parts, factors=[float(noise.jitter), 1.0, 1.0, 1.0], free=free
    )
    return noise.scaled(jitter=jitter, offset=offset, share=share, of=unknown.share)


def _without_offsets(
    r: Float[HostArray, " n"], problem: CalibrationProblem
) -> Float[HostArray, " n"]:
    """Return errors in stated units without the offsets of attachments."""
    noise = problem.noise
    assert noise is not None
    weight = np.asarray(problem.configurations.effectors.inverse_std)
    delta_e = np.zeros(weight.shape)
    delta_e[weight > 0.0] = r / weight[weight > 0.0]
    rest = noise.without_attachments(delta_e, weight)
    return (weight * rest)[weight > 0.0]


def _found(noise: CorrelatedNoise, unknown: Unknown) -> list[str]:
    """Say what was found for offsets and shares of the motion."""
    notes = []
    if unknown.offset:
        size = 1e3 * float(np.max(noise.offset, initial=0.0))
        notes.append(f"The residuals show recordings to be off by {size:.2g} mm.")
    if unknown.share.any():
        size = 100.0 * float(np.max(np.asarray(noise.share)[unknown.share]))
        notes.append(
            f"The residuals show {size:.2g} % of the motion to be creep or hysteresis."
        )
    return notes


def _change(old: CorrelatedNoise, new: CorrelatedNoise) -> float:
    """Return the largest relative change of a standard deviation [-]."""
    largest = lambda a: np.max(np.abs(a), initial=0.0)
    before, after = (
        np.array([n.jitter, largest(n.offset), largest(n.share)]) for n in (old, new)
    )
    creep = [
        np.asarray(n.motion) * np.asarray(n.share)[:, None, None] for n in (old, new)
    ]
    change = np.append(np.abs(after - before), largest(creep[1] - creep[0]))
    return float(np.max(change / np.maximum([*before, largest(creep[0])], 1e-300)))
