"""What each recording alone says about the parameters, and whether they agree."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import numpy as np

from softcal_jax._module import Module
from softcal_jax._names import listed
from softcal_jax._typing import Array, Bool, Float, HostArray
from softcal_jax._units import readable_unit
from softcal_jax.calibration._budget import ConsideredErrors, considered_errors
from softcal_jax.calibration._evaluation import Evaluation
from softcal_jax.calibration._problem import CalibrationProblem
from softcal_jax.calibration._references import independent_recordings
from softcal_jax.calibration._uncertainty import UNLIKELY, Uncertainty, estimator
from softcal_jax.configurations import Configuration
from softcal_jax.equilibrium import Workers
from softcal_jax.fields import ParameterSpace, Uncertain, asked_errors

ROUNDING = 1e-6
"""Standard error of a difference that is rounding, over that of the values [-]."""

DETERMINED = 5.0
"""Standard error from which a recording alone does not determine a parameter [-].

In units of the one that is asked for by default: half the value of a modulus.
"""


class Posed(NamedTuple):
    """Configurations at the optimum.

    Attributes:
        configurations: The configurations.
        problem: Their calibration, with its noise.
        at: Their evaluation, in units of it.
    """

    configurations: tuple[Configuration, ...]
    problem: CalibrationProblem
    at: Evaluation


class RecordingEstimate(Module):
    """A parameter from one recording alone, to first order about the fit of all.

    Attributes:
        recording: Name of the recording.
        parameter: Name of the parameter.
        value: Its value from this recording, in SI.
        standard_error: Its standard error by all causes, in SI.
        fit: Its value from all recordings, in SI.
        apart: Difference from the fit of all, in standard errors of this difference.
            What both have in common, like an error of the loads, cancels in it; 0 for
            the only recording that was fitted [-].
        unit: SI unit.
        probability: Chance of a difference as large [-].
    """

    recording: str
    parameter: str
    value: float
    standard_error: float
    fit: float
    apart: float
    unit: str
    probability: float


def disagreeing(estimates: Sequence[RecordingEstimate]) -> list[RecordingEstimate]:
    """Return those that are farther from the fit than chance puts one of so many."""
    allowed = UNLIKELY / max(len(estimates), 1)
    return [e for e in estimates if e.probability < allowed]


def that_stack_up(fitted: Posed, held_out: Posed | None) -> tuple[Posed, ...]:
    """Return the fitted configurations, and those held out if their shapes agree."""
    if held_out is None or not _stack_up(fitted, held_out):
        return (fitted,)
    return fitted, held_out


def single_recordings(
    parts: Sequence[Posed],
    errors: ConsideredErrors,
    *,
    z: Float[Array, " n_p"],
    spread: Uncertainty,
) -> tuple[RecordingEstimate, ...]:
    """Ask each recording alone, fitted or held out, for the parameters.

    Args:
        parts: The fitted configurations, and those held out if any, of equal shapes.
        errors: What is held fixed and may be wrong, see `errors_of_all`.
        z: Where the fit ended, scaled [-].
        spread: Uncertainty by the noise.
    """
    if not spread.has_noise:
        return ()
    fitted = parts[0]
    values = lambda name: np.concatenate(
        [np.nan_to_num(getattr(p.at, name)) for p in parts]
    )
    n_fitted, W = len(fitted.at.error), values("W_ep")
    W_c = _in_noise_units(parts, errors)
    names = [independent_recordings(p.configurations) for p in parts]
    known = [np.asarray(p.at.equilibrium.converged) for p in parts]
    lanes = [
        name if ok and (k == 0 or name not in names[0]) else None
        for k, both in enumerate(zip(names, known, strict=True))
        for name, ok in zip(*both, strict=True)
    ]
    if len({*lanes} - {None}) < 2:
        return ()
    rows = np.repeat(np.array(lanes, object), len(W) // len(lanes))
    return recording_estimates(
        W,
        values("error"),
        np.nan_to_num(W_c),
        fitted=np.arange(len(W)) < n_fitted,
        rows={name: rows == name for name in dict.fromkeys(lanes) if name},
        space=fitted.problem.space,
        z=np.asarray(z),
        spread=spread,
    )


def not_asked(fitted: Posed, held_out: Posed | None) -> tuple[str, ...]:
    """Note the held-out recordings that `single_recordings` leaves out, if any."""
    if held_out is None or _stack_up(fitted, held_out):
        return ()
    of_fit, others = map(
        independent_recordings, (fitted.configurations, held_out.configurations)
    )
    own = [name for name in others if name and name not in of_fit]
    if not own:
        return ()
    names = listed([repr(name) for name in dict.fromkeys(own)])
    return (
        f"Held-out {names} cannot be asked alone for the parameters: not measured by "
        "as many markers or effectors as the fitted configurations.",
    )


def _stack_up(one: Posed, other: Posed) -> bool:
    """Return whether the configurations of both have arrays of the same shapes."""
    shapes = [
        jax.tree.map(lambda leaf: np.shape(leaf)[1:], p.problem.configurations)
        for p in (one, other)
    ]
    return jax.tree.leaves(shapes[0]) == jax.tree.leaves(shapes[1])


def errors_of_all(
    workers: Workers,
    parts: Sequence[Posed],
    uncertain: Uncertain,
    z: Float[Array, " n_p"],
) -> ConsideredErrors:
    """Compute once for all configurations what may be wrong with them.

    They share the errors, and the finer mesh on which that of the mesh is found.

    Args:
        workers: Run the configurations.
        parts: The configurations, of equal shapes.
        uncertain: What is uncertain.
        z: Scaled parameters [-].
    """
    problems = [p.problem for p in parts]
    join = lambda *leaves: jax.device_put(np.concatenate([*map(np.asarray, leaves)]))
    joined = eqx.tree_at(
        lambda p: p.configurations,
        problems[0].with_noise(None),
        jax.tree.map(join, *(p.configurations for p in problems)),
    )
    return considered_errors(
        workers,
        joined,
        tuple(c for p in parts for c in p.configurations),
        uncertain,
        z=z,
        equilibrium=jax.tree.map(join, *(p.at.equilibrium for p in parts)),
    )


def _in_noise_units(
    parts: Sequence[Posed], errors: ConsideredErrors
) -> Float[HostArray, "n_e n_errors"]:
    """Stack W_c of all configurations, in units of their noise [-]."""
    own = [error for those in errors.by_cause().values() for error in those.values()]
    stacked = np.stack([np.zeros(errors.columns.shape[1:]), *own], axis=2)[:, :, 1:]
    split = np.split(stacked, np.cumsum([len(p.configurations) for p in parts])[:-1])
    flat = lambda a: a.reshape(a.shape[0] * a.shape[1], a.shape[2])
    in_units = [
        p.problem.on_host_in_noise_units(flat(part))
        for p, part in zip(parts, split, strict=True)
    ]
    return np.concatenate(in_units)


def recording_estimates(
    W: Float[HostArray, "n_e n_p"],
    error: Float[HostArray, " n_e"],
    W_c: Float[HostArray, "n_e n_errors"],
    *,
    fitted: Bool[HostArray, " n_e"],
    rows: Mapping[str, Bool[HostArray, " n_e"]],
    space: ParameterSpace,
    z: Float[HostArray, " n_p"],
    spread: Uncertainty,
) -> tuple[RecordingEstimate, ...]:
    """Estimate parameters from each recording that determines them alone.

    Recordings are independent in units of the noise. With the gains G_k of one and G of
    all, their estimates differ by (G_k E_k - G) times the errors, whose covariance is
    that of the noise, s^2 I, and W_c W_c^T of what is held fixed and may be wrong.

    Args:
        W: Stacked compliances in noise units.
        error: Stacked errors likewise.
        W_c: Their change per standard deviation of what is held fixed.
        fitted: Rows that were fitted; the others were held out.
        rows: Rows of each recording.
        space: The parameters.
        z: Where the fit ended, scaled [-].
        spread: Its uncertainty.

    Returns:
        Estimates of the parameters that two or more recordings determine.
    """
    prior = np.asarray(space.prior_weights())
    scale = spread.level
    of_fit = np.where(fitted[:, None], W, 0.0)
    whole = np.nan_to_num(estimator(of_fit, spread, prior))
    by_prior = np.nan_to_num(spread.covariance) * prior
    size = lambda L: np.sqrt(
        np.sum((scale * L) ** 2, axis=1) + np.sum((L @ W_c) ** 2, axis=1)
    )
    fits = np.asarray(space.from_scaled(jax.device_put(z)))
    slopes, asked = space.slopes(z), asked_errors(space, z)
    found: dict[int, list[RecordingEstimate]] = {}
    for name, own in rows.items():
        alone = estimator(np.where(own[:, None], W, 0.0), spread, 0.0 * prior)
        shift, std = -alone @ error, size(alone)
        apart = np.hypot(size(alone - whole), np.linalg.norm(by_prior, axis=1))
        values = np.asarray(space.from_scaled(jax.device_put(z + np.nan_to_num(shift))))
        # Of the only recording that was fitted the difference is nothing but rounding.
        different = apart > ROUNDING * std
        shares = np.where(different, shift / np.where(different, apart, 1.0), 0.0)
        for i in np.flatnonzero(std < DETERMINED * asked):
            found.setdefault(int(i), []).append(
                RecordingEstimate(
                    recording=name,
                    parameter=space.names[i],
                    value=float(values[i]),
                    standard_error=float(slopes[i] * std[i]),
                    fit=float(fits[i]),
                    apart=float(shares[i]),
                    unit=space.parameters[i].unit,
                    probability=spread.chance(float(shares[i])),
                )
            )
    return tuple(e for own in found.values() if len(own) > 1 for e in own)


def agreement_sentences(estimates: Sequence[RecordingEstimate]) -> list[str]:
    """Say for each parameter what recordings alone give, and whether they agree."""
    sentences, doubtful = [], disagreeing(estimates)
    for name in dict.fromkeys(e.parameter for e in estimates):
        own = [e for e in estimates if e.parameter == name]
        factor, unit = readable_unit([own[0].fit], own[0].unit)
        each = ", ".join(
            f"{e.recording} {factor * e.value:.4g} +- {factor * e.standard_error:.2g}"
            f" ({abs(e.apart):.1f} standard errors from the fit)"
            for e in own
        )
        far = [e.recording for e in own if e in doubtful]
        verdict = "they agree"
        if far:
            verdict = f"{listed(far)} disagree{'s' * (len(far) == 1)} with it"
        of_each = f"{name} from each recording alone" + f" [{unit}]" * bool(unit)
        sentences.append(f"{of_each}: {each}: {verdict}.")
    return sentences
