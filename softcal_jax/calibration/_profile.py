"""Confidence intervals from the profile of the likelihood."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from softcal_jax._typing import Array, Float, HostArray
from softcal_jax.calibration._evaluation import Evaluator
from softcal_jax.calibration._problem import CalibrationSettings
from softcal_jax.calibration._result import IntervalEnd
from softcal_jax.calibration._runs import Run, minimise
from softcal_jax.calibration._step import CalibrationState
from softcal_jax.equilibrium import Workers
from softcal_jax.fields import ParameterSpace, Pin
from softcal_jax.inference import LinearModel
from softcal_jax.unknowns import Problem

FIRM = 10.0
"""Precision of the pin of a held parameter, relative to that of the data [-].

On a parabolic profile the parameter yields by a hundredth of its distance from the fit;
what counts is where it ends, not the pin. At a bound the pin is ten times as
firm, since the question is what the data say there.
"""

CLOSE_ENOUGH = 0.02
"""Relative error allowed in the root of the rise at an end of an interval [-].

With both ends so much too close, an interval that says 95 % holds 94.5 % of the time.
"""

NARROW = 0.02
"""Gap to a fit that failed, over the distance, below which the search ends [-]."""

STEEP = 20.0
"""Slope of the root of the rise in such a gap, over its mean slope, that is a jump [-].

The fit on the far side is then repeated from its neighbour.
"""

STEADY = 8
"""Steps over which the cost must fall, or else the fit counts as standing still."""

MOST_RESUMED = 10
"""How often the search for an end is resumed after a fit was repeated, see `_end`."""

LOWER = 1e-3
"""Fall of twice the cost, over its rise at an end, that means another optimum [-].

