"""Evaluations of a calibration as jobs, whose lanes `Workers` run side by side."""

from copy import copy
from dataclasses import replace
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._typing import Array, Bool, Float
from softcal_jax.calibration._problem import (
    CalibrationProblem,
    Evaluation,
    Lane,
    at_rest,
    evaluate_lane,
    first_guess,
    stacked,
    without_names,
)
from softcal_jax.equilibrium import Batch, Job, program_key
from softcal_jax.fields import ParameterSpace

T = TypeVar("T")

_evaluate_lane = eqx.filter_jit(evaluate_lane)
_first_guess = eqx.filter_jit(first_guess)


class Evaluator:
    """Evaluates a calibration, its configurations as lanes of one program.

    The program does not depend on the number of configurations, on the data, or on how
    the parameters are stepped, so it is compiled once for all of these.

    Attributes:
        problem: The calibration.
        numbered: The same without names, for compiled programs.
    """

    def __init__(self, problem: CalibrationProblem):
        """Split the calibration into what all lanes share, and the lanes.

        Args:
            problem: The calibration.
        """
        self.problem, self.numbered = problem, without_names(problem)
        # The number of lanes and what concerns steps alone would each give another
        # program, so both are left out.
        space = replace(self.numbered.space, order=(), tensor_steps=True, pin=None)
        where = lambda p: (p.configurations, p.space)
        self._shared = eqx.tree_at(where, self.numbered, (None, space))
        n_c = problem.configurations.gravity.shape[0]
        self._configurations = [lane_of(problem.configurations, c) for c in range(n_c)]
        self._program = program_key(
            "evaluate_lane", self._shared, self._configurations[0]
        )
        self._on: dict[int, tuple[Any, CalibrationProblem]] = {}

    def with_space(self, space: ParameterSpace) -> "Evaluator":
        """Return an evaluator of the same lanes with another order, chart or pin.

        Args:
            space: The parameters, without names.
        """
        other = copy(self)
        other.numbered = eqx.tree_at(lambda p: p.space, self.numbered, space)
        return other

    def __call__(
        self,
        z: Float[Array, " n_p"],
        guess: Float[Array, "n_c n_points 3"],
        before: Float[Array, "n_c n_points 3"] | None = None,
        precise: bool | Bool[Array, ""] = False,
    ) -> Job[Evaluation]:
        """Compute equilibria, errors and compliances, like `evaluate`.

        Args:
            z: Scaled parameters [-].
            guess: Displacements to start from [m].
            before: Equilibria from which the guess was extrapolated, if it was [m].
            precise: Whether the compliances are exact, for one more Newton step each.
        """
        before = guess if before is None else before
        lanes = zip(self._configurations, guess, before, strict=True)
        precise = jnp.asarray(precise)
        jobs = [(z, *lane, precise) for lane in lanes]
        found = yield Batch(self._evaluate, jobs, self._program)
        return _stacked(self.numbered, z, found)

    def from_rest(self, z: Float[Array, " n_p"]) -> Job[Evaluation]:
        """Evaluate without a guess from another evaluation, see `first_guess`.

        Args:
            z: Scaled parameters [-].
        """
        guess = at_rest(self.problem)
        if self.problem.model.mechanism.bodies.n_bodies > 0:
            key = program_key("first_guess", self.numbered)
            (guess,) = yield Batch(self._guess, [z], key)
        return (yield from self(z, guess))

    def _evaluate(self, solver, lane) -> Lane:
        # The solver is kept beside, so that its id is not given to another one.
        if id(solver) not in self._on:
            self._on[id(solver)] = solver, with_solver(self._shared, solver)
        shared = self._on[id(solver)][1]
        return jax.block_until_ready(_evaluate_lane(shared, *lane))

    def _guess(self, solver, z) -> Float[Array, "n_c n_points 3"]:
        problem = with_solver(self.numbered, solver)
        return jax.block_until_ready(_first_guess(problem, z))


@eqx.filter_jit
def _stacked(problem, z, lanes: list[Lane]) -> Evaluation:
    return stacked(problem, z, jax.tree.map(lambda *leaves: jnp.stack(leaves), *lanes))


def with_solver(problem: CalibrationProblem, solver) -> CalibrationProblem:
    """Return the calibration with another sparse solver of its pattern."""
    return eqx.tree_at(lambda p: p.model.solver, problem, solver)


def lane_of(batch: T, index: int) -> T:
    """Return one lane of a batch of configurations."""
    # Sliced on the host: on the device, each shape compiles two more programs.
    return jax.device_put(jax.tree.map(lambda leaf: np.asarray(leaf)[index], batch))
