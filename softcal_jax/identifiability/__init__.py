"""What the data can tell about the parameters, and what to measure next (Sec. V)."""

from softcal_jax.identifiability._assessment import (
    Assessment,
    Prediction,
    RunVerdict,
    Tone,
    assess,
    end_of,
    verdict_of,
)
from softcal_jax.identifiability._identify import identifiability, identify
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
    Conditioning,
    Direction,
    Spread,
    Verdict,
    conditioning,
)

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
    "rank_configurations",
    "verdict_of",
]
