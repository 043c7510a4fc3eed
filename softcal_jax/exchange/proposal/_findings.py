"""What a project is written from."""

from typing import NamedTuple

from softcal_jax._module import one_line
from softcal_jax._typing import Float, HostArray
from softcal_jax.exchange.proposal._body import Body, Held
from softcal_jax.exchange.proposal._recorded import Recorded, RecordedPose


class MarkerPlace(NamedTuple):
    """Where a marker is put, and how far from the mesh it was recorded [m]."""

    name: str
    place: Float[HostArray, "3"]
    distance: float


class Findings(NamedTuple):
    """What a project is written from.

    Attributes:
        model: The model, as the project file names it.
        body: Its mesh.
        held: What is proposed to be held.
        tip: Where a load is proposed to act [m].
        chambers: Whether chambers have a rim, by the names of their surfaces.
        recorded: The poses, if there is a recording.
        own_frame: Whether the recording has another frame than the mesh.
        markers: The markers.
    """

    model: str
    body: Body
    held: Held
    tip: Float[HostArray, "3"]
    chambers: dict[str, bool]
    recorded: Recorded | None
    own_frame: bool
    markers: tuple[MarkerPlace, ...]

    __repr__ = one_line

    @property
    def poses(self) -> tuple[RecordedPose, ...]:
        """All poses that were recorded, the one at rest first."""
        recorded = self.recorded
        return () if recorded is None else (recorded.rest, *recorded.others)
