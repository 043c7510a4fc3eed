"""Fields of moduli as graded foam, for the slicer IceSL."""

from softcal_jax.exchange.icesl._export import export_icesl as export_icesl
from softcal_jax.exchange.icesl._report import IceslResult as IceslResult
from softcal_jax.exchange.icesl._settings import Design as Design
