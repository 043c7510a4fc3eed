"""What the data can tell about the parameters, and what to measure next (Sec. V)."""

from softcal_jax.identifiability._assessment import (
    Assessment as Assessment,
    Prediction as Prediction,
    assess as assess,
)
from softcal_jax.identifiability._identify import (
    identifiability as identifiability,
    identify as identify,
)
from softcal_jax.identifiability._ranking import (
    Gain as Gain,
    Ranking as Ranking,
    proposals as proposals,
    rank_configurations as rank_configurations,
)
from softcal_jax.identifiability._result import (
    IDENTIFIABLE_UP_TO as IDENTIFIABLE_UP_TO,
    LOST as LOST,
    WEAK_UP_TO as WEAK_UP_TO,
    Conditioning as Conditioning,
    Direction as Direction,
    Identifiability as Identifiability,
    ParameterOutlook as ParameterOutlook,
    Spread as Spread,
    Verdict as Verdict,
    conditioning as conditioning,
)
