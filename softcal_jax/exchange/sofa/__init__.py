"""Scenes of SOFA: a calibrated robot, calibrated again for what SOFA will run."""

from softcal_jax.exchange.sofa._component import (
    PluginElasticity as PluginElasticity,
    SofaLaw as SofaLaw,
    SofaRelease as SofaRelease,
    SofaUnits as SofaUnits,
)
from softcal_jax.exchange.sofa._export import (
    NotConvergedError as NotConvergedError,
    SofaExport as SofaExport,
    export_sofa as export_sofa,
)
