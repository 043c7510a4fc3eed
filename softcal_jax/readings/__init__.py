"""Files of what was measured: tables of markers and sensors, and motion capture."""

from softcal_jax.readings._poses import (
    PoseTable as PoseTable,
    Registration as Registration,
    from_quaternion as from_quaternion,
    read_polhemus as read_polhemus,
    read_poses as read_poses,
    register as register,
)
from softcal_jax.readings._recording import Recording as Recording, Traces as Traces
from softcal_jax.readings._recording_file import (
    is_recording as is_recording,
    read_recording as read_recording,
)
from softcal_jax.readings._table import (
    MarkerTable as MarkerTable,
    TrackerWarning as TrackerWarning,
    read_markers as read_markers,
    read_table as read_table,
)
