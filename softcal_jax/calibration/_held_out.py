"""Equilibria of configurations that were held out of a fit."""

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import jax
import numpy as np

from softcal_jax._typing import Array, Float, HostArray
from softcal_jax.calibration._evaluation import Evaluator
from softcal_jax.calibration._notes import unscoped_notes
from softcal_jax.calibration._problem import lane_of
from softcal_jax.configurations import Configuration
from softcal_jax.equilibrium import EquilibriumSolution, LoadPath, solve_equilibrium
from softcal_jax.sensitivity import Response


class HeldOut(NamedTuple):
    """Held-out configurations, with the start and the calibrated parameters.

    Attributes:
        before: Effectors with the start parameters; nan without an equilibrium.
        response: Equilibria, effectors and compliances with the calibrated ones.
        notes: Which have no equilibrium, and why.
    """

    before: Float[HostArray, "n_c n_rows 3"]
    response: Response
    notes: tuple[str, ...]


def held_out_responses(
    evaluate: Evaluator,
    configurations: Sequence[Configuration],
    *,
    start: Float[Array, " n_p"],
    z: Float[Array, " n_p"],
) -> HeldOut:
    """Solve held-out configurations with the start and the calibrated parameters.

    Uses the program of the fit, which is compiled already. Near a limit point an
    equilibrium need not be found from rest: there the path of the configuration is
    followed by arc length, and its end is where the search begins anew. A configuration
    without equilibrium is left out with a note: it must neither count as a prediction
    nor cost the user the fit.

    Args:
        evaluate: Evaluator of these configurations.
        configurations: The configurations.
        start: Scaled start parameters [-].
        z: Scaled calibrated parameters [-].
    """
    first, last = evaluate.workers.side_by_side(
        partial(evaluate.response_from_rest, p) for p in (start, z)
    )
    guess, carried = _along_paths(evaluate, z, last.equilibrium)
    if any(share == 1.0 for share in carried.values()):
        last = evaluate.response(z, guess)
    converged = np.asarray(last.equilibrium.converged)
    notes = [
        f"{configurations[i].name} is not predicted: with the calibrated parameters it "
        "has no equilibrium. Along its path (`LoadPath`) it carries at most "
        f"{100.0 * share:.3g} % of its load."
        for i, share in carried.items()
        if not converged[i]
    ]
    notes += unscoped_notes(evaluate.problem.space, configurations)
    # A pose that only the start parameters cannot hold has no "before".
    held = np.asarray(first.equilibrium.converged)[:, None, None]
    before = np.where(held, np.asarray(first.effectors), np.nan)
    return HeldOut(before, last, tuple(notes))


def _along_paths(
    evaluate: Evaluator, z: Float[Array, " n_p"], solution: EquilibriumSolution
) -> tuple[Float[Array, "n_c n_points 3"], dict[int, float]]:
    """Follow what is not in equilibrium from rest along its load.

    Returns:
        Displacements to start from: as solved, or at the end of the path; and the
        largest share of its load that each of these configurations carries.
    """
    guess, carried = np.array(solution.displacement), {}
    lost = np.flatnonzero(~np.asarray(solution.converged))
    if len(lost):
        model, arrays = evaluate.problem.at(z)
        newton = evaluate.problem.newton
        for i in map(int, lost):
            path = solve_equilibrium(
                model, lane_of(arrays, i), settings=newton, path=LoadPath()
            )
            carried[i] = min(float(np.max(path.load)), 1.0)
            guess[i] = path.displacement[-1]
    return jax.device_put(guess), carried
