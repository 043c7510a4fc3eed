"""Confidence intervals from the profile of the likelihood."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from scipy.optimize import brentq

from softcal_jax._typing import Array, Float, HostArray
from softcal_jax.calibration._evaluator import with_solver
from softcal_jax.calibration._problem import CalibrationProblem, without_names
from softcal_jax.calibration._result import IntervalEnd
from softcal_jax.calibration._runs import minimise
from softcal_jax.calibration._state import CalibrationSettings
from softcal_jax.equilibrium import Workers, program_key
from softcal_jax.fields import ParameterSpace, Pin

FIRM = 10.0
"""How much better than by the data a held parameter is known [-].

It gives way by a hundredth of its standard error, and the profile is that of where it
comes to rest.
"""

CLOSE_ENOUGH = 0.005
"""Error of an end of an interval, over its distance [-]."""

NARROW = 0.02
"""Step out, over how far it is, below which a fit that is lost stays so [-]."""

LOWER = 1e-3
"""Fall of twice the cost which tells that the fit is not in its minimum [-]."""


class ProfileEnd(NamedTuple):
    """One end of an interval.

    Attributes:
        distance: How far it is from the fit, scaled; nan if it was not found [-].
        why: What ends the interval: the likelihood; the bound of the parameter, or half
            a turn of an angle, which the data do not exclude; or that there is no end,
            since fits along the profile did not converge.
    """

    distance: float
    why: IntervalEnd


def profile_ends(
    problem: CalibrationProblem,
    settings: CalibrationSettings,
    z: Float[Array, " n_p"],
    W_ep: Float[HostArray, "n_e n_p"],
    cost: float,
    rise: float,
    which: Sequence[int],
) -> list[tuple[ProfileEnd, ProfileEnd]]:
    """How far parameters may go before the best fit of the others is too bad.

    A parameter is held, all others are calibrated, and the distance is looked for at
    which twice the cost has risen by `rise`^2 (Venzon and Moolgavkar, Appl. Stat. 37,
    1988). All ends are found side by side, on the cores of this machine.

    Args:
        problem: The calibration.
        settings: Settings of the outer loop, for the fits along the profile.
        z: Where the calibration ended, scaled [-].
        W_ep: Stacked compliances there, in noise units [-].
        cost: Half the sum of squared errors there, in noise units [-].
        rise: Root of the rise of twice the cost at the end of an interval [-].
        which: Numbers of the parameters.

    Returns:
        The lower and the upper end for each of them.

    Raises:
        LowerCostFound: If the calibration is not in the best optimum.
    """
    spread = _spread(problem, W_ep)
    at = _Fit(without_names(problem), settings, z, cost, rise, spread)
    jobs = [(column, sign) for column in which for sign in (-1.0, 1.0)]
    with Workers(problem.model, len(jobs)) as workers:
        key = program_key("pinned", at.problem, settings)
        ends = workers.map(lambda solver, job: _end(at, solver, *job), jobs, key)
    return list(zip(ends[::2], ends[1::2], strict=True))


class _Fit(NamedTuple):
    """A calibration where it ended."""

    problem: CalibrationProblem
    settings: CalibrationSettings
    z: Float[Array, " n_p"]
    cost: float
    rise: float
    covariance: Float[HostArray, "n_p n_p"]


def _spread(problem: CalibrationProblem, W) -> Float[HostArray, "n_p n_p"]:
    """Covariance to first order, finite whatever the data lack: with the bounds."""
    space = problem.space
    size = np.asarray(space.upper() - space.lower()) / np.sqrt(12.0)
    known = 1.0 / size**2 + np.asarray(space.prior_weights()) ** 2
    return np.linalg.inv(W.T @ W + np.diag(known))


class LowerCostFound(RuntimeError):
    """A fit along the profile found a lower cost than the calibration had.

    Attributes:
        z: Where, scaled: calibrate again with it as `start` [-].
    """

    def __init__(self, z: Float[Array, " n_p"], cost: float, before: float):
        """A cost below that of the calibration."""
        super().__init__(
            f"the cost falls from {before:.6g} to {cost:.6g} along the profile: the "
            "calibration is not in the best optimum. Calibrate again with `start` = "
            "the `z` of this error, or from more `starts`."
        )
        self.z = z


class _NotConverged(Exception):
    """A fit along the profile did not converge."""


def _end(at: _Fit, solver, column: int, sign: float) -> ProfileEnd:
    """One end of the interval of one parameter."""
    space = at.problem.space
    std = float(np.sqrt(at.covariance[column, column]))
    limit = _room(space, at.z, column, sign)
    path = at.covariance[column] / at.covariance[column, column]
    problem = with_solver(at.problem, solver)
    plain = eqx.tree_at(lambda p: p.space, problem, in_plain_steps(space))
    # Where fits along the profile came to rest, and how much too high their cost is.
    seen = {0.0: (0.0, np.asarray(at.z), -at.rise)}

    def excess(distance: float) -> float:
        if distance in seen:
            return seen[distance][2]
        near = min(seen, key=lambda other: abs(other - distance))
        start = seen[near][1] + sign * (distance - near) * path
        pin = Pin(
            jnp.asarray(column),
            at.z[column] + sign * distance,
            jnp.asarray(FIRM / std),
        )
        run = _pinned(problem, at.settings, jnp.asarray(start), pin)
        if not run.converged:
            run = _pinned(plain, at.settings, run.z, pin)
        if not run.converged:
            raise _NotConverged
        far, cost = _without_pin(space, pin, run.z, run.cost)
        higher = 2.0 * (float(cost) - at.cost)
        if higher < -LOWER:
            raise LowerCostFound(run.z, float(cost), at.cost)
        value = np.sqrt(max(higher, 0.0)) - at.rise
        value = 0.0 if abs(value) <= CLOSE_ENOUGH * at.rise else float(value)
        seen[distance] = (distance + sign * float(far), np.asarray(run.z), value)
        return value

    try:
        bracket = _bracket(excess, at.rise, std, limit)
        if bracket is None:
            return ProfileEnd(max(limit, 0.0), "bound")
        # Ended by `excess`, which is zero where it is close enough.
        found: float = brentq(excess, *bracket, xtol=1e-6 * std)  # pyright: ignore
        excess(found)
    except _NotConverged:
        return ProfileEnd(float("nan"), "not converged")
    return ProfileEnd(seen[found][0], "likelihood")


def _bracket(
    excess: Callable[[float], float], rise: float, std: float, limit: float
) -> tuple[float, float] | None:
    """Two distances with the end between them; None if it is beyond the limit.

    Further and further out, and half the way back where a fit does not converge.
    """
    inside, outside, lost = 0.0, rise * std, np.inf
    while inside < limit:
        outside = min(outside, limit)
        try:
            value = excess(outside)
        except _NotConverged:
            value, lost = -rise, outside
        else:
            if value >= 0.0:
                return inside, outside
            inside = outside
        if lost - inside < NARROW * (inside + std):
            raise _NotConverged
        grown = float(np.clip(1.05 * rise / (value + rise + 1e-300), 1.2, 2.0))
        outside = min(inside * grown if inside else np.inf, 0.5 * (inside + lost))
    return None


def _room(space: ParameterSpace, z, column: int, sign: float) -> float:
    """How far a parameter may go; half a turn if it is periodic."""
    down, up = space.room(z)
    room = float(up[column] if sign > 0 else -down[column])
    turn = float(space.upper()[column] - space.lower()[column])
    return min(room, 0.5 * turn) if np.isinf(room) else room


def in_plain_steps(space: ParameterSpace) -> ParameterSpace:
    """The same parameters with steps of moduli and angles, not of tensors.

    Where both moduli of an axis are equal a step of tensors has a kink: beyond it the
    axis is another one. With their order as a constraint an optimum there is regular.

    Args:
        space: The parameters.
    """
    order = [(small, large) for small, large, _ in space.axes]
    return ParameterSpace(space.entries, order=(*space.order, *order), pin=space.pin)


@eqx.filter_jit
def _pinned(problem: CalibrationProblem, settings: CalibrationSettings, start, pin):
    """The calibration with one parameter held."""
    add = partial(eqx.tree_at, lambda p: p.space.pin, is_leaf=lambda x: x is None)
    return minimise(add(problem, pin), settings, start)


@eqx.filter_jit
def _without_pin(space: ParameterSpace, pin: Pin, z, cost):
    """How far beyond its pin a parameter lies, and the cost without the pin."""
    middle = space.start().at[pin.column].set(pin.value)
    far = space.shorter(z - middle)[pin.column]
    own = space.from_prior(z)[pin.column]
    return far, cost - 0.5 * (pin.weight * far) ** 2 + 0.5 * own**2
