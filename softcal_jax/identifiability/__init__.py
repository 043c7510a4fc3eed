"""What the data can tell about the parameters, and what to measure next (Sec. V)."""

from softcal_jax.identifiability._assessment import Assessment, assess
from softcal_jax.identifiability._conditioning import Conditioning, conditioning
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
    table,
)
from softcal_jax.identifiability._spread import (
    IDENTIFIABLE_BELOW,
    WEAK_BELOW,
    Direction,
    Verdict,
)

__all__ = [
    "IDENTIFIABLE_BELOW",
    "WEAK_BELOW",
    "Assessment",
    "Conditioning",
    "Direction",
    "Gain",
    "Identifiability",
    "ParameterOutlook",
    "Ranking",
    "Unranked",
    "Verdict",
    "assess",
    "conditioning",
    "identifiability",
    "identify",
    "rank_configurations",
    "table",
]
