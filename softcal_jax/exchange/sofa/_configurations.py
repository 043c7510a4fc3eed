"""The numbers of a scene: its law, and supports, loads, actuators and effectors."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from softcal_jax import actuators
from softcal_jax._typing import Float, HostArray
from softcal_jax.configurations import (
    Configuration,
    ConfigurationArrays,
    EffectorRecord,
    configuration_lanes,
)
from softcal_jax.equilibrium import Model
from softcal_jax.exchange import _formats as formats
from softcal_jax.exchange.sofa._component import (
    SCALES,
    Scale,
    SofaRelease,
    SofaUnits,
    component_of,
)
from softcal_jax.export import file_stems, plain
from softcal_jax.fields import ParameterSpace

CONVERGED = 1e-9
"""Residual at which Newton of SOFA stops, relative to the nodal loads [-]."""

_IMPOSED = {
    (True, True): ("displacement", "length"),
    (True, False): ("force", "force"),
    (False, True): ("volumeGrowth", "volume"),
    (False, False): ("pressure", "pressure"),
}
"""SOFA's value type and factor of its unit, by (is a cable, imposes displacement)."""


def check_robot(model: Model) -> None:
    """Raise ValueError unless a scene can hold what is attached to the body."""
    formats.check_no_bodies(model, "a scene of SOFA")
    formats.check_actuators(
        model,
        (actuators.Cable, actuators.Chamber, actuators.SurfacePressure),
        "SOFA or its plugin SoftRobots; scenes hold cables without friction, chambers "
        "and surface pressures",
    )


def scene_data(
    name: str,
    model: Model,
    space: ParameterSpace,
    z: Any,
    configurations: Sequence[Configuration],
    displacements: Sequence[Float[HostArray, "n_nodes 3"]],
    *,
    release: SofaRelease,
    units: SofaUnits,
) -> dict[str, Any]:
    """Build the content of robot.json, in the units of the scene.

    `displacements` are what the linear model predicts in each configuration [m]. The
    parameters, of scaled values `z`, may also belong to loads and supports.
    """
    scale, masses = SCALES[units], formats.vertex_masses(model)
    lanes = configuration_lanes(model.mesh, configurations, model.mechanism)
    stems, written = file_stems([c.name for c in configurations]), {}
    for i, configuration in enumerate(configurations):
        _, lane = space.apply(model, lanes.arrays[i], z)
        force = np.asarray(lane.dead_loads)
        loaded = np.flatnonzero(np.any(force != 0.0, axis=1))
        loads = masses[:, None] * np.asarray(lane.acceleration) + force
        size = float(np.linalg.norm(np.where(lane.fixed, 0.0, loads)))
        x = model.mesh.points + np.asarray(displacements[i])
        written[configuration.name] = {
            "file": stems[i],
            "gravity": (scale.length * np.asarray(lane.acceleration)).tolist(),
            **_supports(model, configuration, lane, scale),
            "forces": {
                "indices": loaded.tolist(),
                "forces": (scale.force * force[loaded]).tolist(),
            },
            **_actuators(model, lane, scale),
            "effectors": _effectors(lane, lanes.effectors[i], x, scale),
            # Relative to the nodal loads; 0 without a load on free nodes.
            "stop at residual": CONVERGED * scale.force * size,
        }
    return {
        "format": "softcal_jax.sofa/1",
        "name": name,
        "release": release,
        "units": scale.words,
        "elasticity": component_of(model.law, model.n_tets, release, scale)._asdict(),
        "positions": (scale.length * model.mesh.points).tolist(),
        "vertex mass": masses.tolist(),
        "configurations": written,
    }


