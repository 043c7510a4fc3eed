"""The search of inverse control: descents from the start and from elsewhere.

A descent takes steps from one start towards one aim. It ends at the optimum nearest to
its start, which need not be the best one.
"""

import warnings
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from softcal_jax._results import RESULTS
from softcal_jax._text import SoftcalWarning
from softcal_jax._typing import Float, HostArray
from softcal_jax.control._inputs import (
    ActuatorCompliance,
    ActuatorReadings,
    actuator_compliance,
    actuator_readings,
    with_inputs,
)
from softcal_jax.control._result import OUTCOMES, Attempt, StepRecord
from softcal_jax.control._step import (
    ROUNDING,
    Command,
    Decision,
    Linear,
    all_errors,
    decide,
    follow_room,
    limited_step,
    linearise,
    parts,
    violation,
)
from softcal_jax.equilibrium import EquilibriumSolution, solve_equilibrium

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

NOWHERE = np.full(2, np.inf)  # the parts of a step that leads to no equilibrium


class Reached(NamedTuple):
    """The equilibrium at some inputs, slack cables wound up, and the readings there."""

    value: Float[HostArray, " n_a"]
    solution: EquilibriumSolution
    state: ActuatorReadings


class Arrival(NamedTuple):
    """An equilibrium with its derivatives, which are nan where there is none."""

    value: Float[HostArray, " n_a"]
    solution: EquilibriumSolution
    compliance: ActuatorCompliance

    @property
    def stands(self) -> bool:
        return bool(np.isfinite(self.compliance.W_ea).all())


class Descent(NamedTuple):
    """Where a descent is, what followed from its last step, and how it ended.

    `linear` is None without derivatives, `outcome` while it can go on.
    """

    arrival: Arrival
    linear: Linear | None
    decision: Decision
    outcome: OUTCOMES | None = None
    records: tuple[StepRecord, ...] = ()

    @property
    def met(self) -> bool:
        return self.outcome is not None and bool(self.outcome == OUTCOMES.met)


def reached(
    command: Command,
    value: Float[HostArray, " n_a"],
    guess: Float[HostArray, "n_points 3"],
) -> Reached:
    """Solve for the equilibrium at inputs within their limits; wind up slack cables.

    Winding them up until they are just taut does not change the equilibrium, but a
    slack cable has no effect on the robot and so no derivative, whereas a taut one has.
    """
    lower, upper = command.box()
    value = np.clip(value, lower, upper)
    lane = with_inputs(command.lane, jnp.asarray(value))
    start, newton = jnp.asarray(guess), command.settings.newton
    solution = solve_equilibrium(command.model, lane, guess=start, settings=newton)
    state = _readings(command.model, lane, solution)
    wound = np.maximum(value, np.minimum(state.displacements, upper))
    cable = command.model.mechanism.actuators.unilateral
    cable = cable & np.asarray(lane.actuation.by_displacement) & (upper > lower)
    return Reached(np.where(cable, wound, value), solution, state)


_readings = eqx.filter_jit(actuator_readings)


class ControlWarning(SoftcalWarning):
    """A goal or a start that is probably a mistake."""


def approached(command: Command, guess: Float[HostArray, "n_points 3"]) -> Reached:
    """Solve at the start, or as far on the way to it from no input as there are any.

    Warns:
        ControlWarning: If the start has no equilibrium, but a share of it has one.
    """
    start = reached(command, command.start, guess)
    if start.solution.converged:
        return start
    none, share, piece = np.clip(0.0, *command.box()), 0.0, 0.5
    here = reached(command, none, np.zeros_like(guess))
    if not here.solution.converged:
        return start
    while share < 1.0 and piece >= NEAREST:
        value = none + (share + piece) * (command.start - none)
        tried = reached(command, value, np.asarray(here.solution.displacement))
        if tried.solution.converged:
            here, share = tried, share + piece
            piece = min(2.0 * piece, 1.0 - share)
        else:
            piece *= 0.5
    if share < 1.0:
        text = f"the start has no equilibrium: the search begins at {100 * share:.3g} %"
        warnings.warn(f"{text} of its inputs, which has one.", ControlWarning, 4)
    return here


