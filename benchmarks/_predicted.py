"""Do the errors that a fit states hold in poses that it has not seen?"""

from collections.abc import Sequence

import numpy as np

from softcal_jax.calibration import CalibrationResult, ConfigurationResult
from softcal_jax.identifiability import WEAK_UP_TO, assess


def coverage(result: CalibrationResult, fits: Sequence[ConfigurationResult]) -> float:
    """Share of the coordinates that are within their intervals of 95 % [-].

    Parameters and noise are uncertain; that the model is, its misfit tells as noise.
    """
    inside = []
    for fit in fits:
        assert fit.W_ep is not None
        for marker, error in zip(fit.points, fit.error_after, strict=True):
            rows = fit.W_ep[marker.index]
            variance = np.sum(rows @ result.budget.covariance * rows, axis=1)
            noise = marker.std * result.uncertainty.level
            inside.append(np.abs(error) < 1.96 * np.sqrt(variance + noise**2))
    return float(np.mean(inside))


def called_identified(result: CalibrationResult) -> int:
    """Parameters that neither data nor prior know well enough, yet called known."""
    outlook = assess(result).identifiability
    return sum(
        p.verdict == "identifiable"
        and p.data_only > WEAK_UP_TO * p.asked
        and (p.prior is None or p.prior > WEAK_UP_TO * p.asked)
        for p in outlook.parameters
    )