def _supports(
    model: Model, configuration: Configuration, lane: ConfigurationArrays, scale: Scale
) -> dict[str, Any]:
    fixed, imposed = np.asarray(lane.fixed), np.asarray(lane.imposed)
    if np.any(np.asarray(lane.springs.rest)):
        raise ValueError(
            f"configuration {configuration.name!r}: an elastic support that is moved "
            "is not written, since SOFA's springs pull towards the rest shape. Leave "
            "its displacement out."
        )
    moved = np.flatnonzero(np.any(fixed & (imposed != 0.0), axis=1))
    kinds = model.mechanism.actuators.kinds
    is_chamber = np.array([kind is actuators.Chamber.kind for kind in kinds], bool)
    if moved.size and np.any(is_chamber & np.asarray(lane.actuation.by_displacement)):
        raise ValueError(
            f"configuration {configuration.name!r}: a chamber with an imposed volume "
            "is not written beside a support that is moved, since SOFA counts its "
            "growth from there. Impose its pressure."
        )
    stiffness = scale.force / scale.length * np.asarray(lane.springs.coefficients())
    return {
        "held": [
            {
                "directions": directions.astype(int).tolist(),
                "indices": np.flatnonzero((fixed == directions).all(axis=1)).tolist(),
            }
            for directions in np.unique(fixed[fixed.any(axis=1)], axis=0)
        ],
        "moved": {
            "indices": moved.tolist(),
            "displacements": (scale.length * imposed[moved]).tolist(),
        },
        "springs": [
            {
                "directions": [int(axis == k) for k in range(3)],
                "indices": np.flatnonzero(values).tolist(),
                "stiffness": values[values != 0.0].tolist(),
            }
            for axis, values in enumerate(stiffness.T)
            if np.any(values)
        ],
    }


def _actuators(model: Model, lane: ConfigurationArrays, scale: Scale) -> dict[str, Any]:
    """Write cables, chambers and pressures that are imposed in a configuration."""
    written: dict[str, Any] = {"cables": [], "chambers": []}
    by_displacement = np.asarray(lane.actuation.by_displacement)
    for group in model.mechanism.actuators.groups:
        if isinstance(group, actuators.ChamberLids):
            continue  # without material, like the opening that SOFA sees
        owners = np.asarray(group.owner)
        for owner in np.unique(owners).tolist():
            moves = bool(by_displacement[owner])
            given = lane.actuation.value if moves else lane.actuation.forces
            value = float(np.asarray(given)[owner])
            if value == 0.0 and not moves:
                continue  # slack, or without pressure
            formats.check_rim(model, lane, owner, "SOFA")
            cable = isinstance(group, actuators.CableSegments)
            kind, unit = _IMPOSED[cable, moves]
            if cable:
                where = _path(model, owner, scale)
            else:  # SOFA pushes along the normals: into the body
                nodes = np.asarray(group.nodes)[owners == owner]
                where = {"triangles": nodes[:, ::-1].tolist()}
            name = model.mechanism.actuators.names[owner]
            imposed = {"value": getattr(scale, unit) * value, "value type": kind}
            written["cables" if cable else "chambers"].append(
                {"name": name, **where, **imposed}
            )
    return written


def _path(model: Model, owner: int, scale: Scale) -> dict[str, Any]:
    """Return the guides of a cable on the body, and the point on the ground, if any.

    SOFA allows one fixed point, from which the cable is pulled, and lists the other
    points from there.
    """
    guides = list(formats.cable_guides(model, owner))
    cable = f"the cable {model.mechanism.actuators.names[owner]!r}"
    for _, weights in guides:
        nodes = np.flatnonzero(weights)
        if np.isin(model.mesh.tets, nodes).sum(axis=1).max() < len(nodes):
            raise ValueError(
                f"{cable} has a guide in a channel, which follows the ring of wall "
                "around it; SOFA ties a point to one tet. Put the guide on the wall."
            )
    grounded = np.array([not weights.any() for _, weights in guides])
    if grounded.sum() > 1 or grounded[1:-1].any():
        raise ValueError(
            f"{cable} has more than one guide on the ground, or one between its ends; "
            "SOFA's CableConstraint knows one fixed point, at an end. Put the other "
            "guides on the body."
        )
    points = [(scale.length * point).tolist() for point, _ in guides]
    if grounded[-1]:
        points.reverse()
    pull_point = points.pop(0) if grounded.any() else None
    return {"points": points, "pull point": pull_point}


def _effectors(
    lane: ConfigurationArrays,
    records: Sequence[EffectorRecord],
    x: Float[HostArray, "n_nodes 3"],
    scale: Scale,
) -> list[dict[str, Any]]:
    """Write markers and other points: nodes, weights, and predicted positions."""
    nodes = np.asarray(lane.effectors.nodes)
    weights = np.asarray(lane.effectors.shares)
    written = []
    for record in records:
        if record.quantity != "point":
            continue
        used = weights[record.index] != 0.0
        carriers, share = nodes[record.index][used], weights[record.index][used]
        measured = scale.length * np.asarray(record.measured)
        written.append(
            {
                "name": record.name,
                "nodes": carriers.tolist(),
                "weights": share.tolist(),
                "predicted": (scale.length * share @ x[carriers]).tolist(),
                "measured": plain(measured) if np.isfinite(measured).any() else None,
            }
        )
    return written
