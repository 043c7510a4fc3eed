"""Judge which parameters the data can determine, before or after a calibration."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._module import Module
from softcal_jax._process import check_process
from softcal_jax._typing import Array, Float, HostArray
from softcal_jax.calibration import (
    CalibrationProblem,
    EquilibriumProgress,
    Evaluator,
    as_sequence,
    check_references,
    considered_errors,
    correlated_noise,
    reports_of,
    unknown_causes,
    whitened,
)
from softcal_jax.configurations import (
    Configuration,
    configuration_lanes,
    measured_at_rest,
)
from softcal_jax.equilibrium import (
    RESULTS,
    Model,
    NewtonSettings,
    Workers,
    check_converged,
)
from softcal_jax.fields import (
    PRECISION,
    Entry,
    ParameterSpace,
    Uncertain,
    as_space,
    asked_errors,
    check_parameters,
    check_precision,
)
from softcal_jax.identifiability._conditioning import conditioning
from softcal_jax.identifiability._result import Identifiability, ParameterOutlook
from softcal_jax.identifiability._spread import (
    Spread,
    count_informed,
    information,
    named_directions,
    spread_of,
    verdict,
)

Parameters = ParameterSpace | Entry | Sequence[Entry]
AnyVector = Array | HostArray


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
    precision: float = PRECISION,
    unknown: tuple[str, ...] = (),
) -> Identifiability:
    """Judge what data with these compliances tell about the parameters; Sec. V-C.

    The verdict compares the predicted standard error of each parameter with the one
    that is asked for (`IDENTIFIABLE_UP_TO`, `WEAK_UP_TO`), which is relative to the
    value, or absolute for angles and errors of the setup: the table is in
    `softcal_jax.fields._precision`. A stated prior (`prior_std`) counts like a
    measurement. Bounds do not count: a parameter that no data see has no finite error,
    however narrow they are.

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
        precision: Standard error that is asked for, relative to the value [-].
        unknown: Causes of errors that `W_c` lacks, such as `ErrorBudget.unknown`.

    Raises:
        ValueError: If `W` is not finite or has not one column per parameter, or the
            noise scale or the precision is not positive.
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
    asked = asked_errors(space, z, precision)
    G, prior = W / noise_scale * asked, asked * np.asarray(space.prior_weights())
    W_c = np.zeros((len(W), 0)) if W_c is None else W_c / noise_scale
    spread, alone = (spread_of(G, W_c, weights) for weights in (prior, 0.0 * prior))
    outlooks = _outlooks(space, z, asked, spread=spread, alone=alone)
    return Identifiability(
        verdict=verdict(max(p.ratio for p in outlooks)),
        parameters=outlooks,
        directions=named_directions(spread, space.names),
        spread=spread,
        asked=asked,
        precision=precision,
        has_prior=space.has_prior,
        informed=count_informed(information(G, W_c), prior),
        conditioning=numbers,
        n_data=int(np.any(W != 0.0, axis=1).sum()) if n_data is None else n_data,
        unknown=unknown,
    )


