"""Fields of moduli as graded foam, for the slicer IceSL."""

from softcal_jax.exchange.icesl._export import (
    IceslResult as IceslResult,
    export_icesl as export_icesl,
)
from softcal_jax.exchange.icesl._settings import Design as Design
