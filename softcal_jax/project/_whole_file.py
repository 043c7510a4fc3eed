"""What tables of a project file ask of the whole file, which is made of them."""

from collections.abc import Mapping, Sequence
from typing import Any, Protocol


class WholeFile(Protocol):
    """The schema of a project file, as its parts see it; see `ProjectTable`."""

    @property
    def material(self) -> Any:
        """The table [material]."""

    @property
    def bodies(self) -> Mapping[str, Any]:
        """The tables [bodies.NAME]."""

    @property
    def actuators(self) -> Mapping[str, Any]:
        """The tables [actuators.NAME]."""

    @property
    def control_points(self) -> Mapping[str, Any]:
        """The tables [control_points.NAME]."""

    @property
    def parameters(self) -> Sequence[Any]:
        """The tables [[parameters]]."""

    @property
    def setup(self) -> Sequence[Any]:
        """The tables [[setup]]."""

    @property
    def parameter_space(self) -> Any:
        """The table [parameter_space]."""

    @property
    def markers(self) -> Any:
        """The table [markers]."""

    @property
    def effectors(self) -> Mapping[str, Any]:
        """The tables [effectors.NAME]."""

    @property
    def configurations(self) -> Sequence[Any]:
        """The tables [[configurations]]."""
