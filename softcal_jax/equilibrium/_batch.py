"""Equilibria of a batch, on all cores, with their progress."""

import time
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from softcal_jax._lanes import stacked
from softcal_jax._typing import Array, Float
from softcal_jax.configurations import ConfigurationArrays
from softcal_jax.equilibrium._effectors import effector_values
from softcal_jax.equilibrium._model import Model
from softcal_jax.equilibrium._newton import NewtonSettings
from softcal_jax.equilibrium._solution import EquilibriumSolution
from softcal_jax.equilibrium._solve import (
    begin_newton,
    continue_newton,
    without_readings,
)
from softcal_jax.equilibrium._workers import Program, Workers

STEPS_BETWEEN = 2
"""Newton iterations of a configuration between two reports."""

FORESEEN_S = 5.0
"""Time after which the share of the load predicts how long the rest takes [s]."""

Report = Callable[[int, float, int], None]
"""Takes the index of a configuration, the share of its load, and its iterations."""


class EquilibriumProgress(NamedTuple):
    """Progress of an equilibrium from rest: Newton iterations and seconds so far.

    `load` is the share of the load that is carried, `stiffer` the factor on the moduli
    of the start [-].
    """

    configuration: str
    load: float
    steps: int
    stiffer: float
    seconds: float

    def __str__(self) -> str:
        """Write it in one line."""
        text = (
            f"equilibrium of {self.configuration}: {100.0 * self.load:.0f} % of the "
            f"load, step {self.steps}"
        )
        if self.stiffer > 1.0:
            text += f", moduli {self.stiffer:g} times the start"
        if self.seconds > FORESEEN_S and 0.0 < self.load < 1.0:
            left = self.seconds * (1.0 - self.load) / self.load
            text += f", about {left:.0f} s left"
        return text


def reports_of(
    progress: Callable[[EquilibriumProgress], None] | None,
    names: Sequence[str],
    factor: float = 1.0,
) -> Report | None:
    """Return a report for `equilibria`, which knows configurations by index alone."""
    if progress is None:
        return None
    begun: dict[int, float] = {}

    def report(c: int, load: float, steps: int) -> None:
        now = time.monotonic()
        seconds = now - begun.setdefault(c, now)
        progress(EquilibriumProgress(names[c], load, steps, factor, seconds))

    return report


def equilibria(
    workers: Workers,
    model: Model,
    configurations: Iterable[ConfigurationArrays],
    newton: NewtonSettings,
    *,
    guess: Float[Array, "n_c n_points 3"] | None = None,
    start: Float[Array, "n_points 3"] | None = None,
    report: Report | None = None,
    ended: Callable[[int, EquilibriumSolution], None] = lambda *_: None,
) -> EquilibriumSolution:
    """Solve the equilibria of all configurations on all cores.

    The program is compiled once for any number of lanes. Inside a program a `vmap` of
    `solve_equilibrium` solves a batch; `Evaluator` adds the errors and compliances of a
    calibration.

    By default each solve begins at rest; with rigid bodies, at the solution of the
    configuration before (the first at `start`), because poses of a robot lie near each
    other and far from its state before mounting. A guess that is not finite counts as
    rest. `report` is called after every few iterations of a configuration, from its
    thread; `ended` in the order of the configurations, with index and solution.
    """
    lanes = list(map(without_readings, configurations))
    settings, most = newton.as_arrays(), int(newton.max_steps)
    steps = jnp.asarray(most if report is None else STEPS_BETWEEN)
    first = Program(begin_newton, model, settings)
    program = Program(continue_newton, model, settings, steps)

    def solve(c: int, u: Float[Array, "n_points 3"] | None) -> EquilibriumSolution:
        (state,) = workers.map(first, [(lanes[c], u)])
        while True:
            ((state, solution),) = workers.map(program, [(lanes[c], state)])
            if report is not None:
                report(c, float(state.load_ok), int(state.step))
            if bool(state.done) or int(state.step) >= most:
                return solution

    if guess is None and model.mechanism.bodies.n_bodies > 0:
        solutions: list[EquilibriumSolution] = []
        for c in range(len(lanes)):
            solutions.append(solve(c, start))
            ended(c, solutions[c])
            if solutions[c].converged:
                start = solutions[c].displacement
    else:
        rest = [None] * len(lanes)
        each = enumerate(rest if guess is None else guess)
        solutions = workers.side_by_side((partial(solve, c, u) for c, u in each), ended)
    return stacked(solutions)


compiled_effectors = eqx.filter_jit(effector_values)  # one program for all callers


def effectors_on_all_cores(
    workers: Workers,
    model: Model,
    configurations: Iterable[ConfigurationArrays],
    solution: EquilibriumSolution,
) -> Float[Array, "n_c n_rows 3"]:
    """Compute the effector coordinates of a batch, on all cores."""
    states = solution.displacement, solution.multipliers
    lanes = zip(configurations, *map(np.asarray, states), strict=True)
    return stacked(workers.map(Program(compiled_effectors, model), lanes))
