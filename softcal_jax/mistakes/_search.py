"""Search for the mistake that explains the data, each by a few simulations at most.

Changed readings need none: they are fitted about simulations that are there, to first
order. Only where the best of them lies far from these, one more is made. What was
stated is changed next, where superposition of forces says that it may help.
"""

from dataclasses import replace

import jax
import numpy as np
from scipy.special import chdtri

from softcal_jax._module import Module
from softcal_jax._typing import HostArray
from softcal_jax._units import readable, readable_values
from softcal_jax.calibration import CalibrationResult, build_problem
from softcal_jax.equilibrium import Workers
from softcal_jax.inference import EXACT, UNLIKELY
from softcal_jax.mistakes._changes import changes, clamps, commands, forces
from softcal_jax.mistakes._refit import (
    Change,
    Kind,
    Readings,
    Refit,
    Simulated,
    Simulator,
    Variant,
)

CLEARLY = 0.5  # share of the squares that a mistake leaves at most [-]

AT_NOISE = 1.5
"""Size of what a mistake leaves, over all stated errors, that is still noise [-]."""

ENOUGH = 1e-2
"""Share of the squares below which no more kinds of mistakes are tried [-]."""

ALIKE = 2.0  # ratio of squares that superposition can hardly tell apart [-]

SHORTER = 0.3
"""Factor on the largest step about a simulation from which one went wrong [-]."""

MISPLACED = 4.0
"""How far off its place a marker must be, over the rms that is left, to be named [-].

A shorter shift may only make up for errors of the model.
"""

MOST_SIMULATED = 4  # most simulations of all poses for each kind of change

AS_GOOD = 20.0
"""Likelihood ratio up to which the simpler of two mistakes is the likelier one [-]."""

MOST = 3  # most mistakes that are named


class Mistake(Module):
    """A mistake, and what the residuals would be without it.

    Attributes:
        kind: What it is.
        change: What would have to change, like "Swapping markers mid and end in all
            poses".
        rms_before: Root mean square of the distances between measured and simulated
            points in the fitted configurations; nan without points [m].
        rms_after: The same after the change and another fit [m].
        errors_before: Root mean square of all errors, in stated standard deviations and
            without what offsets of recordings and attachments explain [-].
        errors_after: The same after the change and another fit [-].
    """

    kind: Kind
    change: str
    rms_before: float
    rms_after: float
    errors_before: float
    errors_after: float

    def __str__(self) -> str:
        """Write what the change would do, in a sentence."""
        sizes = (readable(x, "about") for x in (self.rms_before, self.rms_after))
        if np.isnan(self.rms_before):
            errors = self.errors_before, self.errors_after
            sizes = (f"{error:.2g} standard deviations" for error in errors)
        return f"{self.change} would bring the residuals from {' to '.join(sizes)}."


def likely_mistakes(result: CalibrationResult) -> tuple[Mistake, ...]:
    """Name the mistakes that would explain data which the model contradicts.

    Tried are: markers swapped in all configurations or in one, or lost at (0, 0, 0);
    readings of two configurations exchanged; a frame turned by 90 or 180 degrees,
    mirrored, or with axes exchanged; gravity, loads and actuation of the wrong sign;
    these, or lengths, off by a factor between units (kgf, psi, inches); a marker that
    stands elsewhere; and a clamp of another face, or one that reaches up to a marker.
    After each, the parameters are fitted again to first order.

    A mistake is named if without it the residuals are down to the noise: no more than
    `AT_NOISE` times what is stated of noise and budget, where a `std` is stated. It
    also at least halves their squares, and makes the data likelier by a factor that
    chance reaches with a probability of `UNLIKELY` at most, whichever of all changes is
    the best: without a mistake, a given change reaches a likelihood ratio of k with a
    probability of 1 / k at most (Markov's inequality).
    With an estimated noise, that is the ratio of the likelihoods maximised in its
    level. Of mistakes that explain the data as well, the simplest comes first. What the
    parameters make up for, like a factor on all forces beside a modulus, leaves the
    residuals as they are, and is not named; nor is any of two that do as well and have
    nothing in common.

    Returns:
        The mistakes, the likeliest first; none where the model does not contradict the
        data, or no mistake explains them clearly better, or poses come after others.
    """
    fits = [fit for fit in result.configurations if fit.role == "calibration"]
    if not replace(result, configurations=tuple(fits)).doubts:
        return ()
    posed = [fit.posed for fit in result.configurations]
    poses = [p for p in posed if p is not None]
    if result.noise is None or len(poses) < len(posed):
        return ()
    if any(p.after for p in poses):  # a change of one would change those after it
        return ()
    # With what was held out, so that the programs of the fit serve again.
    problem = build_problem(result.model, result.space, poses, result.newton)
    problem = problem.of_first(len(fits))
    readings = Readings(result, fits, problem)
    W = np.array([fit.W_ep for fit in fits])
    last = Simulated(np.asarray(result.z), readings.simulated, W)
    with Workers(result.model, len(fits)) as workers:
        simulator = Simulator(problem, workers, [fit.displacement for fit in fits])
        search = _Search(result, readings, simulator, last)
        search.run()
    return search.named()


