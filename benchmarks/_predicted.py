"""Do the errors that a fit states hold in poses that it has not seen?"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from softcal_jax._typing import HostArray
from softcal_jax.calibration import CalibrationResult, ConfigurationResult
from softcal_jax.identifiability import WEAK_UP_TO, assess


class Coordinates(NamedTuple):
    """Coordinates of predicted markers, one per row and axis, in m.

    Parameters and noise are uncertain; that the model is, its misfit tells as noise.

    Attributes:
        error: Predicted minus measured.
        by_parameters: Standard error by the parameters.
        by_noise: Standard deviation of the noise.
    """

    error: HostArray
    by_parameters: HostArray
    by_noise: HostArray

    @property
    def coverage(self) -> float:
        """Share of them within their intervals of 95 % [-]."""
        std = np.hypot(self.by_parameters, self.by_noise)
        return float(np.mean(np.abs(self.error) < 1.96 * std))

    def figures(self) -> dict[str, float]:
        """Root mean squares over all of them, in mm."""
        rms = lambda values: 1e3 * float(np.sqrt(np.mean(values**2)))
        names = ("held_out_coordinate", "interval_parameters", "interval_noise")
        return {f"{n}_mm": rms(values) for n, values in zip(names, self, strict=True)}


def predicted_coordinates(
    result: CalibrationResult, fits: Sequence[ConfigurationResult]
) -> Coordinates:
    """Collect the coordinates of predicted markers with their uncertainties."""
    rows = []
    for fit in fits:
        assert fit.W_ep is not None
        for marker, error in zip(fit.points, fit.error_after, strict=True):
            W = fit.W_ep[marker.index]
            std = np.sqrt(np.sum(W @ result.budget.covariance * W, axis=1))
            noise = np.broadcast_to(marker.std * result.uncertainty.level, error.shape)
            rows.append((error, std, noise))
    return Coordinates(*map(np.array, zip(*rows, strict=True)))


def called_identified(result: CalibrationResult) -> int:
    """Parameters that neither data nor prior know well enough, yet called known."""
    outlook = assess(result).identifiability
    return sum(
        p.verdict == "identifiable"
        and p.data_only > WEAK_UP_TO * p.asked
        and (p.prior is None or p.prior > WEAK_UP_TO * p.asked)
        for p in outlook.parameters
    )
