"""The search of inverse control: descents from other starts and over a continuation.

A descent ends at the optimum nearest to its start, which need not be the best one.
"""

from collections.abc import Iterator, Mapping

import equinox as eqx
import numpy as np

from softcal_jax._typing import Float, HostArray
from softcal_jax.control._descent import (
    Arrival,
    Descent,
    begin,
    descend,
    differentiated,
    moved,
    reached,
)
from softcal_jax.control._result import Attempt
from softcal_jax.control._step import ROUNDING, Command, parts

SHORTEST_PIECE, FIRST_PIECE = 1 / 8, 1 / 4
"""Smallest and first share of the way to the goal that a continuation takes [-]."""

PIECES = 4
"""Number of pieces in which inputs are driven to another start if one is too far."""

EQUAL = 1e-3
"""Relative difference of costs below which two ends count as one minimum [-].

Of such ends the one found first counts; the descent from the start is the first.
"""


def search(
    command: Command, guess: Float[HostArray, "n_points 3"]
) -> tuple[Descent, tuple[Attempt, ...]]:
    """Descend from the start; unless the goals are met, explore all other ways, too.

    The other ways are other starts, then a continuation of the goals from where the
    effectors are at the start. The first descent that meets the goals ends the search.
    If none does, the best descent and the one from the start itself are taken to their
    ends. Returns the better one, with all attempts.
    """
    at_start = reached(command, command.start, guess)
    first = begin(command, differentiated(command, at_start))
    if first.linear is None:
        return first, ()
    tried: dict[str, Descent] = {}
    best = "the start"
    for way, descent in _ways(command, first):
        tried[way] = descent
        if descent.met:
            return descent, _attempts(command, tried)
        best = way if _better(command, descent, tried[best]) else best
    for way in dict.fromkeys(("the start", best)):
        tried[way] = descend(command, tried[way])
    if not _better(command, tried[best], tried["the start"]):
        best = "the start"
    return tried[best], _attempts(command, tried)


def _ways(command: Command, first: Descent) -> Iterator[tuple[str, Descent]]:
    others = command.settings.other_starts > 0
    yield "the start", descend(command, first, explore=others)
    if not others:
        return
    for k, value in enumerate(_other_starts(command, first), start=1):
        arrival = _driven(command, first.arrival, value)
        if arrival is not None:
            descent = descend(command, begin(command, arrival), explore=True)
            yield f"other start {k}", descent
    continued = _continued(command, first.arrival)
    if continued is not None:
        yield "the start, over a continuation of the goals", continued


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
    assert first.linear is not None
    n, reach = command.settings.other_starts, command.settings.max_step_bound
    (lower, upper), value = command.box(), first.arrival.value
    scale = first.linear.scale
    # Here, so that commands which do not need it do not wait for it.
    from scipy.stats.qmc import LatinHypercube

    low = np.maximum(lower, value - reach * scale)
    high = np.minimum(upper, value + reach * scale)
    shares = np.full((n, low.size), 0.5)
    shares[1:] = LatinHypercube(low.size, rng=0).random(n - 1)
    starts = low + shares * (high - low)
    away = np.linalg.norm((starts - value) / scale, axis=1)
    # The middle may be the start itself, which needs no second descent.
    return starts[np.argsort(away)][np.sort(away) > command.settings.step_tol]


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


def _attempts(command: Command, tried: Mapping[str, Descent]) -> tuple[Attempt, ...]:
    error = lambda end: np.abs(command.residuals(end.arrival.compliance.state)).max()
    return tuple(
        Attempt(way, descent.outcome, float(error(descent)), len(descent.records))
        for way, descent in tried.items()
    )


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
