"""The search of inverse control: descents from the start and from elsewhere.

A descent takes steps from one start towards one aim. It ends at the optimum nearest to
its start, which need not be the best one.
"""

import warnings
from collections.abc import Iterator, Sequence
from operator import attrgetter
from typing import NamedTuple

import jax
import numpy as np

from softcal_jax._results import RESULTS
from softcal_jax._text import SoftcalWarning
from softcal_jax._typing import Float, HostArray
from softcal_jax.calibration import (
    OUTSIDE,
    CalibrationState,
    Evaluation,
    descend,
    initial_state,
)
from softcal_jax.control._command import Command
from softcal_jax.control._result import OUTCOMES, Attempt, StepRecord

ENDED = 1e-3
"""Step without an equilibrium at which these count as ended, as `step_tol` [-]."""

PATIENCE = 3  # steps in a row of an exploring descent of which some must come closer

CLOSER = 0.5
"""Largest ratio of the costs after and before these steps that counts as closer [-]."""

SHORTEST_PIECE, FIRST_PIECE = 1 / 8, 1 / 4
"""Smallest and first share of the way to the goal that a continuation takes [-]."""

PIECES = 4
"""Number of pieces in which inputs are driven to another start if one is too far."""

NEAREST = 1 / 64
"""To which share of the inputs the last equilibrium towards a start is found [-]."""

SCANNED = 6  # inputs that a scan over the reach of a single one takes

EQUAL = 1e-3
"""Relative difference of costs below which two ends count as one minimum [-].

Of such ends the one found first counts; the descent from the start is the first.
"""

AGREEING, AS_FAR = 4, 0.25
"""Descents in a row that end as far from the goals as the best, and the share by which
their distances may differ: then the goals are far away, and other starts do not help.

Where goals can be reached, ends that miss them differ by factors.
"""


class Descent(NamedTuple):
    """How close a descent came, and how it ended; `outcome` is None while it can go on.

    `state` is where it came closest, `latest` where it is, and goes on from.
    """

    robot: Command
    state: CalibrationState
    latest: CalibrationState
    outcome: OUTCOMES | None = None
    records: tuple[StepRecord, ...] = ()

    @property
    def here(self) -> Evaluation:
        return self.state.evaluation

    @property
    def met(self) -> bool:
        return self.outcome is not None and bool(self.outcome == OUTCOMES.met)

    @property
    def ended(self) -> bool:
        """Whether even a short step leads to no equilibrium."""
        return bool(self.latest.lost) and float(self.latest.step_bound) < ENDED

    @property
    def keeps_limits(self) -> bool:
        """Whether what follows the actuators is within its limits."""
        return float(self.state.recent_excess[0]) <= OUTSIDE


class ControlWarning(SoftcalWarning):
    """A goal or a start that is probably a mistake."""


def approached(robot: Command, guess: Float[HostArray, "n_points 3"]) -> Evaluation:
    """Solve at the start, or as far on the way to it from no input as there are any.

    Warns:
        ControlWarning: If the start has no equilibrium, but a share of it has one.
    """
    asked, at = robot.start, jax.device_put(guess[None])
    start = robot(jax.device_put(asked), at)
    if start.equilibrium.converged[0]:
        return start
    none, share, piece = np.clip(0.0, *robot.box), 0.0, 0.5
    here = robot(*jax.device_put((none, np.zeros(at.shape))))
    if not here.equilibrium.converged[0]:
        return start
    while share < 1.0 and piece >= NEAREST:
        value = jax.device_put(none + (share + piece) * (asked - none))
        tried = robot(value, here.equilibrium.displacement)
        if tried.equilibrium.converged[0]:
            here, share = tried, share + piece
            piece = min(2.0 * piece, 1.0 - share)
        else:
            piece *= 0.5
    if share < 1.0:
        text = f"the start has no equilibrium: the search begins at {100 * share:.3g} %"
        warnings.warn(f"{text} of its inputs, which has one.", ControlWarning, 4)
    return here


def begin(robot: Command, here: Evaluation) -> Descent:
    """Return a descent before its first step."""
    if here.ok:
        robot, here = robot.weighing_energy(here)
    state = initial_state(robot.settings.loop, here)
    first = Descent(robot, state, state)
    if here.ok:
        return first._replace(outcome=_outcome(first))
    result = robot.solution(here).result
    singular = (result == RESULTS.converged) | (result == RESULTS.singular)
    outcome = OUTCOMES.singular if bool(singular) else OUTCOMES.no_equilibrium
    return first._replace(outcome=outcome)


