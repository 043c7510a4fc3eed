"""Search for the mistake that explains the data, each by a few simulations at most.

Changed readings need none: they are fitted about simulations that are there, to first
order. Only where the best of them lies far from these, one more is made. What was
stated is changed next, where superposition of forces says that it may help.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import jax
import numpy as np
from scipy.special import chdtri

from softcal_jax.calibration import CalibrationResult, build_problem
from softcal_jax.equilibrium import Workers
from softcal_jax.inference import EXACT, UNLIKELY
from softcal_jax.mistakes._mistake import Mistake
from softcal_jax.mistakes._readings import (
    Change,
    Readings,
    as_read,
    changes,
    readings_of,
)
from softcal_jax.mistakes._refit import TRUST, Refit, Refitter
from softcal_jax.mistakes._simulator import Simulated, Simulator, Stated, Variant
from softcal_jax.mistakes._statements import (
    Statement,
    clamps,
    forces,
    motions_by,
    other_forces,
)

CLEARLY = 0.5
"""Share of the squares that a mistake leaves at most [-]."""

ENOUGH = 1e-2
"""Share of the squares below which no more kinds of mistakes are tried [-]."""

ALIKE = 2.0
"""Ratio of squares that superposition can hardly tell apart [-]."""

NEAR = 0.1
"""Step up to which a linear fit holds; its error is about half its square [-]."""

SHORTER = 0.3
"""Factor on the largest step about a simulation from which one went wrong [-]."""

MOST_SIMULATED = 4
"""Most simulations of all poses for each kind of change."""

AS_GOOD = 20.0
"""Likelihood ratio up to which the simpler of two mistakes is the likelier one [-]."""

MOST = 3
"""Most mistakes that are named."""


@dataclass
class _Base:
    """A simulation, how far steps about it may go, and fits about it by change."""

    simulated: Simulated
    trust: float = TRUST
    fits: dict[int, Refit] = field(default_factory=dict)


@dataclass
class _Candidate:
    """A change, with the refit about the simulation that suits it best.

    Attributes:
        change: The readings.
        variant: How poses would be held and loaded.
        statement: What would have been stated otherwise, if anything.
        bases: Simulations of this variant, shared by all candidates that have it.
        base: The one about which the fit is.
        fit: The fit.
    """

    change: Change
    variant: Variant
    bases: list[_Base]
    statement: Statement | None = None
    base: _Base | None = None
    fit: Refit | None = None

    @property
    def what(self) -> Change | Statement:
        """What describes it."""
        return self.statement or self.change

    @property
    def squares(self) -> float:
        """Squares that it leaves, infinite without a simulation.

        Where readings shrink, those that would be left of readings of the old size.
        """
        shrunk = max(1.0, 1.0 / self.change.scale) ** 2
        return np.inf if self.fit is None else self.fit.squares * shrunk

    @property
    def near(self) -> bool:
        """Whether the fit is so near to its simulation that it holds."""
        if self.base is None or self.fit is None:
            return False
        n_p = len(self.base.simulated.z)
        return bool(np.max(np.abs(self.fit.step[:n_p]), initial=0.0) <= NEAR)


def likely_mistakes(result: CalibrationResult) -> tuple[Mistake, ...]:
    """Name the mistakes that would explain data which the model contradicts.

    Tried are: markers swapped in all configurations or in one, or lost at (0, 0, 0);
    readings of two configurations exchanged; a frame turned by 90 or 180 degrees,
    mirrored, or with axes exchanged; gravity, loads and actuation of the wrong sign;
    these, or lengths, off by a factor of 9.81, 10, 25.4 or 1000; and a clamp that
    reaches up to a marker. After each, the parameters are fitted again to first order.

    A mistake is named if it at least halves the squared residuals, and makes the data
    likelier by a factor that chance reaches with a probability of `UNLIKELY` at most,
    whichever of all changes is the best: without a mistake, a given change reaches a
    likelihood ratio of k with a probability of 1 / k at most (Markov's inequality).
    With an estimated noise, that is the ratio of the likelihoods maximised in its
    level. Of mistakes that explain the data as well, the simplest comes first. What the
    parameters make up for, like a factor on all forces beside a modulus, leaves the
    residuals as they are, and is not named.

    Args:
        result: The calibration. It is not changed.

    Returns:
        The mistakes, the likeliest first; none where the model does not contradict the
        data, or no mistake explains them clearly better.
    """
    fits = [fit for fit in result.configurations if fit.role == "calibration"]
    if not replace(result, configurations=tuple(fits)).doubts:
        return ()
    posed = [fit.posed for fit in result.configurations]
    poses = [p for p in posed if p is not None]
    if result.noise is None or len(poses) < len(posed):
        return ()
    # With what was held out, so that the programs of the fit serve again.
    problem = build_problem(result.model, result.space, poses, result.newton)
    problem = problem.of_first(len(fits))
    effectors = jax.tree.map(np.asarray, problem.configurations.effectors)
    readings = readings_of(fits, effectors)
    refitter = Refitter(result.space, result.noise, readings)
    with Workers(result.model, len(fits)) as workers:
        simulator = Simulator(problem, workers, [fit.displacement for fit in fits])
        search = _Search(result, refitter, simulator, _last(result, readings))
        search.run()
    return search.named()


def _last(result: CalibrationResult, readings: Readings) -> Simulated:
    """Return the simulation with which the fit ended."""
    shape = readings.measured.shape
    n_p = len(result.z)
    e, W = np.zeros(shape), np.zeros((*shape, n_p))
    fits = [fit for fit in result.configurations if fit.role == "calibration"]
    for c, fit in enumerate(fits):
        for record in fit.effectors:
            e[c, record.index, : len(record.std)] = record.simulated
        W[c] = fit.W_ep
    return Simulated(np.asarray(result.z), e, W)


class _Search:
    """The changes that were tried, and what they leave."""

    def __init__(
        self,
        result: CalibrationResult,
        refitter: Refitter,
        simulator: Simulator,
        last: Simulated,
    ):
        """Begin with the readings and statements as they are."""
        self.result, self.refitter, self.simulator = result, refitter, simulator
        self.readings = refitter.readings
        self.stated: Variant = (Stated(),) * len(self.readings.poses)
        self.bases = [_Base(last)]
        self.as_is = _Candidate(as_read(self.readings), self.stated, self.bases)
        self.tried: list[_Candidate] = []
        self.n_considered = 0
        self._refit([self.as_is])

    def run(self) -> None:
        """Try all kinds of changes, until one explains the data well."""
        last = self.bases[0].simulated
        for change in changes(self.readings, last.e):
            self.tried.append(_Candidate(change, self.stated, self.bases))
        self.n_considered = len(self.tried)
        self._descend()
        if self.enough():
            return
        start = self._at_start()
        if start is None:
            return
        self._descend()
        if self.enough():
            return
        self._forces(start)
        if not self.enough():
            longer = clamps(self.simulator, self.readings, start.z)
            self.n_considered += len(longer)
            self._state(longer)

    def _forces(self, start: Simulated) -> None:
        """Try other forces, where superposition about the start says so."""
        parts = motions_by(self.simulator, self.readings, start)
        if parts is not None:
            poses, model = self.simulator.poses, self.result.model
            every = list(other_forces(self.readings, poses, model))
            self.n_considered += len(every)
            self._state(forces(self.refitter, every=every, parts=parts, start=start))

    def enough(self) -> bool:
        """Whether a change explains the data so well that no more are tried."""
        allowed = ENOUGH * self.as_is.squares
        if self.result.uncertainty.noise == "stated":
            plausible = chdtri(self._freedom(self.as_is), UNLIKELY)
            allowed = max(allowed, float(plausible))
        return any(c.squares <= allowed and self._explains(c) for c in self.tried)

    def _at_start(self) -> Simulated | None:
        """Simulate the start of the fit, about which a wrong fit says nothing."""
        space = self.result.space
        values = [p.start for p in self.result.parameters]
        z = np.asarray(space.to_scaled(jax.device_put(np.array(values))))
        start = self.simulator(self.stated, z)
        if start is not None:
            self.bases.append(_Base(start))
            self._refit([self.as_is, *self.tried])
        return start

    def _state(self, statements: Sequence[Statement]) -> None:
        """Simulate changes of what was stated, and descend from there."""
        for statement in statements:
            if self.enough() and statement.expected > ALIKE * statements[0].expected:
                return
            simulated = self.simulator(statement.variant, statement.z)
            if simulated is not None:
                base, change = _Base(simulated), self.as_is.change
                self.tried.append(
                    _Candidate(change, statement.variant, [base], statement)
                )
                self._descend()

    def _descend(self) -> None:
        """Simulate the best fit, until it is one that holds."""
        for _ in range(MOST_SIMULATED):
            self._refit(self.tried)
            best = min(self.tried, key=lambda c: c.squares, default=self.as_is)
            if best.near or best.squares > CLEARLY * self.as_is.squares:
                return
            base, fit = best.base, best.fit
            assert base is not None
            assert fit is not None
            z = base.simulated.z + fit.step[: len(base.simulated.z)]
            simulated = self.simulator(best.variant, z)
            if simulated is not None:
                best.bases.append(_Base(simulated))
                self._refit([self.as_is, *self.tried])
            if best.base is base:  # it did not get better
                base.trust *= SHORTER
                base.fits.clear()
        self._refit(self.tried)

    def _refit(self, candidates: Sequence[_Candidate]) -> None:
        """Fit all candidates about the simulations in which they leave least."""
        shared = {id(c.bases): c.bases for c in candidates}
        for key, bases in shared.items():
            some = [c for c in candidates if id(c.bases) == key]
            for candidate in some:
                candidate.fit = None
            for base in bases:
                new = [c.change for c in some if id(c.change) not in base.fits]
                limit = CLEARLY * self.as_is.squares
                fits = self.refitter.fit(base.simulated, new, base.trust, limit)
                base.fits |= zip(map(id, new), fits, strict=True)
                for candidate in some:
                    fit = base.fits[id(candidate.change)]
                    if candidate.fit is None or fit.now < candidate.fit.now:
                        candidate.base, candidate.fit = base, fit

    def _freedom(self, candidate: _Candidate) -> int:
        dof = self.result.uncertainty.degrees_of_freedom
        return max(dof - candidate.change.n_free, 1)

    def _evidence(self, better: _Candidate, worse: _Candidate) -> float:
        """Return the logarithm of the likelihood ratio of two changes [-].

        Model error counts as noise.
        """
        dof = self._freedom(better), self._freedom(worse)
        squares = [
            max(c.squares, n * EXACT**2)
            for c, n in zip((better, worse), dof, strict=True)
        ]
        if self.result.uncertainty.noise == "stated":
            scale = max(squares[0] / dof[0], 1.0)
            return 0.5 * (squares[1] - squares[0]) / scale
        ratio = (squares[1] / dof[1]) / (squares[0] / dof[0])
        return 0.5 * dof[0] * float(np.log(ratio))

    def _explains(self, candidate: _Candidate) -> bool:
        """Whether a change explains the data clearly better."""
        least = float(np.log(max(self.n_considered, 1) / UNLIKELY))
        clearly = candidate.squares <= CLEARLY * self.as_is.squares
        likelier = self._evidence(candidate, self.as_is) >= least
        return candidate.near and clearly and likelier

    def named(self) -> tuple[Mistake, ...]:
        """Return the changes that explain the data clearly better."""
        good = [c for c in self.tried if self._explains(c)]
        if not good:
            return ()
        best = min(good, key=lambda c: c.squares)
        as_good = [c for c in good if self._evidence(best, c) <= np.log(AS_GOOD)]
        as_good.sort(key=lambda c: (c.what.rank, c.squares))
        return tuple(map(self._mistake, as_good[:MOST]))

    def _mistake(self, candidate: _Candidate) -> Mistake:
        before, after = (
            (self.refitter.rms(c.base.simulated, c.change, c.fit.step), c)
            for c in (self.as_is, candidate)
            if c.base is not None and c.fit is not None
        )
        size = lambda c: float(np.sqrt(c.squares / len(self.refitter)))
        return Mistake(
            kind=candidate.what.kind,
            change=candidate.what.words,
            rms_before=before[0],
            rms_after=after[0],
            errors_before=size(before[1]),
            errors_after=size(after[1]),
        )
