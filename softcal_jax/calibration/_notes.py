"""Notes and warnings on a calibration, in words."""

import warnings
from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np

from softcal_jax._typing import Array, Float
from softcal_jax._warnings import SoftcalWarning
from softcal_jax.calibration._configuration_result import ConfigurationResult
from softcal_jax.calibration._problem import (
    CalibrationProblem,
    CalibrationSettings,
    n_measured,
)
from softcal_jax.calibration._step import CalibrationState
from softcal_jax.configurations import Configuration
from softcal_jax.equilibrium import Model
from softcal_jax.fields import ParameterSpace, SetupParameter
from softcal_jax.inference import Uncertainty

EQUAL = 1e-6
"""Difference of scaled parameters below which they count as equal [-]."""

ROUGH = 0.3
"""Relative standard error from which a linearised interval is only rough [-]."""

ROUGH_SHARE = 0.1
"""The same for a parameter on a linear scale, relative to its range [-]."""


class CalibrationWarning(SoftcalWarning):
    """Something about a calibration that its user should know."""


def result_notes(
    problem: CalibrationProblem,
    fits: Sequence[ConfigurationResult],
    z: Float[Array, " n_p"],
    spread: Uncertainty,
) -> list[str]:
    """Collect the notes on fits, parameters, their standard errors and the mesh."""
    notes = _misfit_notes(fits, spread) + _rounding_notes(fits)
    notes += order_notes(problem.space, z)
    notes += uncertainty_notes(problem, spread)
    if problem.model.mesh.order == 1:
        notes.append(
            "Linear tets lock in bending: the calibrated moduli are effective numbers "
            "of this mesh, not properties of the material. Use quadratic tets "
            "(to_quadratic) to compare with data sheets."
        )
    return notes


def fit_notes(state: CalibrationState, settings: CalibrationSettings) -> list[str]:
    """Say why a fit did not converge, if it did not."""
    size = float(jnp.max(jnp.abs(state.lambda_p)))
    if state.stalled:
        return [
            "Not converged: steps were refused until they were shorter than "
            f"{size:.0e}. Beyond here a configuration has no equilibrium, or the "
            "equilibria are too coarse (newton rtol) to see the fit improve. Do not "
            "use these values."
        ]
    if state.converged:
        return []
    return [
        f"Not converged: after {int(state.step)} steps lambda_p is still {size:.1e} "
        f"(tol {settings.tol:g}). Do not use these values; raise max_steps or look at "
        "the history."
    ]


def _misfit_notes(
    fits: Sequence[ConfigurationResult], spread: Uncertainty
) -> list[str]:
    """Name configurations that the calibrated model does not explain."""
    notes = []
    for fit in fits:
        misfit = fit.misfit(spread.noise, spread.level)
        if misfit == "worse than before":
            notes.append(
                f"{fit.name} fits worse than before the calibration "
                f"({1e3 * fit.rms_before:.2f} to {1e3 * fit.rms_after:.2f} mm): it "
                "contradicts the other configurations. Check its load, supports and "
                "marker names."
            )
        elif misfit == "unexplained":
            notes.append(
                f"{fit.name} is not explained by the model: after calibration the "
                f"markers are still {fit.off}. Check units, loads, gravity and marker "
                "names."
            )
    return notes


def _rounding_notes(fits: Sequence[ConfigurationResult]) -> list[str]:
    """Name configurations that are in balance up to rounding only."""
    return [
        f"{fit.name} is in balance only up to {fit.residual:.1e} of its forces, where "
        f"rounding, estimated at {fit.rounding:.1e}, stopped Newton before its rtol: a "
        "region is stiffer than the others by orders of magnitude, or the loads are "
        "tiny for the stiffness. Check units and moduli."
        for fit in fits
        # Without any load, rounding is all there is.
        if fit.at_rounding and fit.rounding < 1.0
    ]


