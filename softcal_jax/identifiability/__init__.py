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
from softcal_jax.identifiability._proposals import proposals as proposals
from softcal_jax.identifiability._ranking import (
    Gain as Gain,
    Ranking as Ranking,
    rank_configurations as rank_configurations,
)
from softcal_jax.identifiability._result import (
    Identifiability as Identifiability,
    ParameterOutlook as ParameterOutlook,
)
from softcal_jax.identifiability._spread import (
    IDENTIFIABLE_UP_TO as IDENTIFIABLE_UP_TO,
    LOST as LOST,
    WEAK_UP_TO as WEAK_UP_TO,
    Conditioning as Conditioning,
    Direction as Direction,
    Spread as Spread,
    Verdict as Verdict,
    conditioning as conditioning,
)
