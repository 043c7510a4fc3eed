"""All configurations with the calibrated parameters; those held out are solved."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import numpy as np

from softcal_jax._lanes import lane_of, stacked
from softcal_jax._results import RESULTS
from softcal_jax._typing import Array, Float, HostArray
from softcal_jax.calibration._configuration_result import (
    ConfigurationResult,
    configuration_results,
)
from softcal_jax.calibration._evaluation import Evaluator
from softcal_jax.calibration._noise import attachments
from softcal_jax.calibration._problem import Batch, CalibrationProblem, Task
from softcal_jax.calibration._starts import Start
from softcal_jax.calibration._step import CalibrationState
from softcal_jax.calibration._weighing import Weighed
from softcal_jax.configurations import Configuration, ConfigurationLanes, EffectorRecord
from softcal_jax.equilibrium import LoadPath, Model, Report, solve_equilibrium
from softcal_jax.fields import ParameterSpace, SetupParameter
from softcal_jax.sensitivity import Response


class Predicted(NamedTuple):
    """Model and configurations with the calibrated parameters, and their noise."""

    model: Model
    problem: CalibrationProblem
    response: Response
    fits: tuple[ConfigurationResult, ...]
    notes: tuple[str, ...]
    interrupted: bool


def predict(
    task: Task, batch: Batch, start: Start, weighed: Weighed, report: Report
) -> Predicted:
    """Describe all configurations at the optimum; solve those that were held out.

    `report` is called as by `equilibria`, with the parameters at the end.
    """
    z, n_fitted, everything = weighed.state.z, len(task.fitted), batch.everything
    before, response = start.evaluation.effectors, weighed.state.evaluation.response
    notes, interrupted = (), False
    if task.held_out:
        held = _held_out(
            Evaluator(everything.without_first(n_fitted), start.evaluate.workers),
            task.held_out,
            start=(start.z, lane_of(start.evaluation.response, -1)),
            end=(z, lane_of(response, -1)),
            report=report,
        )
        join = lambda *parts: np.concatenate([*map(np.asarray, parts)])
        before = join(before, held.before)
        notes, interrupted = held.notes, held.interrupted
        response = jax.device_put(jax.tree.map(join, response, held.response))
    assert everything.noise is not None
    noise = weighed.of_all(everything.noise, task.configurations)
    model = task.space.model_at(task.model, z)
    fits = configuration_results(
        model,
        task.configurations,
        _calibrated_lanes(task, batch, weighed.state),
        n_fitted=n_fitted,
        before=before,
        response=response,
        noise=noise,
    )
    problem = everything.with_noise(noise)
    return Predicted(model, problem, response, fits, notes, interrupted)


def _calibrated_lanes(
    task: Task, batch: Batch, state: CalibrationState
) -> ConfigurationLanes:
    """Return lanes with the calibrated parameters.

    Measured values are moved by the offsets of effectors whose displacement was fitted:
    what is left between measured and simulated values are the errors of that.
    """
    lanes = batch.lanes._replace(arrays=batch.everything.at(state.z)[1])
    effectors, noise = batch.fitted.configurations.effectors, batch.fitted.noise
    n_rows = effectors.measured.shape[1]
    of_row, axes, keys = attachments(task.configurations, lanes.effectors, n_rows)
    if not keys:
        return lanes
    assert noise is not None
    offsets = noise.attachment_offsets(effectors, state.evaluation.delta_e)

    def moved(lane: int, e: EffectorRecord) -> EffectorRecord:
        row = lane, e.index
        if of_row[row] < 0:
            return e
        return replace(e, measured=e.measured + axes[row] @ offsets[of_row[row]])

    records = tuple(
        tuple(moved(lane, e) for e in of_lane)
        for lane, of_lane in enumerate(lanes.effectors)
    )
    return lanes._replace(effectors=records)


class _HeldOut(NamedTuple):
    """Held-out configurations with the calibrated parameters; `before` by the start.

    `before` are effectors, nan without an equilibrium; `notes` say which have none.
    """

    before: Float[HostArray, "n_c n_rows 3"]
    response: Response
    notes: tuple[str, ...]
    interrupted: bool


class _Chain(NamedTuple):
    """Held-out configurations at some parameters: how each responds, once solved.

    `before` is the equilibrium of a configuration that was fitted, with the same
    parameters [m].
    """

    z: Float[Array, " n_p"]
    before: Float[Array, "n_points 3"]
    solved: list[Response]

    @classmethod
    def of(cls, z: Float[Array, " n_p"], fitted: Response, n: int) -> "_Chain":
        """Begin with `n` that have no equilibrium, beside a fitted one."""
        zeros = jax.tree.map(lambda leaf: np.zeros_like(np.asarray(leaf)), fitted)
        where = lambda response: response.equilibrium.result
        none = eqx.tree_at(where, zeros, RESULTS.max_steps)
        return cls(z, fitted.equilibrium.displacement, [none] * n)


def _held_out(
    evaluate: Evaluator,
    configurations: Sequence[Configuration],
    *,
    start: tuple[Float[Array, " n_p"], Response],
    end: tuple[Float[Array, " n_p"], Response],
    report: Report,
) -> _HeldOut:
    """Solve held-out configurations with the parameters at the end and at the start.

    Both come with the response of a configuration that was fitted, whose equilibrium
    robots with rigid bodies begin from. Near a limit point an equilibrium need not be
    found from rest: there the path of the configuration is followed by arc length, and
    its end is where the search begins anew. A configuration without equilibrium is left
    out with a note, as it must neither count as a prediction nor cost the user the fit;
    so are those that Ctrl-C cuts off. `report` is called as by `equilibria`, with the
    parameters at the end.
    """
    n = len(configurations)
    last, first = _Chain.of(*end, n), _Chain.of(*start, n)
    bodies = evaluate.problem.model.mechanism.bodies.n_bodies > 0
    groups = [range(n)] if bodies else [range(i, i + 1) for i in range(n)]
    carried: dict[int, float] = {}
    interrupted = False
    try:
        evaluate.workers.side_by_side(
            partial(_solve_group, evaluate, chain, group, told)
            for chain, told in ((last, report), (first, lambda *_: None))
            for group in groups
        )
        _follow_paths(evaluate, last, carried)
    except KeyboardInterrupt:
        interrupted = True
    response, before = stacked(last.solved), stacked(first.solved)
    converged = np.asarray(response.equilibrium.converged)
    notes = []
    for i in np.flatnonzero(~converged).tolist():
        why = "with the calibrated parameters it has no equilibrium"
        if i in carried:
            share = f"{100.0 * carried[i]:.3g} % of its load"
            why += f". Along its path (`LoadPath`) it carries at most {share}"
        elif interrupted:
            why = "this was interrupted"
        notes.append(f"{configurations[i].name} is not predicted: {why}.")
    notes += unscoped_notes(evaluate.problem.space, configurations)
    # A pose that only the start parameters cannot hold has no "before".
    held = np.asarray(before.equilibrium.converged)[:, None, None]
    effectors = np.where(held, np.asarray(before.effectors), np.nan)
    return _HeldOut(effectors, response, tuple(notes), interrupted)


def _solve_group(
    evaluate: Evaluator, chain: _Chain, group: Sequence[int], report: Report
) -> None:
    """Solve configurations from rest; rigid bodies go on from the one before."""
    bodies = evaluate.problem.model.mechanism.bodies.n_bodies > 0
    guess = chain.before[None] if bodies else None
    for i in group:
        own = lambda _, load, steps, i=i: report(i, load, steps)
        solution = evaluate.equilibria(chain.z, own, lanes=[i], guess=guess)
        if solution.converged[0]:
            guess = solution.displacement
            (chain.solved[i],) = evaluate.closed([i], chain.z, solution)


def _follow_paths(
    evaluate: Evaluator, chain: _Chain, carried: dict[int, float]
) -> None:
    """Follow what is not in equilibrium from rest along its load.

    `carried` gets the largest share of its load that each of these carries.
    """
    model, lanes = evaluate.posed(chain.z)
    for i, response in enumerate(chain.solved):
        if response.equilibrium.converged:
            continue
        path = solve_equilibrium(
            model, lane_of(lanes, i), settings=evaluate.problem.newton, path=LoadPath()
        )
        share = min(float(np.max(path.load)), 1.0)
        if share == 1.0:
            guess = jax.device_put(path.displacement[-1:])
            solution = evaluate.equilibria(chain.z, lanes=[i], guess=guess)
            (chain.solved[i],) = evaluate.closed([i], chain.z, solution)
        carried[i] = share


def unscoped_notes(
    space: ParameterSpace, held_out: Sequence[Configuration]
) -> list[str]:
    """Say which held-out configurations have no unknown of their own."""
    return [
        f"{c.name} is predicted without {entry.noun}, which {entry.by}s that were "
        "fitted have of their own: it counts as stated."
        for entry in space.entries
        if isinstance(entry, SetupParameter) and entry.each
        for c in held_out
        if entry.member(c) not in entry.each
    ]
