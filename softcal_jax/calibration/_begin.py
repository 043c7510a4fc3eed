"""The first equilibria of a fit, with moduli raised where there are none at the start.

A body that is too soft balloons, buckles or collapses under the measured loads, and a
fit needs an equilibrium of every configuration to begin with.
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from softcal_jax._module import one_line
from softcal_jax._names import listed
from softcal_jax._typing import Array, Bool, Float, HostArray
from softcal_jax._units import readable
from softcal_jax.calibration._evaluation import Evaluation, Evaluator
from softcal_jax.calibration._lanes import Report
from softcal_jax.calibration._runs import admissible
from softcal_jax.equilibrium import (
    EquilibriumSolution,
    no_equilibrium,
)
from softcal_jax.fields import ParameterSpace, unnamed

STIFFER = 2.0
"""Factor by which moduli are raised until all configurations have an equilibrium."""

MOST_RAISES = 20
"""Most raises, a factor of a million in all."""


class EquilibriumProgress(NamedTuple):
    """Progress of the first equilibrium of a configuration.

    Attributes:
        configuration: Its name.
        load: Share of the load that is carried so far [-].
        steps: Newton iterations so far.
        stiffer: Factor on the moduli of the start [-].
    """

    configuration: str
    load: float
    steps: int
    stiffer: float

    __repr__ = one_line

    def __str__(self) -> str:
        """Write it in one line."""
        raised = f", moduli {self.stiffer:g} times the start" * (self.stiffer > 1.0)
        return (
            f"equilibrium of {self.configuration}: {100.0 * self.load:.0f} % of the "
            f"load, step {self.steps}{raised}"
        )


Progress = Callable[[EquilibriumProgress], None]


class Beginning(NamedTuple):
    """Where a fit begins.

    Attributes:
        z: Scaled parameters [-].
        evaluation: Evaluation at these parameters.
        notes: What was changed to find equilibria.
    """

    z: Float[Array, " n_p"]
    evaluation: Evaluation
    notes: tuple[str, ...]


def begin(
    evaluate: Evaluator,
    z: Float[Array, " n_p"],
    names: Sequence[str],
    progress: Progress | None = None,
) -> Beginning:
    """Evaluate a start, with moduli raised until every configuration is in equilibrium.

    Args:
        evaluate: Evaluator of the calibration.
        z: Scaled start [-].
        names: Names of the configurations.
        progress: Called while the equilibria are solved.

    Raises:
        RuntimeError: If a configuration has no equilibrium within the bounds; the text
            names it, the load that it reached, and why.
    """
    space, names = evaluate.problem.space, tuple(names)
    report = partial(reports_of, progress, names)
    first, evaluation = _first_equilibria(evaluate, z, report())
    if evaluation is not None:
        return Beginning(z, evaluation, ())
    solution, raised, factor = first, z, 1.0
    for _ in range(MOST_RAISES):
        stiffer = _stiffer(space, raised)
        if np.array_equal(stiffer, raised):
            break
        raised, factor = stiffer, STIFFER * factor
        solution, evaluation = _first_equilibria(evaluate, raised, report(factor))
        if evaluation is not None:
            return Beginning(raised, evaluation, (_note(space, first, names, raised),))
    raise RuntimeError(_nowhere(space, (first, solution), names, (z, raised)))


def _nowhere(
    space: ParameterSpace,
    solutions: tuple[EquilibriumSolution, EquilibriumSolution],
    names: tuple[str, ...],
    z: tuple[Float[Array, " n_p"], Float[Array, " n_p"]],
) -> str:
    """Say why there is no equilibrium at the start, nor with the stiffest moduli."""
    first, last = solutions
    text = no_equilibrium(first, names)
    if np.array_equal(*z):
        return text
    return (
        f"{text}\nNor is there one with stiffer moduli up to their bounds "
        f"({_values(space, z[1])}).\n{_reached(last, names)}\nRaise the upper bounds, "
        "or check loads, units and supports."
    )


def _first_equilibria(
    evaluate: Evaluator, z: Float[Array, " n_p"], report: Report | None
) -> tuple[EquilibriumSolution, Evaluation | None]:
    """Return the equilibria, and their evaluation if all configurations have one."""
    if report is None:
        evaluation = evaluate.from_rest(z)
        solution = evaluation.equilibrium
        return solution, evaluation if bool(jnp.all(solution.converged)) else None
    solution = evaluate.equilibria(z, report)
    if not bool(jnp.all(solution.converged)):
        return solution, None
    return solution, evaluate(z, solution.displacement)


def reports_of(
    progress: Progress | None, names: Sequence[str], factor: float = 1.0
) -> Report | None:
    """Return a report for `equilibria`, which knows configurations by index alone."""
    if progress is None:
        return None
    return lambda c, load, steps: progress(
        EquilibriumProgress(names[c], load, steps, factor)
    )


def _moduli(space: ParameterSpace) -> Bool[HostArray, " n_p"]:
    """Flag the moduli: fields of the law on a log scale, without the density."""
    of_law = np.asarray(space.sets_fields)
    fields = [q.field.rpartition(".")[2] for q in space.parameters]
    scales = [q.scale == "log" for q in space.parameters]
    return of_law & np.array(scales) & (np.array(fields) != "density")


def _stiffer(space: ParameterSpace, z: Float[Array, " n_p"]) -> Float[Array, " n_p"]:
    """Raise all moduli by a factor, within bounds and order."""
    more = np.where(_moduli(space), np.log(STIFFER), 0.0)
    return admissible(unnamed(space), jnp.asarray(np.asarray(z) + more))


def _values(space: ParameterSpace, z: Float[Array, " n_p"]) -> str:
    """Write the moduli, with their units."""
    p = np.asarray(space.from_scaled(z))
    chosen = np.flatnonzero(_moduli(space))
    texts = [
        f"{space.names[i]} = {readable(float(p[i]), space.parameters[i].unit)}"
        for i in chosen
    ]
    return listed(texts)


def _note(
    space: ParameterSpace,
    first: EquilibriumSolution,
    names: tuple[str, ...],
    raised: Float[Array, " n_p"],
) -> str:
    return (
        f"No equilibrium at the start values. {_reached(first, names)} The fit began "
        f"with stiffer moduli: {_values(space, raised)}."
    )


def _reached(solution: EquilibriumSolution, names: tuple[str, ...]) -> str:
    """Say how far configurations without an equilibrium came."""
    load = np.asarray(solution.load_reached)
    lost = np.flatnonzero(~np.asarray(solution.converged))
    return " ".join(
        f"{names[c]} carries {100.0 * load[c]:.3g} % of its load." for c in lost
    )
