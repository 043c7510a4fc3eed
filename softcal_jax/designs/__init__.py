"""Design: fields and actuation that bring a robot to its goals, and can be printed."""

from softcal_jax.designs._design import DesignWatch as DesignWatch, design as design
from softcal_jax.designs._foam import (
    TPU as TPU,
    FoamTable as FoamTable,
    FoundFoam as FoundFoam,
    Infill as Infill,
    foam_region as foam_region,
    foam_table as foam_table,
    isotropic_range as isotropic_range,
    published_foam as published_foam,
    read_foam_table as read_foam_table,
    write_foam_table as write_foam_table,
)
from softcal_jax.designs._peaks import Peak as Peak, PeakLimits as PeakLimits
from softcal_jax.designs._printing import (
    Change as Change,
    Deviations as Deviations,
    Printing as Printing,
    specimens as specimens,
)
from softcal_jax.designs._result import (
    LEVEL as LEVEL,
    Alternative as Alternative,
    DesignGoal as DesignGoal,
    DesignResult as DesignResult,
    Trade as Trade,
)
