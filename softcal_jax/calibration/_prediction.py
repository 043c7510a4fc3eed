"""All configurations with the calibrated parameters; those held out are solved."""

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import numpy as np

from softcal_jax._lanes import lane_of, stacked
from softcal_jax._results import RESULTS
from softcal_jax._typing import Array, Float
from softcal_jax.calibration._configuration_result import (
    ConfigurationResult,
    configuration_results,
    displaced,
)
from softcal_jax.calibration._evaluation import Evaluator
from softcal_jax.calibration._starts import Start
from softcal_jax.calibration._weighing import Weighed
from softcal_jax.equilibrium import (
    EquilibriumSolution,
    Model,
    Report,
    other_ways,
    outcome_words,
)
from softcal_jax.fields import SetupParameter
from softcal_jax.sensitivity import Response
from softcal_jax.unknowns import Problem


class Predicted(NamedTuple):
    """Model and configurations with the calibrated parameters, and their noise."""

    model: Model
    problem: Problem
    response: Response
    fits: tuple[ConfigurationResult, ...]
    notes: tuple[str, ...]
    interrupted: bool


def predict(
    problem: Problem, start: Start, weighed: Weighed, report: Report | None
) -> Predicted:
    """Describe all configurations at the optimum; solve those that were held out.

    `report` is called as `equilibria` calls it, for the parameters at the end.
    """
    z, evaluate = weighed.state.z, Evaluator(problem, start.evaluate.workers)
    first = _AllLanes(evaluate, start.z, start.evaluation.response, {}, {})
    last = _AllLanes(evaluate, z, weighed.state.evaluation.response, {}, {})
    notes, interrupted = _solve_held_out(problem, first, last, report)
    # A pose without an equilibrium at the start parameters has no "before".
    begun, response = first.response(), last.response()
    held = np.asarray(begun.equilibrium.converged)[:, None, None]
    assert problem.noise is not None
    noise = weighed.of_all(problem.noise, problem.poses)
    model, arrays = problem.at(z)
    lanes = problem.lanes._replace(arrays=arrays)
    fits = configuration_results(
        model,
        problem.poses,
        displaced(problem.poses, lanes, weighed.state.evaluation.delta_e),
        n_fitted=problem.n_fitted,
        before=np.where(held, np.asarray(begun.effectors), np.nan),
        response=response,
        noise=noise,
    )
    problem = problem.with_noise(noise)
    return Predicted(model, problem, response, fits, tuple(notes), interrupted)


MOST_BEFORE = 30
"""Iterations spent on what a held-out configuration was before the fit.

Where the start values are too soft for it, more would keep the user from the answer.
"""


class _AllLanes(NamedTuple):
    """All configurations at some z: those fitted, and equilibria of those held out.

    `solved` holds these equilibria by lane, `closed` those that have compliances.
    """

    evaluate: Evaluator
    z: Float[Array, " n_p"]
    fitted: Response
    solved: dict[int, EquilibriumSolution]
    closed: dict[int, Response]

    def solve(self, lanes: Sequence[int], report: Report | None, **options) -> None:
        """Solve lanes from rest, or from those near to them that were fitted."""
        self.evaluate.equilibria(
            self.z,
            report or (lambda *_: None),  # a few iterations at a time, for Ctrl-C
            lanes=lanes,
            known=self.fitted.equilibrium,
            **options,
            ended=lambda k, solution: self.solved.update({lanes[k]: solution}),
        )

    def close(self) -> None:
        """Add the compliances of lanes that are solved and lack them."""
        new = [c for c in self.solved if c not in self.closed]
        new = [c for c in new if self.solved[c].converged]
        if new:
            solutions = stacked([self.solved[c] for c in new])
            before, n = self.evaluate.with_earlier(new), len(self.fitted.ok)
            known = {c: lane_of(self.fitted, c) for c in before if c < n}
            known |= self.closed
            responses = self.evaluate.closed(new, self.z, solutions, known=known)
            self.closed.update(zip(new, responses, strict=True))

    def response(self) -> Response:
        """Return all lanes; those without an equilibrium are at rest."""
        self.close()
        held_out = range(len(self.fitted.ok), len(self.evaluate.lanes))
        if not held_out:
            return self.fitted
        rest = jax.tree.map(np.zeros_like, lane_of(self.fitted, -1))
        ended = lambda r: (r.equilibrium.result, r.equilibrium.contacts)
        none = np.full_like(rest.equilibrium.contacts, np.nan)
        rest = eqx.tree_at(ended, rest, (RESULTS.max_steps, none))
        others = stacked([self.closed.get(c, rest) for c in held_out])
        join = lambda *parts: np.concatenate([*map(np.asarray, parts)])
        return jax.device_put(jax.tree.map(join, self.fitted, others))


def _solve_held_out(
    problem: Problem, first: _AllLanes, last: _AllLanes, report: Report | None
) -> tuple[list[str], bool]:
    """Solve held-out configurations with the parameters at the end and at the start.

    A configuration without equilibrium is left out with a note, as it must
    neither count as a prediction nor cost the user the fit; so are those that Ctrl-C
    cuts off. Returns the notes, and whether Ctrl-C ended it.
    """
    interrupted = False
    lanes = range(problem.n_fitted, len(problem.poses))
    held_out = problem.poses[problem.n_fitted :]
    if not lanes:
        return [], False
    try:
        solve_last = partial(last.solve, lanes, report, arc_length=True)
        solve = solve_last, partial(first.solve, lanes, None, most=MOST_BEFORE)
        last.evaluate.workers.side_by_side(solve)
        last.close()
        first.close()
    except KeyboardInterrupt:
        interrupted = True
    notes = []
    for lane, pose in zip(lanes, held_out, strict=True):
        if lane not in last.solved:
            notes.append(f"{pose.name} is not predicted: this was interrupted.")
        elif not last.solved[lane].converged:
            solved = last.solved[lane]
            notes.append(
                f"{pose.name} is not predicted: with the calibrated parameters no "
                f"equilibrium was found: {outcome_words(solved)}.{other_ways(solved)}"
            )
    # Those that lack an unknown which fitted ones have.
    notes += [
        f"{c.name} is predicted without {entry.noun}, which {entry.by}s that were "
        "fitted have of their own: it counts as stated."
        for entry in problem.space.entries
        if isinstance(entry, SetupParameter) and entry.each
        for c in held_out
        if entry.member(c) not in entry.each
    ]
    return notes, interrupted
