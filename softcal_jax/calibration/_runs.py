"""The outer loop: from one start to its end, and from its mirror images."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from softcal_jax._module import Module
from softcal_jax._typing import Array, Bool, Float, HostArray
from softcal_jax.calibration._evaluation import Evaluator
from softcal_jax.calibration._problem import CalibrationSettings
from softcal_jax.calibration._step import (
    CalibrationState,
    decide,
    initial_state,
    propose,
)
from softcal_jax.fields import ParameterSpace
from softcal_jax.unknowns import Problem


def descend(
    evaluate: Evaluator,
    settings: CalibrationSettings,
    state: CalibrationState,
    note: Callable[[CalibrationState], None],
    enough: Callable[[CalibrationState], bool] = lambda _: False,
) -> CalibrationState:
    """Take steps until lambda_p vanishes, every step is refused, or `max_steps`.

    The loop of the paper, Sec. III. A step is several programs instead of one: the
    evaluation, which takes seconds to compile, serves the start and every step. `note`
    is called after each step, and `enough` says whether to stop before the end.
    """
    space, most = evaluate.numbered.space, settings.max_steps
    settings = settings.as_arrays()
    while not (state.ended or int(state.step) >= most or enough(state)):
        # The bounded QP for lambda_p, Eqs. (10) and (11).
        step = propose(space, settings, state)
        tried = state.evaluation
        if not step.vanishes:
            # Equilibria with p + S lambda_p, their errors and W_ep, Eqs. (7) to (9).
            before = tried.equilibrium.displacement
            tried = evaluate(step.z, step.guess, before, step.precise)
        state = decide(space, settings, state, step, tried)
        note(state)
    return state


NOTHING_LEFT = 1e-6
"""Mean squared error, in noise units, below which no other optimum is searched for."""

MOST_SETTLED = 3  # how often steps of tensors and plain ones take turns

LITTLE = 1e-3
"""Relative contrast of an axis and change of the cost at which steps of tensors end."""

FORETOLD = 0.25
"""Largest error of the cost that a linear model foretells, over the fall to it [-]."""

SAME_END = 0.05
"""Difference of cost below which two ends of a linear model count as one [-].

