"""Predict configurations that were held out of a fit."""

from collections.abc import Sequence
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._typing import Array, Float
from softcal_jax.calibration._agreement import Posed
from softcal_jax.calibration._configuration_result import (
    ConfigurationResult,
    configuration_results,
)
from softcal_jax.calibration._evaluation import Evaluator
from softcal_jax.calibration._lanes import lane_of
from softcal_jax.calibration._notes import unscoped_notes
from softcal_jax.calibration._problem import CalibrationProblem
from softcal_jax.configurations import (
    Configuration,
    ConfigurationArrays,
    ConfigurationLanes,
)
from softcal_jax.equilibrium import (
    EquilibriumSolution,
    LoadPath,
    Model,
    NewtonSettings,
    Workers,
    solve_equilibrium,
)


def predict(
    workers: Workers,
    validation: Sequence[Configuration],
    problem: CalibrationProblem,
    lanes: ConfigurationLanes,
    *,
    start: Float[Array, " n_p"],
    z: Float[Array, " n_p"],
) -> tuple[tuple[ConfigurationResult, ...], list[str], Posed]:
    """Predict held-out configurations with the start and the calibrated parameters.

    Uses the program of the fit, which is compiled already. Near a limit point an
    equilibrium need not be found from rest: there the path of the configuration is
    followed by arc length, and its end is where the search begins anew. A configuration
    without equilibrium is left out with a note: it must neither count as a prediction
    nor cost the user the fit.
    """
    evaluate = Evaluator(problem, workers)
    first, last = workers.side_by_side(
        partial(evaluate.from_rest, p) for p in (start, z)
    )
    # A pose that only the start parameters cannot hold has no "before".
    held = first.equilibrium.converged[:, None, None]
    model, arrays = problem.at(z)
    guess, carried = _along_paths(model, arrays, last.equilibrium, problem.newton)
    if any(share == 1.0 for share in carried.values()):
        last = evaluate(z, guess)
    fits = configuration_results(
        model,
        validation,
        lanes._replace(arrays=arrays),
        role="validation",
        before=jnp.where(held, first.effectors, jnp.nan),
        after=last.effectors,
        W_ep=last.compliance,
        solution=last.equilibrium,
        noise=problem.noise,
    )
    notes = [
        f"{validation[i].name} is not predicted: with the calibrated parameters it has "
        f"no equilibrium. Along its path (`LoadPath`) it carries at most "
        f"{100.0 * share:.3g} % of its load."
        for i, share in carried.items()
        if not last.equilibrium.converged[i]
    ]
    notes += unscoped_notes(problem.space, validation)
    return fits, notes, Posed(tuple(validation), problem, last)


def _along_paths(
    model: Model,
    arrays: ConfigurationArrays,
    found: EquilibriumSolution,
    newton: NewtonSettings,
) -> tuple[Float[Array, "n_c n_points 3"], dict[int, float]]:
    """Follow what is not in equilibrium from rest along its load.

    Returns:
        Displacements to start from: as found, or at the end of the path; and the
        largest share of its load that each of these configurations carries.
    """
    guess, carried = np.array(found.displacement), {}
    for i in np.flatnonzero(~np.asarray(found.converged)):
        path = solve_equilibrium(
            model, lane_of(arrays, int(i)), settings=newton, path=LoadPath()
        )
        carried[int(i)] = min(float(np.max(path.load)), 1.0)
        guess[i] = path.displacement[-1]
    return jax.device_put(guess), carried
