"""Every unknown of a calibration, and what the considered ones do to its rows."""

from softcal_jax.unknowns._attachments import (
    FAR_BEYOND as FAR_BEYOND,
    Attachments as Attachments,
    attachments as attachments,
)
from softcal_jax.unknowns._considered import (
    compile_considered as compile_considered,
    considered_errors as considered_errors,
)
from softcal_jax.unknowns._unknowns import (
    CREEP as CREEP,
    FIRST_SHARE as FIRST_SHARE,
    MESH as MESH,
    Setting as Setting,
    Unknown as Unknown,
    creep_of as creep_of,
    held_nodes as held_nodes,
    recording_names as recording_names,
    unknowns as unknowns,
)