In noise units: such ends are a third of a standard error apart. The noise is that of
the known optimum, but at least a tenth of the stated one, as exact data show none.
"""

NO_FALL = 1e-6  # relative fall of the cost that is no way down [-]

admissible = eqx.filter_jit(lambda space, z: space.admissible(z))
_way_and_room = eqx.filter_jit(lambda s, a, b: (s.shorter(b - a), *s.room(a)))


class Run(Module):
    """End of the outer loop: scaled parameters and cost, infinite without equilibrium.

    `steps` counts those of mirrored runs, too; `errors` are the roots of twice the cost
    after each step of the first run, nan after its end [-].
    """

    z: Float[HostArray, " n_p"]
    cost: float
    steps: int
    converged: bool
    errors: Float[HostArray, " n_steps"]


def minimise(
    evaluate: Evaluator,
    settings: CalibrationSettings,
    start: Float[Array, " n_p"],
    enough: Callable[[CalibrationState], bool] = lambda _: False,
    note: Callable[[CalibrationState], None] = lambda _: None,
) -> Run:
    """Run the outer loop from one start, in scaled parameters, to its end.

    For `enough` and `note` see `descend`.
    """
    z = admissible(evaluate.numbered.space, start)
    state = initial_state(settings, evaluate.from_rest(z))
    costs = [float(state.evaluation.cost)]

    def noted(state: CalibrationState) -> None:
        costs.append(float(state.evaluation.cost))
        note(state)

    state = descend(evaluate, settings, state, noted, enough)
    errors = np.full(settings.max_steps + 1, np.nan)
    errors[: len(costs)] = np.sqrt(2.0 * np.array(costs))
    return Run(
        z=np.asarray(state.z),
        cost=costs[-1],
        steps=max(int(state.step), 1),
        converged=bool(state.converged),
        errors=errors,
    )


def settle(
    evaluate: Evaluator,
    settings: CalibrationSettings,
    state: CalibrationState,
    note: Callable[[CalibrationState], None],
) -> CalibrationState:
    """Take steps to an optimum, also to one where both moduli of an axis are equal.

    Steps of tensors go to and fro there, so plain steps go on where they gave up, see
    `ParameterSpace.in_plain_steps`. Plain steps cannot leave an isotropic body, right
    or wrong, since the angle has no effect on it; so their end only counts if steps of
    tensors find no way down from it.
    """
    space = evaluate.numbered.space
    if space.chart is None:
        return descend(evaluate, settings, state, note)
    small, large = space.chart.small, space.chart.large

    def to_and_fro(state: CalibrationState) -> bool:
        z, recent = np.asarray(state.z), np.asarray(state.recent_costs)
        if not np.isfinite(recent).all() or np.ptp(recent) > LITTLE * recent[0]:
            return False
        return bool(np.min(z[large] - z[small]) <= LITTLE)

    state = descend(evaluate, settings, state, note, to_and_fro)
    plain = evaluate.with_space(space.in_plain_steps())

    def again(state: CalibrationState) -> CalibrationState:
        new = initial_state(settings, state.evaluation)
        return replace(new, step=state.step, least_fall=state.least_fall)  # count on

    for _ in range(MOST_SETTLED):
        done = state.converged or state.step >= settings.max_steps
        if done or not state.evaluation.ok:
            break
        end = descend(plain, settings, again(state), note)
        if not end.converged:
            return end
        state = descend(evaluate, settings, again(end), lambda _: None)
        fall = float(end.evaluation.cost) - float(state.evaluation.cost)
        if fall <= NO_FALL * float(end.evaluation.cost):
            return end
        note(state)
    return state


class Image(NamedTuple):
    """A further run, from `signs` * (best end so far, or start) + `plus`.

    Unless it looks for another optimum `elsewhere`, it continues a run that reached
    `max_steps`.
    """

    signs: Float[HostArray, " n_p"]
    plus: Float[HostArray, " n_p"]
    elsewhere: bool = False
    of_start: bool = False

    def origin(
        self, best: Run, start: Float[HostArray, " n_p"]
    ) -> Float[HostArray, " n_p"]:
        """Return the scaled parameters from which the run starts."""
        return self.signs * (start if self.of_start else best.z) + self.plus


def images_of(space: ParameterSpace, mirror: bool) -> list[Image]:
    """List what a run tries: its start and, if `mirror`, images of it and of its end.

    A body that is loaded in or across its print plane hardly distinguishes an axis from
    its reflection (theta to -theta), and each has an optimum. So a run that ends with
    an error continues from its end with all axes reflected, then from its start with
    all axes reflected, then with each alone. If that fails, it takes the axes of its
    end and resets all else, in case the moduli went astray. Finally a best end that has
    not converged is continued, twice.
    """
    angles = [] if space.chart is None else list(space.chart.angle)
    n = len(space.names)
    as_is = Image(np.ones(n), np.zeros(n))
    if not (mirror and angles):
        return [as_is]

    def reflected(group, of_start: bool) -> Image:
        signs = np.ones(n)
        signs[group] = -1.0
        return Image(signs, np.zeros(n), elsewhere=True, of_start=of_start)

    each = [[i] for i in angles] if len(angles) > 1 else []
    turns = np.isin(np.arange(n), angles)
    as_given = np.where(turns, 0.0, space.start())
    return [
        as_is,
        reflected(angles, False),
        *(reflected(group, True) for group in (angles, *each)),
        Image(turns.astype(float), as_given, elsewhere=True),
        as_is,
        as_is,
    ]


def wanted(problem: Problem, best: Run, image: Image) -> bool:
    """Return whether an image is worth a run."""
    # A start without equilibrium has no end to continue from.
    lost = np.isinf(best.cost) and best.steps > 0
    measured = np.sum(np.asarray(problem.configurations.effectors.inverse_std) > 0.0)
    something_left = 2.0 * best.cost > NOTHING_LEFT * measured
    return not lost and bool(something_left if image.elsewhere else not best.converged)


def better(best: Run, new: Run) -> Run:
    """Return the lower of two ends, with the steps of both, the errors of the first.

    Of two ends of the same cost, within rounding, the converged one counts. Otherwise
    the lower one counts even if it has not converged, since the last images continue
    it.
    """
    same = math.isclose(new.cost, best.cost, rel_tol=1e-6, abs_tol=1e-9)
    if same and new.converged != best.converged:
        lower = new if new.converged else best
    else:
        lower = new if new.cost < best.cost else best
    errors = best.errors if best.steps else new.errors
    return replace(lower, steps=best.steps + new.steps, errors=errors)


class Basin(NamedTuple):
    """An optimum that a run has reached, and the best end of that run.

    `best` is None where the optimum may end an image early, but not a whole run: if the
    run itself reached it, or an image of a start did.
    """

    z: Float[HostArray, " n_p"]
    cost: float
    best: Run | None = None


def leads_to(space: ParameterSpace, state: CalibrationState, known: Basin) -> bool:
    """Return whether a run seems to be on its way into a known optimum.

    It does if the linear model of its errors foretells the cost there, and nothing
    clearly lower within the bounds.
    """
    # Here, so that commands which do not need it do not wait for it.
    from scipy.optimize import lsq_linear

    fall = float(state.evaluation.cost) - known.cost
    if fall <= 0.0:
        return False
    error, W = map(np.asarray, state.evaluation.rows)
    cost = lambda step: 0.5 * np.sum((error + W @ step) ** 2)
    ways = _way_and_room(space, state.z, jnp.asarray(known.z))
    way, down, up = map(np.asarray, ways)
    if abs(cost(way) - known.cost) > FORETOLD * fall:
        return False
    # A bound that the known optimum has reached may be off by rounding.
    bounds = np.minimum(down, way) - 1e-12, np.maximum(up, way) + 1e-12
    measured = int(np.any(W, axis=1).sum())
    noise = max(2.0 * known.cost / max(measured - len(way), 1), 0.01)
    best = lsq_linear(W, -error, bounds)
    near = cost(way) - cost(best.x) <= min(FORETOLD * fall, SAME_END * noise)
    return bool(best.success and near)


class Begun(NamedTuple):
    """A run between two images: the number done, and the best end so far.

    `z` and `cost` are those of the optimum that each image reached or led to; the cost
    is infinite if it did neither.
    """

    images: int
    best: Run
    z: Float[HostArray, "n_images n_p"]
    cost: Float[HostArray, " n_images"]


def not_begun(
    settings: CalibrationSettings, start: Float[Array, " n_p"], n_images: int
) -> Begun:
    """Return a run before its first image."""
    z, errors = np.asarray(start), np.full(settings.max_steps + 1, np.nan)
    best = Run(z=z, cost=np.inf, steps=0, converged=False, errors=errors)
    return Begun(0, best, np.zeros((n_images, len(z))), np.full(n_images, np.inf))


def run_start(
    evaluate: Evaluator,
    settings: CalibrationSettings,
    start: Float[Array, " n_p"],
    *,
    images: Sequence[Image],
    begun: Begun | None = None,
    known: Sequence[Basin] = (),
    note: Callable[[Begun], None] = lambda _: None,
    note_step: Callable[[int, CalibrationState | None], None] = lambda *_: None,
) -> Begun:
    """Run the outer loop from a start and its images to the end.

    `begun` is the progress of the run so far; `note` is called after each image,
    whether it was run or skipped, `note_step` before an image and after each of its
    steps. An image that leads to a `known` optimum ends there.
    If another run found that optimum, this run ends too, with that run's best end,
    unless its own is lower.
    """
    tried, best, z, cost = begun or not_begun(settings, start, len(images))
    first = np.asarray(start)
    while tried < len(images):
        i, image = tried, images[tried]
        origin, tried = image.origin(best, first), tried + 1
        # An axis at zero is its own image.
        before = [first, *(m.signs * first for m in images[:i] if m.of_start)]
        again = image.of_start and any(np.array_equal(origin, old) for old in before)
        if not again and wanted(evaluate.problem, best, image):
            reached = [Basin(z[k], cost[k]) for k in np.flatnonzero(np.isfinite(cost))]
            step = partial(note_step, i)
            step(None)
            end, optimum = _to(evaluate, settings, origin, (*known, *reached), step)
            if end.converged:
                this_image = np.arange(len(images)) == i
                z = np.where(this_image[:, None], end.z, z)
                cost = np.where(this_image, end.cost, cost)
            other = None if optimum is None else optimum.best
            if other is not None and other.cost <= best.cost:
                end = replace(other, steps=end.steps, errors=end.errors)
                tried = len(images)
            best = better(best, end)
        note(Begun(tried, best, z, cost))
    return Begun(tried, best, z, cost)


def _to(
    evaluate: Evaluator,
    settings: CalibrationSettings,
    origin: Float[HostArray, " n_p"],
    known: Sequence[Basin],
    note: Callable[[CalibrationState], None],
) -> tuple[Run, Basin | None]:
    """Run the outer loop to its end, or to a known optimum that it leads to."""
    optimum = None

    def ahead(state: CalibrationState) -> bool:
        nonlocal optimum
        leading = (k for k in known if leads_to(evaluate.numbered.space, state, k))
        optimum = next(leading, None)
        return optimum is not None

    end = minimise(evaluate, settings, jnp.asarray(origin), ahead, note)
    if optimum is not None:
        end = replace(end, z=optimum.z, cost=optimum.cost, converged=True)
    return end, optimum


def known_optima(runs: Sequence[Begun], images: Sequence[Image]) -> list[Basin]:
    """List the optima that runs reached, each with the first run that did."""
    known: dict[tuple[float, ...], Basin] = {}
    for run in runs:
        for z, cost, image in zip(run.z, run.cost, images, strict=True):
            if np.isfinite(cost):
                best = None if image.of_start else run.best
                known.setdefault(tuple(z.round(3)), Basin(z, float(cost), best))
    return [*known.values()]


def best_of(cost: Float[HostArray, " n"], converged: Bool[HostArray, " n"]) -> int:
    """Return the index of the lowest cost, among the converged runs if any is."""
    among = np.where(converged, cost, np.inf) if converged.any() else cost
    return int(np.argmin(among))
