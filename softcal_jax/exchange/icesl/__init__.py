"""Fields of moduli as graded foam, for the slicer IceSL."""

from softcal_jax.exchange.icesl._export import (
    export_icesl as export_icesl,
    read_foam_table as read_foam_table,
    write_foam_table as write_foam_table,
)
from softcal_jax.exchange.icesl._fields import Design as Design
from softcal_jax.exchange.icesl._foam import (
    FoamTable as FoamTable,
    FoundFoam as FoundFoam,
    Infill as Infill,
    published_foam as published_foam,
)
from softcal_jax.exchange.icesl._report import IceslResult as IceslResult
