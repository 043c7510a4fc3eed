"""Fields of moduli as graded foam, for the slicer IceSL."""

from softcal_jax.exchange.icesl._export import (
    export_icesl,
    read_foam_table,
    write_foam_table,
)
from softcal_jax.exchange.icesl._fields import Design
from softcal_jax.exchange.icesl._foam import (
    FoamTable,
    FoundFoam,
    Infill,
    published_foam,
)
from softcal_jax.exchange.icesl._report import IceslResult

__all__ = [
    "Design",
    "FoamTable",
    "FoundFoam",
    "IceslResult",
    "Infill",
    "export_icesl",
    "published_foam",
    "read_foam_table",
    "write_foam_table",
]