def continued(start: Descent, *, explore: bool = False) -> Descent:
    """Take steps, as a calibration does, until the goals are met or no step helps.

    Where it gives up it ends where it came closest, as single steps may lead away. With
    `explore` it does once steps hardly come closer any more. Near a goal that is met,
    the error falls tenfold with each step; at a fold of the map from inputs to
    effectors, most steps are spent on the last digits of a minimum. A KeyboardInterrupt
    carries the descent so far.
    """
    now, robot = start, start.robot

    def note(state: CalibrationState) -> None:
        nonlocal now
        step = StepRecord(
            size=float(np.abs(state.lambda_p).max()),
            cost=float(state.evaluation.cost),
            violation=float(state.recent_excess[0]),
            kkt_residual=float(state.kkt_residual),
            newton_steps=int(state.newton_steps[0]),
            accepted=bool(state.accepted),
        )
        new = Descent(robot, state, state, records=(*now.records, step))
        new = new._replace(outcome=_outcome(new))
        if not (new.met or state.converged) and _closer(robot, now, new):
            new = new._replace(state=now.state)
            new = new._replace(outcome=_outcome(new))
        now = new

    enough = lambda _: now.outcome is not None or (explore and _slow(now.records))
    try:
        descend(robot, robot.settings.loop, start.latest, note, enough)
    except KeyboardInterrupt:
        interrupted = now._replace(outcome=OUTCOMES.interrupted)
        raise KeyboardInterrupt(interrupted) from None
    return now


def _slow(records: Sequence[StepRecord]) -> bool:
    if len(records) <= PATIENCE:
        return False
    before, since = records[-1 - PATIENCE], records[-PATIENCE:]
    cost, violation = (min(map(attrgetter(k), since)) for k in ("cost", "violation"))
    return cost > CLOSER * before.cost and violation >= CLOSER * before.violation


def _outcome(now: Descent) -> OUTCOMES | None:
    """Determine how the search has ended; None while it goes on."""
    state, settings, kept = now.latest, now.robot.settings, now.keeps_limits
    met = kept and now.robot.off(now.here) <= settings.tol
    if met and (settings.epsilon == 0.0 or state.converged):
        return OUTCOMES.met
    if state.converged or (now.ended and kept):
        return OUTCOMES.nearest
    if state.stalled or now.ended:
        return OUTCOMES.stalled if kept else OUTCOMES.limits_violated
    return OUTCOMES.max_steps if len(now.records) >= settings.max_steps else None


def search(
    robot: Command, guess: Float[HostArray, "n_points 3"]
) -> tuple[Descent, tuple[Attempt, ...]]:
    """Descend from the start; unless the goals are met, explore all other ways, too.

    The other ways are other starts, then a continuation of the goals from where the
    effectors are at the start. The first descent that meets the goals ends the search,
    and so do `AGREEING` ends. If none does, the best descent and the one from the start
    itself are taken to their ends. Returns the better one, with all attempts; if
    interrupted, the best so far.
    """
    at_start = approached(robot, guess)
    if not at_start.ok:
        return begin(robot, at_start), ()
    robot, at_start = robot.by_motion(at_start)
    first = begin(robot, at_start)
    tried, best = {"the start": first}, "the start"
    try:
        for way, descent in _ways(first):
            tried[way] = descent
            best = way if _better(robot, descent, tried[best]) else best
            if descent.met or _agree(robot, [*tried.values()]):
                break
        # A scan saw what else there is; elsewhere the start may still come closer.
        ends = (best,) if len(robot.free) == 1 else ("the start", best)
        for way in () if tried[best].met else dict.fromkeys(ends):
            tried[way] = continued(tried[way])
        if not _better(robot, tried[best], tried["the start"]):
            best = "the start"
    except KeyboardInterrupt as stop:
        for descent in stop.args:  # the one that was under way, if any
            tried["the last, interrupted"] = descent
            if not _better(robot, tried[best], descent):
                best = "the last, interrupted"
        ended = {"robot": robot, "outcome": OUTCOMES.interrupted}
        tried[best] = tried[best]._replace(**ended)
    return tried[best], tuple(
        Attempt(way, end.outcome, robot.off(end.here), len(end.records))
        for way, end in tried.items()
    )


def _agree(robot: Command, tried: Sequence[Descent]) -> bool:
    """Tell whether the last ends are as far from the goals as the best, in limits."""
    if len(tried) < AGREEING or not all(end.here.ok for end in tried):
        return False
    off = [np.linalg.norm(robot.residuals(end.here)) for end in tried]
    near = max(off[-AGREEING:]) <= (1.0 + AS_FAR) * min(off)
    return bool(near) and all(end.keeps_limits for end in tried)


def _ways(first: Descent) -> Iterator[tuple[str, Descent]]:
    robot = first.robot
    others = robot.settings.other_starts > 0
    nearest = continued(first, explore=others)
    yield "the start", nearest
    if not others:
        return
    if len(robot.free) == 1:
        for k, start in enumerate(_scanned(first, nearest), start=1):
            yield f"other start {k}, of a scan", continued(start, explore=True)
        return
    for k, z in enumerate(_other_starts(first), start=1):
        there = _driven(robot, first.here, z)
        if there is not None:
            yield f"other start {k}", continued(begin(robot, there), explore=True)
    over_goals = _over_goals(robot, first.here)
    if over_goals is not None:
        yield "the start, over a continuation of the goals", over_goals


