"""Evaluations and runs of a calibration, side by side on the cores of this machine."""

from typing import TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._typing import Array, Bool, Float
from softcal_jax.calibration._problem import (
    CalibrationProblem,
    Evaluation,
    Lane,
    evaluate_lane,
    stacked,
    without_names,
)
from softcal_jax.equilibrium import Workers, program_key

T = TypeVar("T")

_evaluate_lane = eqx.filter_jit(evaluate_lane)


class Evaluator:
    """Evaluates a calibration, its configurations side by side.

    One program serves every configuration, and any number of them.

    Attributes:
        problem: The calibration.
        numbered: The same without names, for compiled programs.
    """

    def __init__(self, problem: CalibrationProblem, workers: Workers):
        """Evaluations of one calibration.

        Args:
            problem: The calibration.
            workers: Threads, entered as a context.
        """
        self.problem, self._workers = problem, workers
        self.numbered = without_names(problem)
        # Without the batch, whose size would make it another program.
        self._shared = eqx.tree_at(lambda p: p.configurations, self.numbered, None)
        n_c = problem.configurations.gravity.shape[0]
        self._configurations = [_lane(problem.configurations, c) for c in range(n_c)]
        self._program = program_key(
            "evaluate_lane", self._shared, self._configurations[0]
        )
        self._on: dict[int, CalibrationProblem] = {}

    def __call__(
        self,
        z: Float[Array, " n_p"],
        guess: Float[Array, "n_c n_points 3"],
        before: Float[Array, "n_c n_points 3"] | None = None,
        precise: bool | Bool[Array, ""] = False,
    ) -> Evaluation:
        """Equilibria, errors and compliances, as `evaluate` gives them.

        Args:
            z: Scaled parameters [-].
            guess: Displacements to start from [m].
            before: Equilibria from which the guess was extrapolated, if it was [m].
            precise: Whether the compliances are exact, for one more Newton step each.
        """
        before = guess if before is None else before
        lanes = zip(self._configurations, guess, before, strict=True)
        jobs = [(z, *lane, jnp.asarray(precise)) for lane in lanes]
        lanes = self._workers.map(self._one, jobs, self._program)
        return _stacked(self.numbered, z, lanes)

    def _one(self, solver, job) -> Lane:
        shared = self._on.get(id(solver))  # which the problem keeps alive
        if shared is None:
            shared = self._on[id(solver)] = with_solver(self._shared, solver)
        return jax.block_until_ready(_evaluate_lane(shared, *job))


@eqx.filter_jit
def _stacked(problem, z, lanes: list[Lane]) -> Evaluation:
    return stacked(problem, z, jax.tree.map(lambda *leaves: jnp.stack(leaves), *lanes))


def with_solver(problem: CalibrationProblem, solver) -> CalibrationProblem:
    """The calibration with another sparse solver of its pattern."""
    return eqx.tree_at(lambda p: p.model.solver, problem, solver)


def _lane(batch: T, index: int) -> T:
    # On the host: each shape would be two more programs to compile.
    return jax.device_put(jax.tree.map(lambda leaf: np.asarray(leaf)[index], batch))