def _outlooks(
    space: ParameterSpace,
    z: Float[AnyVector, " n_p"],
    asked: Float[HostArray, " n_p"],
    *,
    spread: Spread,
    alone: Spread,
) -> tuple[ParameterOutlook, ...]:
    """Convert spreads in units of the asked standard errors to SI."""
    slope, ratios = space.slopes(z), spread.errors()
    in_si = slope * asked
    errors, data_only = in_si * ratios, in_si * alone.errors()
    weights = np.asarray(space.prior_weights())
    values = np.asarray(space.from_scaled(jax.device_put(z)))
    outlooks = []
    for i, parameter in enumerate(space.parameters):
        plain = parameter.unit == "rad" or values[i] == 0.0
        outlooks.append(
            ParameterOutlook(
                name=parameter.name,
                value=float(values[i]),
                standard_error=float(errors[i]),
                data_only=float(data_only[i]),
                prior=float(slope[i] / weights[i]) if weights[i] > 0.0 else None,
                asked=float(in_si[i]),
                relative=None if plain else float(errors[i] / abs(values[i])),
                ratio=float(ratios[i]),
                verdict=verdict(float(ratios[i])),
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
    precision: float = PRECISION,
    progress: Callable[[EquilibriumProgress], None] = lambda _: None,
) -> Identifiability:
    """Predict what markers in these configurations would tell, before measuring.

    The verdict is that of `identifiability`.

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
        precision: Standard error that is asked for, relative to the value [-].
        progress: Called at the end of each equilibrium, from the thread that found it.

    Raises:
        ValueError: If an input is wrong.
        RuntimeError: If a configuration has no equilibrium; the text names it.
    """
    check_precision(precision)
    measured = as_sequence(configurations)
    found = survey(
        model,
        parameters,
        measured,
        at=at,
        noise=noise,
        newton=newton,
        uncertain=uncertain,
        progress=progress,
    )
    n_p = len(found.space.names)
    none = np.zeros((0, n_p))
    W_ep = np.concatenate([none, *(s.W_ep for s in found.sensed)])
    W, W_c = in_noise_units(found.sensed) if found.sensed else (none, None)
    W_pp = sum((s.W_pp for s in found.sensed), np.zeros((n_p, n_p)))
    return identifiability(
        W,
        found.space,
        found.z,
        n_data=len(W),
        W_ep=W_ep,
        W_pp=W_pp,
        W_c=W_c,
        precision=precision,
        unknown=found.unknown,
    )


class Sensed(Module):
    """Compliances of one configuration [m], in units of its jitter (W), and W_pp [J].

    W_c is the change per standard deviation of each error that is considered, and A
    that of each offset of a recording and share of a motion, in units of the jitter
    too; see `considered_errors` and `CorrelatedNoise`.
    `failure` says why there is no equilibrium; it is empty if there is one.
    """

    name: str
    W_ep: Float[HostArray, "n_e n_p"]
    W: Float[HostArray, "n_e n_p"]
    W_c: Float[HostArray, "n_e n_errors"]
    A: Float[HostArray, "n_e n_columns"]
    W_pp: Float[HostArray, "n_p n_p"]
    failure: str


def in_noise_units(
    sensed: Sequence[Sensed],
) -> tuple[Float[HostArray, "n_e n_p"], Float[HostArray, "n_e n_errors"]]:
    """Stack compliances and errors of configurations in units of their noise [-]."""
    stack = lambda name: np.concatenate([getattr(s, name) for s in sensed])
    A = stack("A")
    return whitened(A, stack("W")), whitened(A, stack("W_c"))


class Survey(Module):
    """Compliances of configurations at scaled values z of the parameters [-].

    `unknown` are causes of errors that they lack, see `ErrorBudget`.
    """

    space: ParameterSpace
    z: Float[Array, " n_p"]
    sensed: tuple[Sensed, ...]
    unknown: tuple[str, ...] = ()


def survey(
    model: Model,
    parameters: Parameters,
    configurations: Sequence[Configuration],
    *,
    at: Float[AnyVector, " n_p"] | None = None,
    noise: float | None = None,
    newton: NewtonSettings | None = None,
    uncertain: Uncertain | None = None,
    required: int | None = None,
    progress: Callable[[EquilibriumProgress], None] = lambda _: None,
) -> Survey:
    """Solve configurations at one value of the parameters and differentiate them.

    Arguments and errors are those of `rank_configurations`. The first `required`
    configurations, by default all, must have an equilibrium.
    """
    check_process()
    if noise is not None and not 0.0 < noise < np.inf:
        raise ValueError(f"noise must be positive and finite [m], got {noise:g}.")
    space = as_space(parameters)
    z = _scaled_values(space, at)
    if not configurations:
        check_parameters(model, space)
        return Survey(space, z, ())
    mesh, mechanism = model.mesh, model.mechanism
    # A configuration without effectors is no error: the verdict says it sees nothing.
    posed = [
        measured_at_rest(c, mesh, mechanism) if c.markers or c.effectors else c
        for c in configurations
    ]
    lanes = configuration_lanes(mesh, posed, mechanism)
    check_references(configurations, lanes.effectors)
    arrays, uncertain = lanes.arrays, uncertain or Uncertain()
    check_parameters(model, space, _lane(arrays, 0))
    problem = CalibrationProblem(model, space, arrays, newton or NewtonSettings())
    names = tuple(c.name for c in configurations)
    required = len(names) if required is None else required
    with Workers(model, len(names)) as workers:
        evaluator = Evaluator(problem, workers)
        solution = evaluator.equilibria(z, reports_of(progress, names))
        moved = evaluator.effectors(z, solution)
        if required:
            there = jax.tree.map(lambda leaf: leaf[:required], solution)
            check_converged(there, names)
        u = solution.displacement
        compliance = evaluator.energy_compliances(z, u)
        errors = considered_errors(
            workers, problem, configurations, uncertain, z=z, equilibrium=solution
        )
    weights = np.asarray(arrays.effectors.inverse_std).reshape(len(names), -1)
    if noise is not None:
        weights = np.where(weights > 0.0, 1.0 / noise, 0.0)
    # Nothing is measured yet: the motion is that of the model.
    records = [
        tuple(replace(e, measured=e.among(rows)) for e in own)
        for own, rows in zip(lanes.effectors, np.nan_to_num(moved), strict=True)
    ]
    weighed = eqx.tree_at(
        lambda e: e.inverse_std,
        jax.tree.map(np.asarray, arrays.effectors),
        weights.reshape(len(names), -1, 3),
    )
    correlated = correlated_noise(
        configurations,
        space=space,
        effectors=weighed,
        records=records,
        uncertain=uncertain,
    )
    all_A = np.asarray(jax.tree.map(np.asarray, correlated).columns(weighed))
    all_A = all_A.reshape(len(names), -1, all_A.shape[1])
    causes = errors.by_cause()
    columns = [error for own in causes.values() for error in own.values()]
    all_W_c = np.stack([np.zeros_like(weights), *columns], axis=2)[:, :, 1:]
    sensed, compliance = [], jax.tree.map(np.asarray, compliance)
    for i, name in enumerate(names):
        W_ep, W_pp, ok = _lane(compliance, i)
        seen, one = weights[i] > 0.0, _lane(solution, i)
        outcome = one.result if not one.converged else RESULTS.singular
        failure = "" if one.converged and ok else str(RESULTS[outcome])
        if failure and i < required:
            raise RuntimeError(f"configuration {name!r}: {failure}.")
        W, W_c = (weights[i, seen, None] * own[seen] for own in (W_ep, all_W_c[i]))
        A = all_A[i, seen]
        sensed.append(Sensed(name, W_ep[seen], W, W_c, A, W_pp, failure))
    return Survey(space, z, tuple(sensed), unknown_causes(uncertain, causes))


def _lane(batch, i: int):
    """Pick one configuration of a batch."""
    return jax.tree.map(lambda leaf: leaf[i], batch)


def _scaled_values(
    space: ParameterSpace, at: Float[AnyVector, " n_p"] | None
) -> Float[Array, " n_p"]:
    z = space.start() if at is None else jnp.asarray(at, float)
    n_p = len(space.names)
    if z.shape != (n_p,) or not bool(jnp.all(jnp.isfinite(z))):
        raise ValueError(
            f"`at` must be {n_p} finite scaled values, one per parameter "
            f"({', '.join(space.names)}), got {np.asarray(z)}; "
            "`space.to_scaled` makes them of SI values."
        )
    return z