def differentiated(command: Command, equilibrium: Reached) -> Arrival:
    """Add the derivatives. A factorization: only worth it for a step that is kept."""
    lane = with_inputs(command.lane, jnp.asarray(equilibrium.value))
    compliance = actuator_compliance(command.model, lane, equilibrium.solution)
    return Arrival(equilibrium.value, equilibrium.solution, compliance)


def moved(command: Command, base: Arrival, change: Float[HostArray, " n_a"]) -> Reached:
    """Solve for the equilibrium after a change of the inputs, from its prediction."""
    motion = np.tensordot(change, base.compliance.displacement, axes=1)
    guess = np.asarray(base.solution.displacement) + motion
    return reached(command, base.value + change, guess)


def begin(command: Command, arrival: Arrival) -> Descent:
    decision = Decision(command.settings.step_bound)
    if not arrival.stands:
        result = arrival.solution.result
        singular = (result == RESULTS.converged) | (result == RESULTS.singular)
        outcome = OUTCOMES.singular if bool(singular) else OUTCOMES.no_equilibrium
        return Descent(arrival, None, decision, outcome)
    linear = linearise(command, arrival.value, arrival.compliance)
    outcome = _outcome(command, arrival, linear, decision, [])
    return Descent(arrival, linear, decision, outcome)


def descend(command: Command, start: Descent, *, explore: bool = False) -> Descent:
    """Repeat: linearise, solve the QP, try the step, keep it if it helps.

    With `explore` it stops once steps hardly come closer any more. Near a goal that is
    met, the error falls tenfold with each step; at a fold of the map from inputs to
    effectors, most steps are spent on the last digits of a minimum. A KeyboardInterrupt
    carries the descent so far.
    """
    arrival, linear, decision, outcome, records = start
    settings, records = command.settings, list(records)
    try:
        while outcome is None and not (explore and _slow(records)):
            assert linear is not None
            qp = limited_step(linear, jnp.asarray(decision.step_bound))
            step = np.asarray(qp.lambda_p)
            equilibrium = moved(command, arrival, step * linear.scale)
            tried, before = NOWHERE, decision
            if equilibrium.solution.converged:
                room = follow_room(command, equilibrium.state, linear.length)
                off = all_errors(command, equilibrium.state, linear.energy)
                tried = parts(room, off)
            decision = decide(linear, qp, tried, before, settings)
            if decision.accepted:
                candidate = differentiated(command, equilibrium)
                if candidate.stands:
                    at = candidate.value, candidate.compliance
                    arrival, linear = candidate, linearise(command, *at)
                else:
                    # A singular equilibrium counts as none: no step leads on from it.
                    decision = decide(linear, qp, NOWHERE, before, settings)
            records.append(
                StepRecord(
                    size=float(np.abs(step).max()),
                    cost=0.5 * float((linear.error**2).sum()),
                    violation=violation(linear.b),
                    kkt_residual=float(qp.kkt_residual),
                    newton_steps=int(equilibrium.solution.steps),
                    accepted=decision.accepted,
                )
            )
            outcome = _outcome(command, arrival, linear, decision, records)
    except KeyboardInterrupt:
        so_far = Descent(
            arrival, linear, decision, OUTCOMES.interrupted, tuple(records)
        )
        raise KeyboardInterrupt(so_far) from None
    return Descent(arrival, linear, decision, outcome, tuple(records))


def _slow(records: Sequence[StepRecord]) -> bool:
    if len(records) <= PATIENCE:
        return False
    before, now = records[-1 - PATIENCE], records[-1]
    return (
        now.cost > CLOSER * before.cost and now.violation >= CLOSER * before.violation
    )


def _outcome(
    command: Command,
    arrival: Arrival,
    linear: Linear,
    decision: Decision,
    records: Sequence[StepRecord],
) -> OUTCOMES | None:
    """Determine how the search has ended; None while it goes on."""
    settings = command.settings
    error = np.abs(command.residuals(arrival.compliance.state)).max()
    kept_limits = violation(linear.b) <= ROUNDING
    met = error <= settings.tol and kept_limits
    if met and (settings.epsilon == 0.0 or decision.vanished):
        return OUTCOMES.met
    if decision.vanished or (decision.ended and kept_limits):
        return OUTCOMES.nearest
    if decision.stalled or decision.ended:
        return OUTCOMES.stalled if kept_limits else OUTCOMES.limits_violated
    return OUTCOMES.max_steps if len(records) >= settings.max_steps else None


