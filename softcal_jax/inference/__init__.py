"""Statistics of a fit: one linear model of all unknowns, and what follows from it."""

from softcal_jax.inference._least_squares import (
    RANK as RANK,
    Whitened as Whitened,
    determined as determined,
    span as span,
    whitened as whitened,
    whitened_rows as whitened_rows,
)
from softcal_jax.inference._linear_model import (
    ATTACHMENTS as ATTACHMENTS,
    NOISE as NOISE,
    ErrorColumns as ErrorColumns,
    LinearModel as LinearModel,
    independent as independent,
    no_errors as no_errors,
)
from softcal_jax.inference._residuals import (
    LackOfFit as LackOfFit,
    PosePrediction as PosePrediction,
    RecordingEstimate as RecordingEstimate,
    agreement_sentences as agreement_sentences,
    chance as chance,
    disagreeing as disagreeing,
    freedom_between as freedom_between,
    jitter_freedom as jitter_freedom,
    lack_of_fit as lack_of_fit,
    predicted_by_others as predicted_by_others,
    recording_estimates as recording_estimates,
    restricted_likelihood as restricted_likelihood,
)
from softcal_jax.inference._uncertainty import (
    ANY_ANGLE as ANY_ANGLE,
    BLIND_FROM as BLIND_FROM,
    EXACT as EXACT,
    UNLIKELY as UNLIKELY,
    Cause as Cause,
    Difference as Difference,
    ErrorBudget as ErrorBudget,
    Estimate as Estimate,
    Uncertainty as Uncertainty,
    difference as difference,
    error_budget as error_budget,
    readable_error as readable_error,
    uncertainty as uncertainty,
)
