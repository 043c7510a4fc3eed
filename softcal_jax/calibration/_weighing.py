"""Fit and noise in turn: the noise weighs the errors, and is estimated from the fit.

A component of the noise that is not known is estimated by restricted maximum likelihood
from the errors linearised at the optimum, and a share of the motion is a share of the
motion simulated there. These weights move the optimum a little, so the fit goes on from
it, until neither changes. While the noise still changes, steps far below a standard
error are not taken.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import jax
import numpy as np

from softcal_jax._typing import Bool, Float, HostArray
from softcal_jax._units import readable_values
from softcal_jax.calibration._evaluation import Evaluator
from softcal_jax.calibration._problem import CalibrationSettings
from softcal_jax.calibration._runs import settle
from softcal_jax.calibration._step import CalibrationState, initial_state
from softcal_jax.configurations import Configuration
from softcal_jax.fields import OFFSET
from softcal_jax.inference import (
    ATTACHMENTS,
    EXACT,
    LinearModel,
    freedom_between,
    restricted_likelihood,
    span,
)
from softcal_jax.unknowns import (
    FIRST_SHARE,
    RECORDINGS,
    AnyArray,
    CorrelatedNoise,
    creep_of,
)

SETTLED = 0.01
"""Relative change of a standard deviation at which the noise has settled [-]."""

UNSEEN, NOT_TAKEN = 1e-2, 1e-3
"""Standard errors below which a step waits for the noise, or is not taken [-]."""

MOST_ROUNDS = 10  # most estimates of the noise

FEWEST_OFFSETS = 4
"""Fewest residuals from which offsets are estimated: one recording has three."""

FEWEST_SHARES = 3  # fewest residuals from which a share of the motion is estimated


class SoughtNoise(NamedTuple):
    """Which components of the noise are estimated.

    `share` flags the configurations that have the share of the motion, one for all.
    """

    jitter: bool
    offset: bool
    share: Bool[HostArray, " n_c"]


class Weighed(NamedTuple):
    """End of a fit with its noise.

    Attributes:
        state: End of the fit, in units of the noise.
        noise: The noise.
        sought: Which components of it were estimated in the end.
        notes: What went otherwise than asked for.
        scale: Factor on the stated standard deviations of coordinates that was
            estimated together with correlated noise; None if it was not [-].
        settled: Whether the noise stood still in the end.
    """

    state: CalibrationState
    noise: CorrelatedNoise
    sought: SoughtNoise
    notes: tuple[str, ...]
    scale: float | None = None
    settled: bool = True

    def of_all(
        self, start: CorrelatedNoise, configurations: Sequence[Configuration]
    ) -> CorrelatedNoise:
        """Return the noise of all configurations with what the fitted ones showed.

        `start` is the noise to begin with; the fitted configurations come first.
        """
        sought, n = self.sought.share, len(self.sought.share)
        ratio = lambda a, b: _largest(a) / _largest(b) if _largest(b) > 0.0 else 1.0
        shares = np.asarray(self.noise.share), np.asarray(start.share)[:n]
        scaled = start.scaled(
            jitter=float(self.noise.jitter),
            offset=ratio(self.noise.offset, np.asarray(start.offset)[:n]),
            share=ratio(shares[0][sought], shares[1][sought]),
            of=np.array([c.relative_std == "estimated" for c in configurations]),
        )
        return scaled.moving(self.noise.motion)


def weighed_fit(
    evaluate: Evaluator,
    settings: CalibrationSettings,
    state: CalibrationState,
    *,
    sought: SoughtNoise,
    motion: Float[HostArray, "n_c n_rows 3"],
    note: Callable[[CalibrationState, CorrelatedNoise], None],
) -> Weighed:
    """Take steps to the optimum, update the noise, and go on until both stand still.

    Begins with the noise of the evaluator. `motion` is the measured motion of points
    [m]; `note` is called with state and noise after each step.
    """
    assert evaluate.problem.noise is not None
    noise: CorrelatedNoise = evaluate.problem.noise
    configurations = evaluate.problem.poses
    n_points = evaluate.problem.configurations.effectors.nodes.shape[-2]
    is_point = (np.arange(motion.shape[1]) < n_points)[:, None]
    scale, notes, settled, change = None, [], True, 0.0
    for n in range(MOST_ROUNDS):
        state = _until(UNSEEN, evaluate, settings, state, note)
        if not state.converged:
            break
        linear = state.evaluation.linear(evaluate.problem, state.z)
        if n == 0:
            sought, notes = _enough(linear, sought, configurations)
        new = _estimated(linear, noise, sought, configurations)
        known = new is not None and sought.jitter
        scale = float(noise.jitter) if known else None
        # Creep is a share of the simulated motion: a share of the measured one would
        # favour a robot that does not move, as a share of minus one explains all data.
        simulated = motion + np.asarray(state.evaluation.delta_e)
        new = (new or noise).moving(np.where(is_point, simulated, motion))
        change = _change(noise, new)
        settled = change <= SETTLED
        if settled or n == MOST_ROUNDS - 1:
            state = _until(NOT_TAKEN, evaluate, settings, state, note)
            break
        noise, evaluate = new, evaluate.with_noise(new)
        evaluation = evaluate.weighed(state.z, state.evaluation.response)
        state = initial_state(settings, evaluation)
    notes += _noise_notes(noise, sought, None if settled else change)
    return Weighed(state, noise, sought, tuple(notes), scale, settled)


def _until(
    errors: float,
    evaluate: Evaluator,
    settings: CalibrationSettings,
    state: CalibrationState,
    note: Callable[[CalibrationState, CorrelatedNoise], None],
) -> CalibrationState:
    """Take steps while they are longer than `errors` standard errors."""
    weight = np.asarray(evaluate.problem.configurations.effectors.inverse_std)
    # Such a step lets the cost fall by this share of it.
    fall = errors**2 / max(int(np.sum(weight > 0.0)) - len(state.z), 1)
    last, noise = errors == NOT_TAKEN, evaluate.problem.noise
    fall = max(fall, settings.least_fall if last else 2.0 * settings.least_fall)
    if state.converged and float(state.least_fall) <= fall:
        return state  # of a checkpoint

    def noted(new: CalibrationState) -> None:
        # A step that is not taken will be asked for again.
        if noise is not None and (last or not new.converged):
            note(new, noise)

    falls = jax.device_put((np.array(False), np.array(fall)))
    state = replace(state, converged=falls[0], least_fall=falls[1])
    return settle(evaluate, settings, state, noted)


class _Components(NamedTuple):
    """Columns of the noise in stated units: estimated offsets, shares, and the rest."""

    offsets: Float[HostArray, "n k"]
    shares: Float[HostArray, "n l"]
    stated: Float[HostArray, "n m"]


def _components(
    linear: LinearModel, sought: SoughtNoise, configurations: Sequence[Configuration]
) -> _Components:
    columns = linear.correlated
    pairs = zip(configurations, sought.share, strict=True)
    moving = {creep_of(c) for c, is_sought in pairs if is_sought}
    recorded = np.array([cause == RECORDINGS for cause in columns.causes], bool)
    offsets = recorded & sought.offset
    shares = np.array([name in moving for name in columns.names], bool)
    A = linear.scale * columns.values
    return _Components(A[:, offsets], A[:, shares], A[:, ~offsets & ~shares])


def _enough(
    linear: LinearModel, sought: SoughtNoise, configurations: Sequence[Configuration]
) -> tuple[SoughtNoise, list[str]]:
    """Drop what the data cannot determine, with notes that say what counts instead."""
    columns, notes = _components(linear, sought, configurations), []

    def too_few(what: str, A: HostArray, fewest: int, instead: str) -> bool:
        between, within = freedom_between(linear, A)
        if between >= fewest and within >= 1:
            return False
        notes.append(
            f"{what} cannot be estimated: of the residuals that parameters leave, at "
            f"least {fewest} must show it and one must not, and there are {between} "
            f"and {within}. {instead}, or measure more."
        )
        return True

    instead = f"{readable_values([OFFSET], 'm')} is taken; state `recordings`"
    what = "The offset of the recordings"
    if sought.offset and too_few(what, columns.offsets, FEWEST_OFFSETS, instead):
        sought = sought._replace(offset=False)
    instead = f"{100.0 * FIRST_SHARE:g} % is taken; state `relative_std`"
    what = "The share of the motion"
    if sought.share.any() and too_few(what, columns.shares, FEWEST_SHARES, instead):
        sought = sought._replace(share=np.zeros_like(sought.share))
    if sought.jitter and linear.correlated.values.shape[1] > 0:
        _, within = freedom_between(linear, linear.correlated.values)
        if within < 1:
            notes.append(
                "Jitter cannot be told from offsets: each residual that parameters "
                "leave may be either. Their ratio is taken as stated, and their size "
                "from the residuals; measure more points in each recording."
            )
            sought = sought._replace(jitter=False)
    return sought, notes


def _estimated(
    linear: LinearModel,
    noise: CorrelatedNoise,
    sought: SoughtNoise,
    configurations: Sequence[Configuration],
) -> CorrelatedNoise | None:
    """Estimate the sought components of a noise; None if none is sought, or can be."""
    columns = _components(linear, sought, configurations)
    free = ~linear.held
    n_prior = int(np.sum(linear.prior_weights[free] > 0.0))
    dof = len(linear.r) - int(free.sum()) + n_prior
    mountings = span(linear.correlated.of(ATTACHMENTS))
    rest = linear.r - mountings @ (mountings.T @ linear.r)
    level = float(np.sqrt(np.mean(rest**2))) if len(rest) else 0.0
    used = [part.shape[1] > 0 for part in columns]
    # Jitter alone changes no weights: `uncertainty` finds it in closed form.
    if not (any(used) or n_prior) or dof <= 0 or level < EXACT:
        return None
    estimated = [sought.jitter, used[0], used[1], False]
    if not any(estimated):
        return None
    jitter, offset, share, _ = restricted_likelihood(
        linear, columns, factors=[linear.scale, 1.0, 1.0, 1.0], free=estimated
    )
    return noise.scaled(jitter=jitter, offset=offset, share=share, of=sought.share)


def _noise_notes(
    noise: CorrelatedNoise, sought: SoughtNoise, change: float | None
) -> list[str]:
    """Report estimated offsets and shares, and a `change` of the noise that goes on."""
    notes = []
    if change is not None:
        notes.append(
            "The noise did not settle beside the fit: it still changes by "
            f"{100.0 * change:.0f} %. State the `std` of the effectors with "
            'noise = "stated", or the offset of recordings.'
        )
    if sought.offset:
        size = [float(np.max(noise.offset, initial=0.0))]
        shown = readable_values(size, "m", digits=2)
        notes.append(f"The residuals show recordings to be off by {shown}.")
    if sought.share.any():
        size = 100.0 * float(np.max(np.asarray(noise.share)[sought.share]))
        notes.append(
            f"The residuals show {size:.2g} % of the motion to be creep or hysteresis."
        )
    return notes


def _change(old: CorrelatedNoise, new: CorrelatedNoise) -> float:
    """Return the largest relative change of a standard deviation [-]."""
    before, after = (
        np.array([n.jitter, _largest(n.offset), _largest(n.share)]) for n in (old, new)
    )
    creep = [
        np.asarray(n.motion) * np.asarray(n.share)[:, None, None] for n in (old, new)
    ]
    change = np.append(np.abs(after - before), _largest(creep[1] - creep[0]))
    return float(np.max(change / np.maximum([*before, _largest(creep[0])], 1e-300)))


def _largest(values: AnyArray) -> float:
    return float(np.max(np.abs(values), initial=0.0))
