"""Every unknown of a calibration, and what the considered ones do to its rows."""

from softcal_jax.unknowns._considered import (
    compile_considered as compile_considered,
    considered_errors as considered_errors,
)
from softcal_jax.unknowns._unknowns import (
    CREEP as CREEP,
    FAR_BEYOND as FAR_BEYOND,
    FIRST_SHARE as FIRST_SHARE,
    MESH as MESH,
    Attachments as Attachments,
    Setting as Setting,
    Unknown as Unknown,
    attachments as attachments,
    creep_of as creep_of,
    held_nodes as held_nodes,
    recording_names as recording_names,
    unknowns as unknowns,
)