It is more than rounding, or a loop that stopped a little early, can explain.
"""


class ProfileEnd(NamedTuple):
    """One end of an interval: its scaled distance from the fit, nan if not found [-].

    `why` says what ends it, as in `ParameterInterval`.
    """

    distance: float
    why: IntervalEnd


Ends = tuple[ProfileEnd, ProfileEnd]
"""The lower and the upper end of an interval."""


class NotFound(Exception):
    """Fits along the profile did not converge."""


class LowerCostFound(RuntimeError):
    """A fit along the profile found a lower cost than the calibration had.

    Attributes:
        z: Scaled parameters of that fit [-].
        cost: Its cost [-].
        before: Cost of the calibration [-].
    """

    def __init__(self, z: Float[Array, " n_p"], cost: float, before: float):
        """Keep a cost below that of the calibration, and its parameters."""
        super().__init__(z, cost, before)
        self.z, self.cost, self.before = z, cost, before

    def __str__(self) -> str:
        """Say what it means, and what to do."""
        return (
            f"along the profile the cost falls from {self.before:.6g} to "
            f"{self.cost:.6g}, so the calibration is not in the best optimum: "
            "calibrate from more `starts`, or in Python with `start` = the `z` of this "
            "error."
        )


def profile_ends(
    problem: Problem,
    settings: CalibrationSettings,
    *,
    z: Float[Array, " n_p"],
    linear: LinearModel,
    rise: float,
    which: Sequence[int],
    only_bounds: bool = False,
    ended: Callable[[int, Ends], None] = lambda *_: None,
) -> list[Ends]:
    """Find how far parameters can move before the best fit of the others is too bad.

    A parameter is held and all others are calibrated; the end is the distance at which
    twice the cost has risen by the square of `rise` (Venzon and Moolgavkar, Appl. Stat.
    37, 1988). All ends are found side by side, on the cores of this machine. A fit at a
    bound stops once its cost shows that the bound is not excluded.

    Args:
        problem: The calibration.
        settings: Settings of the outer loop, for the fits along the profile.
        z: Where the calibration ended, scaled [-].
        linear: The linear model of the calibration at z.
        rise: Root of the rise of twice the cost at the end of an interval [-].
        which: Indices of the parameters.
        only_bounds: Whether to fit at the bounds alone. An end that lies before one is
            then given as "likelihood", at the distance of the bound.
        ended: Called with index and ends of each parameter, in the order of `which`.

    Raises:
        LowerCostFound: If the calibration is not in the best optimum.
    """
    space = problem.space
    # The covariance to first order; the bounds count, to keep it finite.
    size = np.asarray(space.upper() - space.lower()) / np.sqrt(12.0)
    error, W = map(np.asarray, linear.whitened())
    covariance = np.linalg.inv(W.T @ W + np.diag(size**-2.0))
    by_data = np.diag(linear.covariance()) / linear.scale**2
    variance = np.where(linear.known, by_data, np.diag(covariance))
    sides = [(column, sign) for column in which for sign in (-1, 1)]
    lanes = len(sides) * len(problem.configurations.gravity)
    with Workers(problem.model, lanes) as workers:
        calibration = _Calibration(
            evaluate=Evaluator(problem, workers),
            settings=settings,
            z=np.asarray(z),
            cost=0.5 * float(error @ error),
            rise=rise,
            covariance=covariance,
            reach=rise * np.sqrt(variance),
        )
        ends: list[ProfileEnd] = []

        def keep(i: int, end: ProfileEnd) -> None:
            ends.append(end)
            if i % 2:
                ended(sides[i][0], (ends[-2], ends[-1]))

        find = _end_at_bound if only_bounds else _end
        runs = (partial(find, _Profile(calibration, *side)) for side in sides)
        workers.side_by_side(runs, keep)
    return list(zip(ends[::2], ends[1::2], strict=True))


class _Calibration(NamedTuple):
    """A calibration at its end."""

    evaluate: Evaluator
    settings: CalibrationSettings
    z: Float[HostArray, " n_p"]
    cost: float
    rise: float
    covariance: Float[HostArray, "n_p n_p"]
    reach: Float[HostArray, " n_p"]  # to the ends, by the linear model


def _end_at_bound(profile: "_Profile") -> ProfileEnd:
    """Say whether an end lies before the bound, which the data then exclude."""
    try:
        excluded = profile.limit > 0.0 and profile.excess(profile.limit) >= 0.0
    except NotFound:
        return ProfileEnd(float("nan"), "not found")
    return ProfileEnd(profile.limit, "likelihood" if excluded else "bound")


def _end(profile: "_Profile") -> ProfileEnd:
    """Find one end of the interval of one parameter.

    A fit with the parameter far away may end in a worse optimum than one that follows
    the profile outwards. Where the search closes in on such a fit, the fit is repeated
    from its neighbour inside; if its excess then is negative, the search goes on.
    """
    excess, rise, inside, span = profile.excess, profile.calibration.rise, 0.0, None
    steep = STEEP
    try:
        for _ in range(MOST_RESUMED):
            span = span or bracket(
                excess,
                rise=rise,
                inside=inside,
                reach=profile.reach,
                limit=profile.limit,
            )
            if span is None:
                return ProfileEnd(max(profile.limit, 0.0), "bound")
            inside, outside = root(excess, *span, steep=steep * rise)
            if inside == outside:
                return ProfileEnd(profile.seen[outside].distance, "likelihood")
            before = profile.seen[outside].excess
            value = profile.follow(inside, outside)
            same = before - value <= CLOSE_ENOUGH * rise
            if same and np.isinf(steep):
                return ProfileEnd(profile.seen[outside].distance, "likelihood")
            # The same cost again: not another valley, but a profile that is steep.
            steep = np.inf if same else STEEP
            span = (inside, outside) if value >= 0.0 else None
            inside = outside
    except NotFound:
        pass
    return ProfileEnd(float("nan"), "not found")


class _Jump(Exception):
    pass


def root(
    excess: Callable[[float], float],
    inside: float,
    outside: float,
    *,
    steep: float = np.inf,
) -> tuple[float, float]:
    """Find the zero of an excess between two distances where its signs differ.

    By Brent's method, which ends where the excess is 0. Where the cost is a parabola
    the excess is linear, and the first guess is the root. Returns the root twice, or
    both sides of a jump, steeper than `steep` in a narrow bracket, the inner one first.
    """
    from scipy.optimize import brentq

    low, high = (inside, excess(inside)), (outside, excess(outside))
    if high[1] == 0.0:
        return outside, outside

    def watched(distance: float) -> float:
        nonlocal low, high
        value = excess(distance)
        if value < 0.0:
            low = max(low, (distance, value))
        else:
            high = min(high, (distance, value))
        width, rise = high[0] - low[0], high[1] - low[1]
        if value != 0.0 and width < NARROW * outside and rise * outside > steep * width:
            raise _Jump
        return value

    try:
        brentq(watched, inside, outside, xtol=1e-4 * outside)
    except _Jump:
        return low[0], high[0]
    return high[0] if high[1] == 0.0 else low[0], high[0]


def bracket(
    excess: Callable[[float], float],
    *,
    rise: float,
    inside: float,
    reach: float,
    limit: float,
) -> tuple[float, float] | None:
    """Return two distances with the end between them; None if it is beyond the limit.

    The distance grows step by step; where a fit does not converge, the step is halved.
    """
    outside, lost = max(reach, 1.2 * inside), np.inf
    while inside < limit:
        outside = min(outside, limit)
        try:
            value = excess(outside)
        except NotFound:
            value, lost = -rise, outside
        else:
            if value >= 0.0:
                return inside, outside
            inside = outside
        if lost - inside < NARROW * (inside + reach):
            raise NotFound
        grown = float(np.clip(1.05 * rise / (value + rise + 1e-300), 1.2, 2.0))
        outside = min(inside * grown if inside else np.inf, 0.5 * (inside + lost))
    return None


class _Rest(NamedTuple):
    """End of a fit with a parameter held at a distance from the calibration.

    `excess` is the root of the rise of twice the cost, minus that at the end sought.
    """

    distance: float
    z: HostArray
    excess: float


class _Profile:
    """Fits with one parameter held at several distances on one side."""

    def __init__(self, calibration: _Calibration, column: int, sign: int):
        self.space = space = calibration.evaluate.numbered.space
        variance = calibration.covariance[column, column]
        self.calibration, self.column, self.sign = calibration, column, sign
        self.std = float(np.sqrt(variance))
        self.limit = room_beside(space, calibration.z, column, sign)
        self.reach = min(float(calibration.reach[column]), self.limit)
        self.least_fall = CLOSE_ENOUGH * calibration.rise**2
        self.path = sign * calibration.covariance[column] / variance
        self.seen = {0.0: _Rest(0.0, calibration.z, -calibration.rise)}

    def excess(self, distance: float) -> float:
        """Return the excess of the fit at a distance; 0 within the tolerance."""
        if distance not in self.seen:
            within = [other for other, rest in self.seen.items() if rest.excess <= 0.0]
            near = min(within, key=lambda other: abs(other - distance))
            self.seen[distance] = self._fit(near, distance)
        return self.seen[distance].excess

    def follow(self, inside: float, distance: float) -> float:
        """Repeat a fit from a neighbour inside; return the lower excess of both."""
        again = self._fit(inside, distance)
        if again.excess < self.seen[distance].excess:
            self.seen[distance] = again
        return self.seen[distance].excess

    def _fit(self, near: float, distance: float) -> _Rest:
        calibration = self.calibration
        start = self.seen[near].z + (distance - near) * self.path
        inside = bool(distance < self.limit)
        firm = FIRM if inside else 10.0 * FIRM
        pin = Pin(
            jnp.asarray(self.column),
            jnp.asarray(calibration.z[self.column] + self.sign * distance),
            jnp.asarray(firm / self.std) / calibration.evaluate.numbered.level,
        )
        run = self._pinned(self.space, pin, start, to_the_end=inside)
        rest = self._rest(distance, pin, run)
        if rest is None or (not run.converged and rest.excess > 0.0):
            again = run.z if np.isfinite(run.cost) else self.seen[near].z
            run = self._pinned(self.space.in_plain_steps(), pin, again)
            rest = self._rest(distance, pin, run)
        if rest is None:
            raise NotFound
        return rest

    def _rest(self, distance: float, pin: Pin, run: Run) -> _Rest | None:
        """Return the end of a fit, or None if it says nothing about the profile.

        A fit that has not converged bounds the profile from above. So it says enough
        where that bound is below the end, or where its cost hardly falls any more.
        """
        far, higher = self._check(pin, run.z, run.cost)
        if not np.isfinite(higher):
            return None
        rise = self.calibration.rise
        value = float(np.sqrt(max(higher, 0.0)) - rise)
        near = abs(value) <= CLOSE_ENOUGH * rise
        stands = self._stands_still(run.errors[np.isfinite(run.errors)] ** 2)
        if not (run.converged or stands) and (near or value > 0.0):
            return None
        value = 0.0 if near else value
        return _Rest(distance + self.sign * far, run.z, value)

    def _stands_still(self, squares: Sequence[float] | HostArray) -> bool:
        """Return whether a fit stands still, as exactly as an end is sought."""
        if len(squares) <= STEADY:
            return False
        return bool(squares[-1 - STEADY] - squares[-1] <= self.least_fall)

    def _pinned(
        self, space: ParameterSpace, pin: Pin, start, *, to_the_end: bool = True
    ) -> Run:
        """Calibrate with the parameter held, or only until its value is allowed."""
        pinned = eqx.tree_at(lambda s: s.pin, space, pin, is_leaf=lambda x: x is None)
        evaluate, settings = self.calibration.evaluate, self.calibration.settings
        squares: list[float] = []

        def steady(state: CalibrationState) -> bool:
            squares.append(2.0 * float(state.evaluation.cost))
            if not to_the_end:
                _, higher = self._check(pin, state.z, state.evaluation.cost)
                if higher < self.calibration.rise**2:
                    return True
            return self._stands_still(squares)

        return minimise(
            evaluate.with_space(pinned), settings, jnp.asarray(start), steady
        )

    def _check(self, pin: Pin, z, cost) -> tuple[float, float]:
        """Return how far the parameter is from its pin, and twice the rise of cost."""
        z, cost = jnp.asarray(z), jnp.asarray(cost)  # a float would be compiled in
        problem = self.calibration.evaluate.numbered
        far, cost = _without_pin(problem, pin, z, cost)
        higher = 2.0 * (float(cost) - self.calibration.cost)
        if higher < -LOWER * self.calibration.rise**2:
            raise LowerCostFound(z, float(cost), self.calibration.cost)
        return float(far), higher


def room_beside(
    space: ParameterSpace, z: Float[Array | HostArray, " n_p"], column: int, sign: int
) -> float:
    """Return the distance to the bound of a parameter; half a turn if periodic."""
    each = np.asarray(z), np.asarray(space.lower()), np.asarray(space.upper())
    here, low, high = (float(values[column]) for values in each)
    if space.parameters[column].periodic:
        return 0.5 * (high - low)
    return high - here if sign > 0 else here - low


@eqx.filter_jit
def _without_pin(problem: Problem, pin: Pin, z, cost):
    """Return how far a parameter is from its pin, and the cost without the pin."""
    space = problem.space
    middle = space.start().at[pin.column].set(pin.value)
    far = space.shorter(z - middle)[pin.column]
    from_prior = problem.level * space.from_prior(z)[pin.column]
    by_pin = 0.5 * (problem.level * pin.weight * far) ** 2
    return far, cost - by_pin + 0.5 * from_prior**2
