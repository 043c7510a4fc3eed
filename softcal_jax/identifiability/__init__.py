"""What the data can tell about the parameters, and what to measure next (Sec. V)."""

from softcal_jax.identifiability._assessment import Assessment, assess
from softcal_jax.identifiability._conditioning import Conditioning, conditioning
from softcal_jax.identifiability._identify import identifiability, identify
from softcal_jax.identifiability._prediction import Prediction, predict_spread
from softcal_jax.identifiability._ranking import (
    Gain,
    Ranking,
    Unranked,
    rank_configurations,
)
from softcal_jax.identifiability._result import (
    Identifiability,
    ParameterOutlook,
    percent,
)
from softcal_jax.identifiability._spread import (
    IDENTIFIABLE_UP_TO,
    WEAK_UP_TO,
    Direction,
    Spread,
    Verdict,
)
from softcal_jax.identifiability._verdict import RunVerdict, Tone, end_of, verdict_of

__all__ = [
    "IDENTIFIABLE_UP_TO",
    "WEAK_UP_TO",
    "Assessment",
    "Conditioning",
    "Direction",
    "Gain",
    "Identifiability",
    "ParameterOutlook",
    "Prediction",
    "Ranking",
    "RunVerdict",
    "Spread",
    "Tone",
    "Unranked",
    "Verdict",
    "assess",
    "conditioning",
    "end_of",
    "identifiability",
    "identify",
    "percent",
    "predict_spread",
    "rank_configurations",
    "verdict_of",
]
