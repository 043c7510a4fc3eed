"""Judge which parameters the data can determine, before or after a calibration."""

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np

from softcal_jax._typing import Float, HostArray
from softcal_jax.configurations import Configuration
from softcal_jax.equilibrium import Model, NewtonSettings
from softcal_jax.fields import ParameterSpace, Uncertain
from softcal_jax.identifiability._conditioning import conditioning
from softcal_jax.identifiability._directions import named_directions
from softcal_jax.identifiability._result import Identifiability, ParameterOutlook
from softcal_jax.identifiability._spread import (
    data_only_std,
    marginalised,
    posterior,
    prior_std,
    si_slope,
    verdict,
)
from softcal_jax.identifiability._survey import (
    AnyVector,
    Parameters,
    as_sequence,
    survey,
)


def identifiability(
    W: Float[HostArray, "n_e n_p"],
    space: ParameterSpace,
    z: Float[AnyVector, " n_p"],
    *,
    noise_scale: float = 1.0,
    n_data: int | None = None,
    W_ep: Float[HostArray, "n_e n_p"] | None = None,
    W_pp: Float[HostArray, "n_p n_p"] | None = None,
    W_c: Float[HostArray, "n_e n_errors"] | None = None,
) -> Identifiability:
    """Judge what data with these compliances tell about the parameters; Sec. V-C.

    The predicted covariance is (I / prior^2 + W^T W)^-1. The prior's standard deviation
    is that of a uniform density between the bounds, or the parameter's `prior_std`, so
    a parameter that no data see has a finite spread. The verdict compares predicted and
    prior spread (`IDENTIFIABLE_BELOW`, `WEAK_BELOW`).

    The verdict is local: at E_l = E_t, for example, the fibre angle has no effect.

    Args:
        W: Stacked compliances in units of the noise, per unit of lambda_p, such as
            `CalibrationResult.W_ep` [-].
        space: The parameters.
        z: Their scaled values, such as `CalibrationResult.z` [-].
        noise_scale: Factor on the noise, such as `Uncertainty.noise_scale` [-].
        n_data: Number of measured coordinates; by default of the rows of `W` that are
            not zero.
        W_ep: `W` in metres, for condition numbers [m].
        W_pp: Sum over the configurations of H_p K^-1 H_p^T [J].
        W_c: Change of the data per standard deviation of what is held fixed and may be
            wrong, in units of the noise, such as `ErrorBudget.W_c`; none by default.

    Returns:
        The verdict and the numbers behind it.

    Raises:
        ValueError: If `W` is not finite or has not one column per parameter, or the
            noise scale is not positive.
    """
    W = np.asarray(W, float)
    n_p = len(space.names)
    if W.ndim != 2 or W.shape[1] != n_p:
        raise ValueError(
            f"W must have one column for each of the {n_p} parameters, got the shape "
            f"{W.shape}."
        )
    if not 0.0 < noise_scale < np.inf:
        raise ValueError(f"noise_scale must be positive, got {noise_scale:g}.")
    numbers = conditioning(W / noise_scale, W_ep=W_ep, W_pp=W_pp)
    prior = prior_std(space)
    G = W / noise_scale * prior
    if W_c is not None:
        G = marginalised(G, W_c / noise_scale)
    covariance = posterior(G)
    directions = named_directions(G, space.names)
    outlooks = _outlooks(space, z, np.sqrt(np.diag(covariance)), data_only_std(G))
    return Identifiability(
        verdict=verdict(max(d.spread for d in directions)),
        parameters=outlooks,
        directions=directions,
        covariance=covariance * np.outer(prior, prior),
        conditioning=numbers,
        n_data=int(np.any(W != 0.0, axis=1).sum()) if n_data is None else n_data,
        known="prior" if space.has_prior else "bounds",
    )


def _outlooks(
    space: ParameterSpace,
    z: Float[AnyVector, " n_p"],
    spread: Float[HostArray, " n_p"],
    alone: Float[HostArray, " n_p"],
) -> tuple[ParameterOutlook, ...]:
    """Convert spreads in units of the prior to SI."""
    prior = si_slope(space, z) * prior_std(space)
    values = np.asarray(space.from_scaled(jnp.asarray(z)))
    outlooks = []
    for i, parameter in enumerate(space.parameters):
        error = float(prior[i] * spread[i])
        plain = parameter.unit == "rad" or values[i] == 0.0
        outlooks.append(
            ParameterOutlook(
                name=parameter.name,
                value=float(values[i]),
                standard_error=error,
                data_only=float(prior[i] * alone[i]),
                prior=float(prior[i]),
                relative=None if plain else error / abs(float(values[i])),
                spread=float(spread[i]),
                verdict=verdict(float(spread[i])),
                unit=parameter.unit,
            )
        )
    return tuple(outlooks)


def identify(
    model: Model,
    parameters: Parameters,
    configurations: Configuration | Sequence[Configuration],
    *,
    at: Float[AnyVector, " n_p"] | None = None,
    noise: float | None = None,
    newton: NewtonSettings | None = None,
    uncertain: Uncertain | None = None,
) -> Identifiability:
    """Predict what markers in these configurations would tell, before measuring.

    Args:
        model: The model.
        parameters: Parameters that would be calibrated, with start and bounds.
        configurations: Configurations with markers, of which `std` and `axes` are used;
            `measured` is ignored and may be missing.
        at: Scaled values z to linearise at; the start by default. The `to_scaled` of a
            `ParameterSpace` converts SI values [-].
        noise: Standard deviation of every measured coordinate; by default that of the
            markers [m].
        newton: Settings of the equilibrium.
        uncertain: How well everything is known that is not calibrated; the defaults of
            `Uncertain` by default.

    Returns:
        The verdict, see `identifiability`.

    Raises:
        ValueError: If an input is wrong.
        RuntimeError: If a configuration has no equilibrium; the text names it.
    """
    found = survey(
        model,
        parameters,
        as_sequence(configurations),
        at=at,
        noise=noise,
        newton=newton,
        uncertain=uncertain,
    )
    n_p = len(found.space.names)
    none = np.zeros((0, n_p))
    W_ep = np.concatenate([none, *(s.W_ep for s in found.sensed)])
    W = np.concatenate([none, *(s.W for s in found.sensed)])
    W_c = np.concatenate([s.W_c for s in found.sensed]) if found.sensed else None
    W_pp = sum((s.W_pp for s in found.sensed), np.zeros((n_p, n_p)))
    return identifiability(
        W, found.space, found.z, n_data=len(W), W_ep=W_ep, W_pp=W_pp, W_c=W_c
    )