class _Search:
    """The changes that were tried, the first of which is none, and what they leave.

    `as_is` is the best fit to the readings as they are, `fits` are those of the changes
    whose variant has been simulated, out of all `n_considered`.
    """

    def __init__(
        self,
        result: CalibrationResult,
        readings: Readings,
        simulator: Simulator,
        last: Simulated,
    ):
        """Begin with the readings and statements as they are, at the end of the fit."""
        self.result, self.readings, self.simulator = result, readings, simulator
        self.dof = max(result.uncertainty.degrees_of_freedom, 1)
        posed = (fit.posed for fit in result.configurations)
        self.stated = all(p is not None and p.states_noise for p in posed)
        self.changes = [Change("swapped markers", "", 0, readings.measured)]
        self.simulated: dict[Variant, list[Simulated]] = {(): [last]}
        self.n_considered, self._limit = 0, np.inf
        self._refit()
        self._limit = self._allowed(CLEARLY)

    def run(self) -> None:
        """Try all kinds of changes, until one explains the data well."""
        self.changes += changes(self.readings)
        self.n_considered = len(self.changes) - 1
        self._refit()
        self._descend()
        if self._enough():
            return
        # About the start of the fit, since a wrong fit says nothing.
        values = jax.device_put(np.array([p.start for p in self.result.parameters]))
        z = np.asarray(self.result.space.to_scaled(values))
        start = self._simulate((), z)
        if start is None:
            return
        self._descend()
        for kind in (forces, commands, clamps):
            if self._enough():
                return
            stated, n_considered = kind(self.simulator, self.readings, start)
            self.n_considered += n_considered
            for change in stated:
                if self._enough() and change.expected > ALIKE * stated[0].expected:
                    break
                if change.variant in self.simulated:
                    continue
                self.changes.append(change)
                if self._simulate(change.variant, change.z) is None:
                    continue
                if np.isinf(change.expected):  # superposition has not led near
                    fit = self._best(change)
                    self._simulate(change.variant, fit.about.z + fit.step)
                self._descend()

    def _allowed(self, share: float) -> float:
        """Return a share of the squares, or those that a stated noise may leave."""
        squares = share * self.as_is.squares
        if self.result.uncertainty.noise == "stated":
            return max(squares, float(chdtri(self.dof, UNLIKELY)))
        return squares

    def _enough(self) -> bool:
        """Whether a change explains the data so well that no more are tried."""
        allowed = self._allowed(ENOUGH)
        return any(f.squares <= allowed and self._explains(f) for f in self.fits)

    def _descend(self) -> None:
        """Simulate the best fit, until it is one that holds."""
        for _ in range(MOST_SIMULATED):
            best = min(self.fits, key=lambda fit: fit.squares, default=self.as_is)
            if best.near or best.squares > self._limit:
                return
            about = best.about
            self._simulate(best.change.variant, about.z + best.step)
            if self._best(best.change).about is about:  # it did not get better
                about.trust *= SHORTER
                about.fits.clear()
                self._refit()

    def _simulate(self, variant: Variant, z: HostArray) -> Simulated | None:
        """Simulate a variant, and fit all its changes; None without an equilibrium."""
        simulated = self.simulator(variant, z)
        if simulated is not None:
            self.simulated.setdefault(variant, []).append(simulated)
            self._refit()
        return simulated

    def _refit(self) -> None:
        """Fit what is not fitted yet, about each simulation of its variant."""
        changes = [c for c in self.changes if c.variant in self.simulated]
        for variant, simulated in self.simulated.items():
            of_variant = [c for c in changes if c.variant == variant]
            for about in simulated:
                self.readings.fit(about, of_variant, self._limit)
        self.as_is, *self.fits = map(self._best, changes)

    def _best(self, change: Change) -> Refit:
        """Return the fit about the simulation in which a change leaves least."""
        fits = [about.fits[id(change)] for about in self.simulated[change.variant]]
        return min(fits, key=lambda fit: fit.now)

    def _evidence(self, better: Refit, worse: Refit) -> float:
        """Return the logarithm of the likelihood ratio of two changes [-].

        Model error counts as noise.
        """
        n, m = (max(self.dof - len(fit.along), 1) for fit in (better, worse))
        squares = max(better.squares, n * EXACT**2)
        squares_of_worse = max(worse.squares, m * EXACT**2)
        if self.result.uncertainty.noise == "stated":
            return 0.5 * (squares_of_worse - squares) / max(squares / n, 1.0)
        return 0.5 * n * float(np.log((squares_of_worse / m) / (squares / n)))

    def _explains(self, fit: Refit) -> bool:
        """Whether a change explains the data clearly better."""
        least = float(np.log(max(self.n_considered, 1) / UNLIKELY))
        clearly = fit.near and fit.squares <= self._limit
        if not clearly or self._evidence(fit, self.as_is) < least:
            return False
        if fit.change.kind == "misplaced marker":
            distance = np.linalg.norm(fit.along)
            if distance < MISPLACED * self.readings.rms(fit):
                return False
        at_noise = not self.stated or self.readings.level(fit) <= AT_NOISE
        return at_noise and not self.readings.rms(fit) > self.readings.rms(self.as_is)

    def named(self) -> tuple[Mistake, ...]:
        """Return the changes that explain the data clearly better."""
        good = [fit for fit in self.fits if self._explains(fit)]
        if not good:
            return ()
        best = min(good, key=lambda fit: fit.squares)
        as_good = [f for f in good if self._evidence(best, f) <= np.log(AS_GOOD)]
        if len({fit.change.subject for fit in as_good}) > 1:
            return ()
        as_good.sort(key=lambda fit: (fit.change.rank, fit.squares))
        n = np.sum(self.readings.weight > 0.0)
        error = lambda fit: float(np.sqrt(fit.squares / n))
        return tuple(
            Mistake(
                kind=fit.change.kind,
                change=_words(fit),
                rms_before=self.readings.rms(self.as_is),
                rms_after=self.readings.rms(fit),
                errors_before=error(self.as_is),
                errors_after=error(fit),
            )
            for fit in as_good[:MOST]
        )


def _words(fit: Refit) -> str:
    """Write the change, and how far a marker would be moved."""
    if fit.change.kind != "misplaced marker":
        return fit.change.words
    return (
        f"{fit.change.words}, by {readable_values(fit.along.tolist(), 'm', digits=2)},"
    )
