"""Fields of moduli as graded foam, for the slicer IceSL."""

from softcal_jax.exchange.icesl._export import export_icesl as export_icesl
from softcal_jax.exchange.icesl._fields import Design as Design
from softcal_jax.exchange.icesl._report import IceslResult as IceslResult