def order_notes(space: ParameterSpace, z: Float[Array, " n_p"]) -> list[str]:
    """Name pairs of moduli that ended equal, held apart by their order alone."""
    A, b = space.order_rows()
    held = list(np.asarray(A @ z - b) >= -EQUAL)
    pairs = space.order_names()
    chart = space.chart
    if chart is not None:
        for small, large in zip(chart.small, chart.large, strict=True):
            pairs.append((space.names[small], space.names[large]))
            held.append(bool(z[large] - z[small] <= EQUAL))
    return [
        f"{small} ended equal to {large}, held by their order: the body is isotropic "
        "there, and the angle of its axis has no effect. Without `axes` this can be a "
        "trap with the axis a quarter turn wrong: calibrate from several starts."
        for (small, large), equal in zip(pairs, held, strict=True)
        if equal
    ]


def uncertainty_notes(problem: CalibrationProblem, spread: Uncertainty) -> list[str]:
    """Say which standard errors are missing or rough, and what they rest on."""
    space, dof = problem.space, spread.degrees_of_freedom
    names, std = np.array(space.names), np.sqrt(np.diag(spread.covariance))
    notes = [
        f"{name} ended on a bound: widen it, or the model cannot match the data. It "
        "has no standard error."
        for name in names[spread.at_bound]
    ]
    held, free = names[spread.at_bound], names[~spread.at_bound & np.isfinite(std)]
    if len(held) and len(free):
        notes.append(
            f"Standard errors of {', '.join(free)} hold with {', '.join(held)} kept on "
            "the bound, and are larger without it."
        )
    undetermined = np.isnan(std) & ~spread.at_bound
    if np.any(undetermined):
        blind = ", ".join(names[undetermined])
        why, remedy = "the data cannot tell them apart", "Add measurements."
        if dof <= 0:
            why = (
                "more measured coordinates than parameters are needed, and there are "
                f"{dof} to spare"
            )
            if spread.noise == "estimated":
                why = f"to estimate the noise from the residuals, {why}"
                remedy = (
                    "Add measurements, or state the `std` of the markers and take it "
                    'as it is with noise = "stated".'
                )
        notes.append(f"No standard error for {blind}: {why}. {remedy}")
    elif spread.noise == "estimated":
        notes.append(
            f"Standard errors rest on the noise estimated from the residuals ({dof} "
            "degrees of freedom), which holds model error as well."
        )
    elif spread.misfits:
        notes.append(
            f"The residuals are larger than the stated noise: chi-squared "
            f"{spread.chi_squared:.0f} for {dof} degrees of freedom. The model cannot "
            "match the data that well, or the noise is larger than stated; standard "
            "errors are too small."
        )
    # Too poorly determined for linearised standard errors.
    ranges = np.asarray(space.upper() - space.lower())
    log = np.array([q.scale == "log" for q in space.parameters])
    rough = std > np.where(log, ROUGH, ROUGH_SHARE * ranges)
    if np.any(rough):
        notes.append(
            f"The data determine {', '.join(names[rough])} so badly that value +- 1.96 "
            "standard errors is only rough; intervals by the likelihood itself hold."
        )
    return notes


def warn_if_locking(model: Model, space: ParameterSpace) -> None:
    """Warn if a Poisson's ratio may be calibrated into the range where tets lock."""
    if model.mesh.order == 1 or model.formulation == "mean-dilatation":
        return
    for parameter in space.parameters:
        if parameter.field.split(".")[-1] == "nu" and float(parameter.upper) >= 0.49:
            warnings.warn(
                f"parameter {parameter.name!r} may reach nu = "
                f"{float(parameter.upper):g}, "
                'where the formulation "displacement" locks: build the model with '
                'formulation="mean-dilatation", or lower the bound below 0.49.',
                CalibrationWarning,
                stacklevel=5,
            )


def warn_if_too_few_data(problem: CalibrationProblem) -> None:
    """Warn if there are fewer measured coordinates than parameters."""
    measured = n_measured(problem)
    # A prior counts as a measurement of its parameter.
    wanted = int(np.sum(np.asarray(problem.space.prior_weights()) == 0.0))
    if wanted > measured:
        without = " without a prior" if problem.space.has_prior else ""
        warnings.warn(
            f"{wanted} parameters{without} but only {measured} measured coordinates: "
            f"at least {wanted - measured} more are missing (another marker gives 3, "
            "another configuration as many as it has markers times 3). The fit is not "
            "unique.",
            CalibrationWarning,
            stacklevel=4,
        )


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
