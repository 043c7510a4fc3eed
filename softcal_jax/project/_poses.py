"""From the tables of a project file to configurations with measured positions."""

from pathlib import Path

import numpy as np

from softcal_jax._typing import Float, HostArray
from softcal_jax.configurations import (
    AbstractLoad,
    Configuration,
    EdgeForce,
    Markers,
    MarkerTable,
    PointForce,
    Registration,
    Support,
    SurfaceForce,
    SurfaceTraction,
    read_markers,
    register,
)
from softcal_jax.mesh import TetMesh
from softcal_jax.project._problems import at, suggestion
from softcal_jax.project._schema import (
    ConfigurationTable,
    GravityTable,
    LoadTable,
    MarkerEntry,
    MarkersTable,
    MeasuredTable,
)


def build_configuration(
    path: Path, table: ConfigurationTable, markers: MarkersTable | None, mesh: TetMesh
) -> tuple[Configuration, Registration | None]:
    """One posed robot, and the registration of its measurement if it has one.

    Raises:
        ProjectError: If a group, a marker, a file or a value in it is wrong.
    """
    key = f"configurations.{table.name}"
    supports = []
    for i, support in enumerate(table.supports, start=1):
        with at(path, f"{key}.supports[{i}]"):
            mesh.nodes(support.group)
            supports.append(
                Support(support.group, support.axes, support.displacement)
            )
    loads = []
    for i, load in enumerate(table.loads, start=1):
        with at(path, f"{key}.loads[{i}]"):
            loads.append(_load(load))
            loads[-1].nodal_forces(mesh)
    with at(path, f"{key}.markers"):
        chosen = None if markers is None else _markers(markers, table.markers)
    if markers is None and table.markers is not None:
        raise_without_markers(path, f"{key}.markers")
    measured = registration = None
    if table.measured is not None:
        if markers is None or chosen is None:
            raise_without_markers(path, f"{key}.measured")
        with at(path, f"{key}.measured"):
            measured, registration = _measured(
                path.parent, table.measured, markers, chosen
            )
    gravity = table.gravity
    if isinstance(gravity, GravityTable):
        x, y, z = (gravity.size * v for v in gravity.direction)
        gravity = (x, y, z)
    with at(path, key):
        configuration = Configuration(
            table.name, supports, gravity, loads, chosen, measured
        )
    return configuration, registration
