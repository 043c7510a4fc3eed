"""What the data can tell about the parameters, and what to measure next (Sec. V)."""

from softcal_jax.identifiability._assessment import Assessment, assess
from softcal_jax.identifiability._conditioning import Conditioning, conditioning
from softcal_jax.identifiability._design import Design, greedy_design
from softcal_jax.identifiability._directions import Direction
from softcal_jax.identifiability._display import table
from softcal_jax.identifiability._gains import Gain, Unranked
from softcal_jax.identifiability._identify import identifiability, identify
from softcal_jax.identifiability._ranking import Ranking, rank_configurations
from softcal_jax.identifiability._result import Identifiability, ParameterOutlook
from softcal_jax.identifiability._spread import (
    IDENTIFIABLE_BELOW,
    WEAK_BELOW,
    Verdict,
)

__all__ = [
    "IDENTIFIABLE_BELOW",
    "WEAK_BELOW",
    "Assessment",
    "Conditioning",
    "Design",
    "Direction",
    "Gain",
    "Identifiability",
    "ParameterOutlook",
    "Ranking",
    "Unranked",
    "Verdict",
    "assess",
    "conditioning",
    "greedy_design",
    "identifiability",
    "identify",
    "rank_configurations",
    "table",
]
