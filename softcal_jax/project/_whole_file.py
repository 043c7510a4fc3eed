"""What tables of a project file ask of the whole file, which is made of them."""

from typing import Any, Protocol, runtime_checkable


@runtime_checkable
class WholeFile(Protocol):
    """The schema of a project file, as its parts see it; see `ProjectTable`."""

    material: Any
    bodies: dict[str, Any]
    actuators: dict[str, Any]
    control_points: dict[str, Any]
    parameters: tuple[Any, ...]
    setup: tuple[Any, ...]
    parameter_space: Any
    markers: Any
    effectors: dict[str, Any]
    configurations: tuple[Any, ...]