def search(
    command: Command, guess: Float[HostArray, "n_points 3"]
) -> tuple[Descent, tuple[Attempt, ...]]:
    """Descend from the start; unless the goals are met, explore all other ways, too.

    The other ways are other starts, then a continuation of the goals from where the
    effectors are at the start. The first descent that meets the goals ends the search,
    and so do `AGREEING` ends. If none does, the best descent and the one from the start
    itself are taken to their ends. Returns the better one, with all attempts; if
    interrupted, the best so far.
    """
    at_start = approached(command, guess)
    first = begin(command, differentiated(command, at_start))
    if first.linear is None:
        return first, ()
    tried, best = {"the start": first}, "the start"
    try:
        for way, descent in _ways(command, first):
            tried[way] = descent
            if descent.met or _better(command, descent, tried[best]):
                best = way
            if descent.met or _agree(command, [*tried.values()]):
                break
        # A scan saw what else there is; elsewhere the start may still come closer.
        ends = (best,) if _is_single(command) else ("the start", best)
        for way in () if tried[best].met else dict.fromkeys(ends):
            tried[way] = descend(command, tried[way])
        if not _better(command, tried[best], tried["the start"]):
            best = "the start"
    except KeyboardInterrupt as stop:
        for descent in stop.args:  # the one that was under way, if any
            tried["the last, interrupted"] = descent
            if not _better(command, tried[best], descent):
                best = "the last, interrupted"
        # Nothing holds the robot there: more steps would have followed.
        ended = {"outcome": OUTCOMES.interrupted, "linear": None}
        tried[best] = tried[best]._replace(**ended)
    error = lambda end: np.abs(command.residuals(end.arrival.compliance.state)).max()
    return tried[best], tuple(
        Attempt(way, end.outcome, float(error(end)), len(end.records))
        for way, end in tried.items()
    )


def _agree(command: Command, tried: Sequence[Descent]) -> bool:
    """Tell whether the last ends are as far from the goals as the best, in limits."""
    if len(tried) < AGREEING or any(end.linear is None for end in tried):
        return False
    off = [np.linalg.norm(command.residuals(d.arrival.compliance.state)) for d in tried]
    kept = [violation(d.linear.b) <= ROUNDING for d in tried if d.linear is not None]
    return all(kept) and bool(max(off[-AGREEING:]) <= (1.0 + AS_FAR) * min(off))


def _ways(command: Command, first: Descent) -> Iterator[tuple[str, Descent]]:
    others = command.settings.other_starts > 0
    nearest = descend(command, first, explore=others)
    yield "the start", nearest
    if not others:
        return
    if _is_single(command):
        for k, start in enumerate(_scanned(command, first, nearest), start=1):
            yield f"other start {k}, of a scan", descend(command, start, explore=True)
        return
    for k, value in enumerate(_other_starts(command, first), start=1):
        arrival = _driven(command, first.arrival, value)
        if arrival is not None:
            descent = descend(command, begin(command, arrival), explore=True)
            yield f"other start {k}", descent
    continued = _continued(command, first.arrival)
    if continued is not None:
        yield "the start, over a continuation of the goals", continued


def _is_single(command: Command) -> bool:
    lower, upper = command.box()
    return int(np.sum(upper > lower)) == 1


def _scanned(command: Command, first: Descent, nearest: Descent) -> list[Descent]:
    """Drive a single input over its reach, and return where the goals are nearest.

    These are the minima over the scan, the lowest first, but for that which is found
    already. In each direction the scan ends where there is no equilibrium any more.
    """
    low, high = _reach(command, first)
    (a,) = np.flatnonzero(high > low)
    start, along = first.arrival.value[a], [nearest]
    values = np.linspace(low[a], high[a], SCANNED)
    for way in (values[values < start][::-1], values[values > start]):
        arrival: Arrival | None = first.arrival
        for value in way:
            target = np.where(high > low, value, arrival.value)
            arrival = _driven(command, arrival, target)
            if arrival is None:
                break
            along.append(begin(command, arrival))
    along.sort(key=lambda descent: descent.arrival.value[a])
    beside = lambda k: along[max(k - 1, 0) : k] + along[k + 1 : k + 2]
    lowest = [
        descent
        for k, descent in enumerate(along)
        if descent is not nearest
        and all(_better(command, descent, other) for other in beside(k))
    ]
    return sorted(lowest, key=lambda descent: tuple(_parts(command, descent)))


