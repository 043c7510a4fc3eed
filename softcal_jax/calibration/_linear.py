"""The linear model of a calibration at an optimum: rows, priors, noise and doubts."""

from collections.abc import Sequence

import numpy as np

from softcal_jax._typing import Array, Bool, Float, HostArray
from softcal_jax.calibration._noise import noise_columns
from softcal_jax.calibration._problem import CalibrationProblem
from softcal_jax.configurations import Configuration
from softcal_jax.inference import ErrorColumns, LinearModel, Whitened, no_errors


def linear_model(
    problem: CalibrationProblem,
    configurations: Sequence[Configuration],
    *,
    z: Float[Array, " n_p"],
    W_ep: Float[Array | HostArray, "n_c n_e n_p"],
    ok: Sequence[bool] | Bool[Array, " n_c"],
    delta_e: Float[Array | HostArray, "n_c n_rows 3"],
    rows: Whitened | None = None,
    n_fitted: int | None = None,
    considered: ErrorColumns | None = None,
) -> LinearModel:
    """Make the linear model of measured coordinates, in stated standard deviations.

    Rows of a held-out configuration that has no equilibrium, or no regular tangent, are
    left out.

    Args:
        problem: The calibration, with the noise that weighed its data.
        configurations: Its configurations.
        z: Scaled parameters [-].
        W_ep: Compliances there, in the units of the effectors.
        ok: Which configurations have an equilibrium with a regular tangent.
        delta_e: Simulated minus measured values.
        rows: Rows of the fit, of which the last are the distances from the priors; none
            where nothing was fitted.
        n_fitted: Number of configurations that were fitted, which come first; all by
            default.
        considered: Errors that are considered, of all rows; none by default.
    """
    space, n_c, level = problem.space, len(configurations), float(problem.level)
    from_prior = np.zeros(len(space.names))
    if rows is not None:
        from_prior = np.asarray(rows.error)[-len(from_prior) :] / level
    n_fitted = n_c if n_fitted is None else n_fitted
    effectors = problem.configurations.effectors
    weight = np.asarray(effectors.inverse_std)
    considered = no_errors(weight.size) if considered is None else considered
    n_doubts = considered.values.shape[1]
    doubts = considered.values.reshape(n_c, weight[0].size, n_doubts)
    regular = np.asarray(ok) & np.isfinite(doubts).all(axis=(1, 2))
    used = regular | (np.arange(n_c) < n_fitted)
    measured = ((weight > 0.0) & used[:, None, None]).ravel()
    pose = np.repeat(np.arange(n_c), weight[0].size)
    whole = LinearModel(
        names=tuple(space.names),
        poses=tuple(c.name for c in configurations),
        pose=pose,
        fitted=pose < n_fitted,
        r=np.ravel(weight * np.asarray(delta_e)),
        W=weight.reshape(-1, 1) * np.concatenate(np.asarray(W_ep)),
        correlated=noise_columns(problem.noise, effectors, configurations),
        considered=considered,
        scale=level,
        from_prior=from_prior,
        prior_weights=np.asarray(space.prior_weights()),
        held=space.at_bound(z),
    )
    return whole.only(measured)
