"""Scenes of SOFA: a calibrated robot, calibrated again for what SOFA will run."""

from softcal_jax.exchange._formats import NotConvergedError as NotConvergedError
from softcal_jax.exchange.sofa._component import PluginElasticity as PluginElasticity
from softcal_jax.exchange.sofa._export import (
    SofaExport as SofaExport,
    export_sofa as export_sofa,
)