def _continued(command: Command, first: Arrival) -> Descent | None:
    """Descend towards goals that move from where the effectors start to the real goals.

    With r_0 the errors there, the goals of a share s are those at which e - goal is
    (1 - s) r_0. Each share starts at the inputs that met the one before. None if not
    even the smallest share is met.
    """
    goal = np.asarray(command.lane.effectors.measured)
    off = np.asarray(first.compliance.state.effectors) - goal
    # The energy of the actuators is weighed once, at the goals themselves.
    plain = eqx.tree_at(lambda s: s.epsilon, command.settings, 0.0)
    arrival, share, piece = first, 0.0, FIRST_PIECE
    while share + piece < 1.0 and piece >= SHORTEST_PIECE:
        aim = goal + (1.0 - share - piece) * off
        lane = eqx.tree_at(lambda c: c.effectors.measured, command.lane, aim)
        aimed = command._replace(lane=lane, settings=plain)
        descent = descend(aimed, begin(aimed, arrival), explore=True)
        if descent.met:
            arrival, share, piece = descent.arrival, share + piece, 2.0 * piece
        else:
            piece *= 0.5
    if share == 0.0:
        return None
    return descend(command, begin(command, arrival), explore=True)


def _other_starts(command: Command, first: Descent) -> Float[HostArray, "n_starts n_a"]:
    """Choose inputs that fill what the limits and the reach of a step leave.

    They are a Latin hypercube and its middle, those near the start first: if several
    actuations meet the goals, one near the start is preferred to one far from it.
    """
    n, value = command.settings.other_starts, first.arrival.value
    low, high = _reach(command, first)
    # Here, so that commands which do not need it do not wait for it.
    from scipy.stats.qmc import LatinHypercube

    shares = np.full((n, low.size), 0.5)
    shares[1:] = LatinHypercube(low.size, rng=0).random(n - 1)
    starts = low + shares * (high - low)
    assert first.linear is not None
    away = np.linalg.norm((starts - value) / first.linear.scale, axis=1)
    # The middle may be the start itself, which needs no second descent.
    return starts[np.argsort(away)][np.sort(away) > command.settings.step_tol]


def _reach(command: Command, first: Descent) -> Float[HostArray, "2 n_a"]:
    """Return the lowest and highest inputs within limits and the reach of a step."""
    assert first.linear is not None
    (lower, upper), value = command.box(), first.arrival.value
    reach = command.settings.max_step_bound * first.linear.scale
    return np.stack(
        [np.maximum(lower, value - reach), np.minimum(upper, value + reach)]
    )


def _driven(
    command: Command, first: Arrival, value: Float[HostArray, " n_a"]
) -> Arrival | None:
    """Drive the robot from its start to other inputs; None if it does not get there.

    It is driven rather than solved anew, so that it stays on the branch of equilibria
    on which it is commanded.
    """
    for pieces in (1, PIECES):
        arrival = first
        for left in range(pieces, 0, -1):
            equilibrium = moved(command, arrival, (value - arrival.value) / left)
            arrival = differentiated(command, equilibrium)
            if not arrival.stands:
                break
        else:
            return arrival
    return None


def _better(command: Command, descent: Descent, than: Descent) -> bool:
    """Compare two ends: kept limits first, then the cost."""
    for new, old in zip(_parts(command, descent), _parts(command, than), strict=True):
        if abs(new - old) > EQUAL * max(new, old):
            return bool(new < old)
    return descent.met and not than.met


def _parts(command: Command, descent: Descent) -> Float[HostArray, "2"]:
    """Compute violated limits and the cost; below the tolerance they tie."""
    assert descent.linear is not None
    off = command.residuals(descent.arrival.compliance.state)
    floor = 10.0 * ROUNDING, 0.5 * command.settings.tol**2
    return np.maximum(parts(descent.linear.b, off), floor)
