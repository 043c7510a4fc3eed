"""What each recording alone says about the parameters, and whether they agree."""

from collections.abc import Sequence

import jax
import numpy as np

from softcal_jax._module import Module
from softcal_jax._names import listed
from softcal_jax._typing import Array, Float
from softcal_jax._units import readable_unit
from softcal_jax.fields import ParameterSpace, asked_errors
from softcal_jax.inference._linear_model import LinearModel
from softcal_jax.inference._uncertainty import UNLIKELY, Uncertainty

ROUNDING = 1e-6
"""Standard error of a difference that is rounding, over that of the values [-]."""

DETERMINED = 5.0
"""Standard error from which a recording alone does not determine a parameter [-].

In units of the one that is asked for by default: half the value of a modulus.
"""


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
    """Return those too far from the fit for chance, at `UNLIKELY` over all of them."""
    allowed = UNLIKELY / max(len(estimates), 1)
    return [e for e in estimates if e.probability < allowed]


def recording_estimates(
    linear: LinearModel,
    recordings: Sequence[str | None],
    *,
    space: ParameterSpace,
    z: Float[Array, " n_p"],
    spread: Uncertainty,
) -> tuple[RecordingEstimate, ...]:
    """Estimate parameters from each recording alone, fitted or held out.

    With the gains G_k of one recording and G of all, their estimates differ by
    (G_k E_k - G) times the errors, of which the covariance is that of the noise, and
    W_c W_c^T of what is considered.

    Args:
        linear: The fit; rows of recordings that were held out among its rows.
        recordings: Recording of each configuration, None for those to leave out.
        space: The parameters.
        z: Where the fit ended, scaled [-].
        spread: Its uncertainty by the noise.

    Returns:
        Estimates of the parameters that two or more recordings determine; none where
        the residuals show no noise.
    """
    names = [name for name in dict.fromkeys(recordings) if name is not None]
    if not spread.has_noise or len(names) < 2:
        return ()
    of_row = np.array(recordings, object)[linear.pose]
    whole = np.nan_to_num(linear.gain())
    by_prior = np.nan_to_num(linear.covariance()) * linear.prior_weights
    per_error = np.concatenate(
        [
            linear.scale * np.eye(len(linear.r)),
            linear.scale * linear.correlated.values,
            linear.considered.values,
        ],
        axis=1,
    )
    size = lambda L: np.linalg.norm(L @ per_error, axis=1)
    fits = np.asarray(space.from_scaled(jax.device_put(z)))
    slopes, asked, here = space.slopes(z), asked_errors(space, z), np.asarray(z)
    estimates: dict[int, list[RecordingEstimate]] = {}
    for name in names:
        rows = of_row == name
        alone = linear.only(rows).by_data_alone().all_fitted()
        gain = np.zeros(whole.shape)
        gain[:, rows] = alone.gain()
        shift, std = -gain @ linear.r, size(gain)
        apart = np.hypot(size(gain - whole), np.linalg.norm(by_prior, axis=1))
        moved = jax.device_put(here + np.nan_to_num(shift))
        values = np.asarray(space.from_scaled(moved))
        # Of the only recording that was fitted the difference is nothing but rounding.
        different = apart > ROUNDING * std
        shares = np.where(different, shift / np.where(different, apart, 1.0), 0.0)
        for i in np.flatnonzero(std < DETERMINED * asked):
            estimate = RecordingEstimate(
                recording=name,
                parameter=space.names[i],
                value=float(values[i]),
                standard_error=float(slopes[i] * std[i]),
                fit=float(fits[i]),
                apart=float(shares[i]),
                unit=space.parameters[i].unit,
                probability=spread.chance(float(shares[i])),
            )
            estimates.setdefault(int(i), []).append(estimate)
    return tuple(e for each in estimates.values() if len(each) > 1 for e in each)


def agreement_sentences(estimates: Sequence[RecordingEstimate]) -> list[str]:
    """Say for each parameter what recordings alone give, and whether they agree."""
    sentences, doubtful = [], disagreeing(estimates)
    for name in dict.fromkeys(e.parameter for e in estimates):
        of_name = [e for e in estimates if e.parameter == name]
        factor, unit = readable_unit([of_name[0].fit], of_name[0].unit)
        each = ", ".join(
            f"{e.recording} {factor * e.value:.4g} +- {factor * e.standard_error:.2g}"
            f" ({abs(e.apart):.1f} standard errors from the fit)"
            for e in of_name
        )
        far = [e.recording for e in of_name if e in doubtful]
        verdict = "they agree"
        if far:
            verdict = f"{listed(far)} disagree{'s' * (len(far) == 1)} with it"
        head = f"{name} from each recording alone" + f" [{unit}]" * bool(unit)
        sentences.append(f"{head}: {each}: {verdict}.")
    return sentences
