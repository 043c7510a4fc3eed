"""Calibrated models as input files of CalculiX and Abaqus."""

from softcal_jax.exchange.inp._write import (
    export_inp as export_inp,
    write_inp as write_inp,
)