def _scanned(first: Descent, nearest: Descent) -> list[Descent]:
    """Drive a single input over its reach, and return where the goals are nearest.

    These are the minima over the scan, the lowest first, but for that which is found
    already. In each direction the scan ends where there is no equilibrium any more.
    """
    robot, start, along = first.robot, float(first.state.z[0]), [nearest]
    (low,), (high,) = _reach(first)
    values = np.linspace(low, high, SCANNED)
    for way in (values[values < start][::-1], values[values > start]):
        here: Evaluation | None = first.here
        for value in way:
            here = _driven(robot, here, np.array([value]))
            if here is None:
                break
            along.append(begin(robot, here))
    along.sort(key=lambda descent: float(descent.state.z[0]))
    beside = lambda k: along[max(k - 1, 0) : k] + along[k + 1 : k + 2]
    lowest = [
        descent
        for k, descent in enumerate(along)
        if descent is not nearest
        and all(_better(robot, descent, other) for other in beside(k))
    ]
    return sorted(lowest, key=lambda descent: tuple(_parts(robot, descent)))


def _over_goals(robot: Command, first: Evaluation) -> Descent | None:
    """Descend towards goals that move from where the effectors start to the real goals.

    With r_0 the errors there, the goals of a share s are those at which e - goal is
    (1 - s) r_0. Each share starts at the inputs that met the one before. None if not
    even the smallest share is met.
    """
    goal = np.asarray(robot.problem.configurations.effectors.measured)[0]
    off = np.asarray(first.effectors)[0] - goal
    here, share, piece = first, 0.0, FIRST_PIECE
    while share + piece < 1.0 and piece >= SHORTEST_PIECE:
        aimed = robot.towards(goal + (1.0 - share - piece) * off)
        start = begin(aimed, aimed.weighed(here.z, here.response))
        descent = continued(start, explore=True)
        if descent.met:
            here, share, piece = descent.here, share + piece, 2.0 * piece
        else:
            piece *= 0.5
    if share == 0.0:
        return None
    there = robot.weighed(here.z, here.response)
    return continued(begin(robot, there), explore=True)


def _other_starts(first: Descent) -> Float[HostArray, "n_starts n_p"]:
    """Choose inputs that fill what the limits and the reach of a step leave.

    They are a Latin hypercube and its middle, those near the start first: if several
    actuations meet the goals, one near the start is preferred to one far from it.
    """
    settings, z = first.robot.settings, np.asarray(first.state.z)
    low, high = _reach(first)
    # Here, so that commands which do not need it do not wait for it.
    from scipy.stats.qmc import LatinHypercube

    shares = np.full((settings.other_starts, low.size), 0.5)
    shares[1:] = LatinHypercube(low.size, rng=0).random(settings.other_starts - 1)
    starts = low + shares * (high - low)
    away = np.linalg.norm(starts - z, axis=1)
    # The middle may be the start itself, which needs no second descent.
    return starts[np.argsort(away)][np.sort(away) > settings.step_tol]


def _reach(first: Descent) -> Float[HostArray, "2 n_p"]:
    """Return the lowest and highest inputs within limits and the reach of a step."""
    reach, z = first.robot.settings.max_step_bound, np.asarray(first.state.z)
    return np.clip([z - reach, z + reach], *first.robot.box)


def _driven(
    robot: Command, first: Evaluation, z: Float[HostArray, " n_p"]
) -> Evaluation | None:
    """Drive the robot from its start to other inputs; None if it does not get there.

    It is driven rather than solved anew, so that it stays on the branch of equilibria
    on which it is commanded.
    """
    for pieces in (1, PIECES):
        here = first
        for left in range(pieces, 0, -1):
            here = robot.moved(here, (z - np.asarray(here.z)) / left)
            if not here.ok:
                break
        else:
            return here
    return None


def _better(robot: Command, descent: Descent, than: Descent) -> bool:
    """Compare two ends: goals that are met first, then kept limits, then the cost."""
    if descent.met or than.met:
        return descent.met
    return _closer(robot, descent, than)


def _closer(robot: Command, descent: Descent, than: Descent) -> bool:
    """Tell whether a state keeps limits better, or comes clearly closer."""
    each = _parts(robot, descent), _parts(robot, than)
    for new, old in zip(*each, strict=True):
        if abs(new - old) > EQUAL * max(new, old):
            return bool(new < old)
    return False


def _parts(robot: Command, descent: Descent) -> Float[HostArray, "2"]:
    """Return exceeded limits and the cost of errors; below the tolerance they tie."""
    cost = 0.5 * np.sum(robot.residuals(descent.here) ** 2)
    excess = float(descent.state.recent_excess[0])
    return np.maximum([excess, cost], [OUTSIDE, 0.5 * robot.settings.tol**2])
