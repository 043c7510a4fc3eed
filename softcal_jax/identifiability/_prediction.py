"""What the uncertainty of calibrated parameters does to predicted poses."""

import numpy as np

from softcal_jax._module import Module
from softcal_jax.calibration import ConfigurationResult
from softcal_jax.identifiability._result import Identifiability


class Prediction(Module):
    """Uncertainty of one predicted pose.

    Attributes:
        name: Name of the configuration.
        role: Whether it was fitted or held out.
        std: Standard error of its markers by that of the parameters, as a root mean
            square distance like that of the residuals [m]; infinite where it depends on
            parameters that nothing sees.
    """

    name: str
    role: str
    std: float


def predict_spread(
    fit: ConfigurationResult, found: Identifiability
) -> Prediction | None:
    """Carry the covariance of the parameters into the markers of a configuration.

    The rows W_ep of Eq. (9) times the covariance by all causes: what a pose would be
    off by if everything but the parameters were right.

    Args:
        fit: The fitted or predicted configuration.
        found: What the data of the calibration tell.

    Returns:
        The uncertainty of its pose; None if it has no measured points.
    """
    if fit.W_ep is None or not fit.points:
        return None
    variance = 0.0
    for marker in fit.points:
        rows = marker.seen[:, None] * fit.W_ep[marker.index] * found.asked
        variance += float(np.sum(found.spread.along(rows) ** 2))
    std = float(np.sqrt(variance / len(fit.points)))
    return Prediction(fit.name, fit.role, std)
