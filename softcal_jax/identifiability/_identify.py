"""Judge which parameters the data can determine, before or after a calibration."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._lanes import lane_of
from softcal_jax._process import check_process
from softcal_jax._typing import Array, Float, HostArray
from softcal_jax.calibration import Evaluator, as_sequence, linear_model
from softcal_jax.configurations import Configuration, check_numbers, configuration_lanes
from softcal_jax.equilibrium import (
    RESULTS,
    EquilibriumProgress,
    Model,
    NewtonSettings,
    Workers,
    check_converged,
    outcome_words,
    reports_of,
)
from softcal_jax.fields import (
    PRECISION,
    Parameters,
    ParameterSpace,
    Uncertain,
    as_space,
    asked_errors,
    check_parameters,
    check_precision,
)
from softcal_jax.identifiability._result import (
    WEAK_UP_TO,
    Identifiability,
    ParameterOutlook,
    Spread,
    conditioning,
    information,
    named_directions,
    spread_of,
    verdict,
)
from softcal_jax.inference import ANY_ANGLE, LinearModel, error_budget, independent
from softcal_jax.unknowns import (
    AnyArray,
    Problem,
    check_references,
    compile_considered,
    considered_errors,
    correlated_noise,
)


def identifiability(
    linear: LinearModel,
    space: ParameterSpace,
    z: Float[AnyArray, " n_p"],
    *,
    model: Model | None = None,
    W_ep: Float[HostArray, "n_e n_p"] | None = None,
    W_pp: Float[HostArray, "n_p n_p"] | None = None,
    precision: float = PRECISION,
) -> Identifiability:
    """Judge what the data of a linear model tell about the parameters; Sec. V-C.

    The verdict compares the predicted standard error of each parameter with the one
    that is asked for (`IDENTIFIABLE_UP_TO`, `WEAK_UP_TO`), which is relative to the
    value, or absolute for angles and errors of the setup, see `asked_errors`. A stated
    prior (`prior_std`) counts like a measurement. Bounds do not count: a parameter that
    no data see has no finite error, however narrow they are, and one on a bound counts
    as free. The verdict is local: at E_l = E_t the fibre angle has no effect.

    Args:
        linear: The fit, such as `CalibrationResult.linear`.
        space: The parameters.
        z: Their scaled values, such as `CalibrationResult.z` [-].
        model: The model, such as `CalibrationResult.model`, whose law declares what the
            parameters are; see `asked_errors`.
        W_ep: Compliances in metres, for condition numbers [m].
        W_pp: Sum over the configurations of H_p K^-1 H_p^T [J].
        precision: Standard error that is asked for, relative to the value [-].

    Raises:
        ValueError: If a compliance is not finite, or the scale of the noise or the
            precision is not positive.
    """
    if not 0.0 < linear.scale < np.inf:
        raise ValueError(f"the scale must be positive, got {linear.scale:g}.")
    fit = linear.of_fit().with_free()
    numbers = conditioning(fit.whiten(fit.W) / fit.scale, W_ep=W_ep, W_pp=W_pp)
    asked = asked_errors(space, z, precision, model=model)
    in_asked = fit.per(asked)
    spread, alone = spread_of(in_asked), spread_of(in_asked.by_data_alone())
    outlooks = _outlooks(space, z, asked, spread=spread, alone=alone)
    # Where there is no prior, the data must tell enough for "weakly identifiable".
    prior = np.where(in_asked.prior_weights, in_asked.prior_weights, 1.0 / WEAK_UP_TO)
    beside_prior = information(in_asked) / np.outer(prior, prior)
    return Identifiability(
        verdict=verdict(max(p.ratio for p in outlooks)),
        parameters=outlooks,
        directions=named_directions(spread, space.names),
        spread=spread,
        asked=asked,
        precision=precision,
        has_prior=space.has_prior,
        informed=int(np.sum(np.linalg.eigvalsh(beside_prior) > 1.0)),
        conditioning=numbers,
        n_data=int(np.any(fit.W != 0.0, axis=1).sum()),
    )


def _outlooks(
    space: ParameterSpace,
    z: Float[AnyArray, " n_p"],
    asked: Float[HostArray, " n_p"],
    *,
    spread: Spread,
    alone: Spread,
) -> tuple[ParameterOutlook, ...]:
    """Convert spreads in units of the asked standard errors to SI."""
    slope = space.slopes(z)
    in_si = slope * asked
    radians = np.array([q.unit == "rad" for q in space.parameters])
    # What knows an angle no better than its range does not see it.
    seen = lambda std: np.where(radians & (std > ANY_ANGLE), np.inf, std)
    errors, data_only = (seen(in_si * s.errors()) for s in (spread, alone))
    ratios = errors / in_si
    weights = np.asarray(space.prior_weights())
    values = np.asarray(space.from_scaled(jax.device_put(z)))
    absolute = radians | (values == 0.0)
    return tuple(
        ParameterOutlook(
            name=parameter.name,
            value=float(values[i]),
            standard_error=float(errors[i]),
            data_only=float(data_only[i]),
            prior=float(slope[i] / weights[i]) if weights[i] > 0.0 else None,
            asked=float(in_si[i]),
            relative=None if absolute[i] else float(errors[i] / abs(values[i])),
            ratio=float(ratios[i]),
            verdict=verdict(float(ratios[i])),
            unit=parameter.unit,
        )
        for i, parameter in enumerate(space.parameters)
    )


def identify(
    model: Model,
    parameters: Parameters,
    configurations: Configuration | Sequence[Configuration],
    *,
    at: Float[AnyArray, " n_p"] | None = None,
    noise: float | None = None,
    newton: NewtonSettings | None = None,
    uncertain: Uncertain | None = None,
    precision: float = PRECISION,
    progress: Callable[[EquilibriumProgress], None] = lambda _: None,
) -> Identifiability:
    """Predict what markers would tell, before measuring; see `identifiability`.

    Args:
        model: The model.
        parameters: Parameters that would be calibrated, with start and bounds.
        configurations: Configurations with markers, of which `std` and `axes` are used;
            `measured` is ignored and may be missing.
        at: Scaled values z to linearise at, see `ParameterSpace.to_scaled`; the start
            by default [-].
        noise: Standard deviation of each coordinate of markers and other points,
            instead of their `std` [m]. Angles, lengths and forces keep theirs.
        newton: Settings of the equilibrium.
        uncertain: How well everything that is not calibrated is known; the defaults of
            `Uncertain` by default.
        precision: Standard error that is asked for, relative to the value [-].
        progress: Called after every few iterations of an equilibrium.

    Raises:
        ValueError: If an input is wrong.
        RuntimeError: If a configuration has no equilibrium; the text names it.
    """
    check_precision(precision)
    space, posed = as_space(parameters), as_sequence(configurations)
    z, uncertain = scaled_values(space, at), uncertain or Uncertain()
    if posed:
        problem = planned(model, space, posed, noise, newton, uncertain)
        seen = survey(problem, z, len(posed), progress)
    else:
        check_parameters(model, space)
        n_p = len(space.names)
        linear = independent(np.zeros((0, n_p)), tuple(space.names))
        seen = Survey(linear, linear.W, np.zeros((n_p, n_p)), ())
    report = identifiability(
        seen.linear,
        space,
        z,
        model=model,
        W_ep=seen.W_ep,
        W_pp=seen.W_pp,
        precision=precision,
    )
    budget = error_budget(
        seen.linear, space, z, noise_is_known=True, uncertain=uncertain
    )
    return replace(report, budget=budget)


def scaled_values(
    space: ParameterSpace, at: Float[AnyArray, " n_p"] | None
) -> Float[Array, " n_p"]:
    """Return the scaled values to linearise at, by default those of the start [-]."""
    z = space.start() if at is None else jnp.asarray(at, float)
    n_p = len(space.names)
    if z.shape != (n_p,) or not bool(jnp.all(jnp.isfinite(z))):
        raise ValueError(
            f"`at` must be {n_p} finite scaled values, one per parameter "
            f"({', '.join(space.names)}), got {np.asarray(z)}; "
            "`space.to_scaled` makes them of SI values."
        )
    return z


def planned(
    model: Model,
    space: ParameterSpace,
    configurations: tuple[Configuration, ...],
    noise: float | None,
    newton: NewtonSettings | None,
    uncertain: Uncertain,
) -> Problem:
    """Stack configurations that may not be measured yet; arguments as in `identify`."""
    check_process()
    if noise is not None and not 0.0 < noise < np.inf:
        raise ValueError(f"noise must be positive and finite [m], got {noise:g}.")
    mesh, mechanism = model.mesh, model.mechanism
    # A configuration without effectors is no error: the verdict says it sees nothing.
    posed = [
        c.measured_at_rest(mesh, mechanism) if c.markers or c.effectors else c
        for c in configurations
    ]
    lanes = configuration_lanes(mesh, posed, mechanism)
    check_references(configurations, lanes.effectors)
    if noise is not None:
        weight = np.array(lanes.arrays.effectors.inverse_std)
        points = weight[:, : lanes.arrays.effectors.nodes.shape[-2]]
        points[points > 0.0] = 1.0 / noise
        weights = lambda arrays: arrays.effectors.inverse_std
        weighed = eqx.tree_at(weights, lanes.arrays, jax.device_put(weight))
        lanes = lanes._replace(arrays=weighed)
    check_parameters(model, space, lane_of(lanes.arrays, 0))
    newton = newton or NewtonSettings()
    about = {"poses": configurations, "uncertain": uncertain, "newton": newton}
    return Problem(model, space, lanes, **about)


class Survey(NamedTuple):
    """What the configurations of a problem would tell, at one value of the parameters.

    Attributes:
        linear: Rows of what would be measured, without errors.
        W_ep: Compliances of these rows, in their units, per unit of lambda_p.
        W_pp: Sum over the configurations [J].
        failures: Why a configuration has no equilibrium; empty if it has one.
    """

    linear: LinearModel
    W_ep: Float[HostArray, "n_e n_p"]
    W_pp: Float[HostArray, "n_p n_p"]
    failures: tuple[str, ...]


def survey(
    problem: Problem,
    z: Float[Array, " n_p"],
    required: int,
    progress: Callable[[EquilibriumProgress], None],
) -> Survey:
    """Solve the configurations of a problem at scaled values, and differentiate them.

    The first `required` ones must have an equilibrium.
    """
    names, records = problem.names, problem.records
    with Workers(problem.model, len(names)) as workers:
        compile_considered(workers, problem, z)
        evaluator = Evaluator(problem, workers)
        solution = evaluator.equilibria(z, reports_of(progress, names))
        moved = evaluator.effectors(z, solution)
        if required:
            check_converged(lane_of(solution, slice(required)), names)
        compliance = evaluator.energy_compliances(z, solution.displacement)
        considered = considered_errors(
            workers,
            problem,
            z=z,
            equilibrium=solution,
            without_forces=evaluator.without_forces(z, solution),
        )
    if required:
        check_numbers(names[:required], records, moved, compliance.W_ep)
    regular = np.asarray(compliance.ok)
    failures = ["" if ok else RESULTS[RESULTS.singular] for ok in regular]
    for c in np.flatnonzero(~np.asarray(solution.converged)).tolist():
        failures[c] = outcome_words(lane_of(solution, c))
    for name, failure in zip(names[:required], failures, strict=False):
        if failure:
            raise RuntimeError(f"configuration {name!r}: {failure}.")
    # Nothing is measured yet: the motion is that of the model.
    read = tuple(
        tuple(replace(e, measured=e.among(rows)) for e in of_pose)
        for of_pose, rows in zip(records, np.nan_to_num(moved), strict=True)
    )
    moving = replace(problem, lanes=problem.lanes._replace(effectors=read))
    noisy = problem.with_noise(correlated_noise(moving))
    weight = np.asarray(problem.configurations.effectors.inverse_std)
    linear = linear_model(
        replace(noisy, n_held_out=len(names) - required),
        z,
        W_ep=compliance.W_ep,
        ok=[not failure for failure in failures],
        delta_e=np.zeros(weight.shape),
        considered=considered,
    )
    seen = (weight > 0.0) & (np.array(failures) == "")[:, None, None]
    return Survey(
        linear=linear.all_fitted(),
        W_ep=np.concatenate(np.asarray(compliance.W_ep))[seen.ravel()],
        W_pp=np.sum(np.asarray(compliance.W_pp), axis=0),
        failures=tuple(failures),
    )
