"""Predict configurations that were held out of a fit."""

from collections.abc import Sequence

import jax.numpy as jnp

from softcal_jax._typing import Array, Float
from softcal_jax.calibration._agreement import Posed
from softcal_jax.calibration._configuration_result import (
    ConfigurationResult,
    configuration_results,
)
from softcal_jax.calibration._notes import unscoped_notes
from softcal_jax.calibration._problem import CalibrationProblem, Evaluator
from softcal_jax.configurations import Configuration, ConfigurationLanes
from softcal_jax.equilibrium import Workers


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

    Uses the program of the fit, which is compiled already.
    A configuration without equilibrium is left out with a note: it must neither count
    as a prediction nor cost the user the fit.
    """
    evaluate = Evaluator(problem)
    first, last = workers.ends(evaluate.from_rest(p) for p in (start, z))
    # A pose that only the start parameters cannot hold has no "before".
    held = first.equilibrium.converged[:, None, None]
    model, arrays = problem.at(z)
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
        f"{c.name} is not predicted: with the calibrated parameters it has no "
        "equilibrium. `softcal simulate` or `solve_equilibrium` tells why."
        for c, ok in zip(validation, last.equilibrium.converged, strict=True)
        if not ok
    ]
    notes += unscoped_notes(problem.space, validation)
    return fits, notes, Posed(tuple(validation), evaluate, last)
