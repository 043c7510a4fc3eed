"""Every unknown of a calibration, and what those do that are only considered."""

from softcal_jax.unknowns._considered import MESH, ConsideredErrors, considered_errors
from softcal_jax.unknowns._unknowns import (
    Setting,
    held_nodes,
    recording_names,
    unknowns,
)

__all__ = [
    "MESH",
    "ConsideredErrors",
    "Setting",
    "considered_errors",
    "held_nodes",
    "recording_names",
    "unknowns",
]
