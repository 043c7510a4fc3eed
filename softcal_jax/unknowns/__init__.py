"""A calibration as a problem: its arrays, its noise, and all its unknowns."""

from softcal_jax.unknowns._noise import (
    RECORDINGS as RECORDINGS,
    AnyArray as AnyArray,
    Attachments as Attachments,
    CorrelatedNoise as CorrelatedNoise,
    attachments as attachments,
    check_references as check_references,
    creep_of as creep_of,
    independent_recordings as independent_recordings,
    noise_columns as noise_columns,
    read_once as read_once,
)
from softcal_jax.unknowns._problem import (
    Problem as Problem,
    ReadingLimits as ReadingLimits,
)
from softcal_jax.unknowns._unknowns import (
    FIRST_SHARE as FIRST_SHARE,
    MESH as MESH,
    Unknown as Unknown,
    compile_considered as compile_considered,
    considered_errors as considered_errors,
    correlated_noise as correlated_noise,
    held_nodes as held_nodes,
    unknowns as unknowns,
)
