"""Scenes of SOFA: a calibrated robot, calibrated again for what SOFA will run."""

from softcal_jax.exchange.sofa._component import (
    PluginElasticity,
    SofaLaw,
    SofaRelease,
    SofaUnits,
)
from softcal_jax.exchange.sofa._export import (
    NotConvergedError,
    SofaExport,
    export_sofa,
)

__all__ = [
    "NotConvergedError",
    "PluginElasticity",
    "SofaExport",
    "SofaLaw",
    "SofaRelease",
    "SofaUnits",
    "export_sofa",
]
