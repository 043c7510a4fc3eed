"""Statistics of a fit: one linear model of all unknowns, and what follows from it."""

from softcal_jax.inference._linear_model import (
    ATTACHMENTS,
    NOISE,
    ErrorColumns,
    LinearModel,
    independent,
    no_errors,
)
from softcal_jax.inference._rank import RANK, determined, span
from softcal_jax.inference._reml import freedom_between, restricted_likelihood
from softcal_jax.inference._residuals import (
    LackOfFit,
    PosePrediction,
    RecordingEstimate,
    agreement_sentences,
    chance,
    disagreeing,
    jitter_freedom,
    lack_of_fit,
    predicted_by_others,
    recording_estimates,
)
from softcal_jax.inference._uncertainty import (
    EXACT,
    REMEDIES,
    UNLIKELY,
    Cause,
    ErrorBudget,
    Uncertainty,
    error_budget,
    uncertainty,
)
from softcal_jax.inference._whitening import Whitened, whitened, whitened_rows

__all__ = [
    "ATTACHMENTS",
    "EXACT",
    "NOISE",
    "RANK",
    "REMEDIES",
    "UNLIKELY",
    "Cause",
    "ErrorBudget",
    "ErrorColumns",
    "LackOfFit",
    "LinearModel",
    "PosePrediction",
    "RecordingEstimate",
    "Uncertainty",
    "Whitened",
    "agreement_sentences",
    "chance",
    "determined",
    "disagreeing",
    "error_budget",
    "freedom_between",
    "independent",
    "jitter_freedom",
    "lack_of_fit",
    "no_errors",
    "predicted_by_others",
    "recording_estimates",
    "restricted_likelihood",
    "span",
    "uncertainty",
    "whitened",
    "whitened_rows",
]
