"""What a project is written from."""

from typing import NamedTuple

from softcal_jax._typing import Float, HostArray
from softcal_jax.proposal._body import Body, Held
from softcal_jax.proposal._recorded import Pose, Recorded


class Chamber(NamedTuple):
    """A surface group that is called like a chamber, and whether it has a rim."""

    group: str
    is_open: bool


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
        chambers: Surfaces that are called like chambers.
        recorded: The poses, if there is a recording.
        own_frame: Whether the recording has another frame than the mesh.
        markers: The markers.
    """

    model: str
    body: Body
    held: Held
    tip: Float[HostArray, "3"]
    chambers: tuple[Chamber, ...]
    recorded: Recorded | None
    own_frame: bool
    markers: tuple[MarkerPlace, ...]

    @property
    def poses(self) -> tuple[Pose, ...]:
        """All poses that were recorded, the one at rest first."""
        recorded = self.recorded
        return () if recorded is None else (recorded.rest, *recorded.others)
