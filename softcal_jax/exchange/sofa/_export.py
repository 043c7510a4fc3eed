"""Export a calibrated robot as a scene of SOFA: calibrate it again, and write it.

The numbers of a scene are its law, and supports, loads, actuators and effectors.
"""

import io
import os
import shutil
from collections.abc import Sequence
from contextlib import redirect_stderr
from pathlib import Path
from typing import Any, Literal, get_args

import meshio
import numpy as np

from softcal_jax import actuators
from softcal_jax._module import Module
from softcal_jax._text import check_known
from softcal_jax._typing import HostArray, Int
from softcal_jax.calibration import CalibrationResult, Watch
from softcal_jax.configurations import ConfigurationArrays
from softcal_jax.equilibrium import Model, model_for_law
from softcal_jax.exchange import _formats as formats
from softcal_jax.exchange._formats import ExportedPose
from softcal_jax.exchange.sofa._component import (
    SCALES,
    PluginElasticity,
    SofaLaw,
    SofaRelease,
    SofaUnits,
    component_of,
    law_for_sofa,
)
from softcal_jax.materials import SofaRotation
from softcal_jax.results import (
    LoadedResult,
    file_stems,
    plain,
    results_folder,
    write_json,
)

CONVERGED = 1e-9
"""Residual at which Newton of SOFA stops, relative to the nodal loads [-]."""

_IMPOSED = {
    (True, True): ("displacement", 1),
    (True, False): ("force", 1),
    (False, True): ("volumeGrowth", 3),
    (False, False): ("pressure", -1),
}
"""SOFA's value type, and the power of the factor of lengths that makes its unit, by (is
a cable, imposes displacement)."""

_WORDS = {
    "mm-kg-s": {"length": "mm", "force": "mN", "pressure": "kPa"},
    "SI": {"length": "m", "force": "N", "pressure": "Pa"},
}
"""Units of quantities, by the unit system."""


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
    poses: Sequence[ExportedPose],
    *,
    release: SofaRelease,
    units: SofaUnits,
) -> dict[str, Any]:
    """Build the content of robot.json, in the units of the scene."""
    scale, masses = SCALES[units], formats.vertex_masses(model)
    written = {}
    for pose, stem in zip(poses, file_stems([p.name for p in poses]), strict=True):
        lane = pose.lane
        force = np.asarray(lane.dead_loads)
        loaded = np.flatnonzero(np.any(force != 0.0, axis=1))
        loads = masses[:, None] * np.asarray(lane.acceleration) + force
        size = float(np.linalg.norm(np.where(lane.fixed, 0.0, loads)))
        written[pose.name] = {
            "file": stem,
            "gravity": (scale * np.asarray(lane.acceleration)).tolist(),
            **_supports(model, pose, scale),
            "forces": {
                "indices": loaded.tolist(),
                "forces": (scale * force[loaded]).tolist(),
            },
            **_actuators(model, lane, scale),
            "effectors": _effectors(model, pose, scale),
            # Relative to the nodal loads; 0 without a load on free nodes.
            "stop at residual": CONVERGED * scale * size,
        }
    return {
        "format": "softcal_jax.sofa/1",
        "name": name,
        "release": release,
        "units": _WORDS[units],
        "elasticity": component_of(model.law, model.n_tets, release, scale)._asdict(),
        "positions": (scale * model.mesh.points).tolist(),
        "vertex mass": masses.tolist(),
        "configurations": written,
    }


def _supports(model: Model, pose: ExportedPose, scale: float) -> dict[str, Any]:
    lane = pose.lane
    fixed, imposed = np.asarray(lane.fixed), np.asarray(lane.imposed)
    if np.any(np.asarray(lane.springs.rest)):
        raise ValueError(
            f"configuration {pose.name!r}: an elastic support that is moved "
            "is not written, since SOFA's springs pull towards the rest shape. Leave "
            "its displacement out."
        )
    moved = np.flatnonzero(np.any(fixed & (imposed != 0.0), axis=1))
    kinds = model.mechanism.actuators.kinds
    is_chamber = np.array([kind is actuators.Chamber.kind for kind in kinds], bool)
    if moved.size and np.any(is_chamber & np.asarray(lane.actuation.by_displacement)):
        raise ValueError(
            f"configuration {pose.name!r}: a chamber with an imposed volume "
            "is not written beside a support that is moved, since SOFA counts its "
            "growth from there. Impose its pressure."
        )
    stiffness = np.asarray(lane.springs.coefficients())  # the same in all units
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
            "displacements": (scale * imposed[moved]).tolist(),
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


def _actuators(model: Model, lane: ConfigurationArrays, scale: float) -> dict[str, Any]:
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
            kind, power = _IMPOSED[cable, moves]
            if cable:
                where = _path(model, owner, scale)
            else:  # SOFA pushes along the normals: into the body
                nodes = np.asarray(group.nodes)[owners == owner]
                where = {"triangles": nodes[:, ::-1].tolist()}
            name = model.mechanism.actuators.names[owner]
            imposed = {"value": scale**power * value, "value type": kind}
            written["cables" if cable else "chambers"].append(
                {"name": name, **where, **imposed}
            )
    return written


def _path(model: Model, owner: int, scale: float) -> dict[str, Any]:
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
    points = [(scale * point).tolist() for point, _ in guides]
    if grounded[-1]:
        points.reverse()
    pull_point = points.pop(0) if grounded.any() else None
    return {"points": points, "pull point": pull_point}


def _effectors(model: Model, pose: ExportedPose, scale: float) -> list[dict[str, Any]]:
    """Write markers and other points: nodes, weights, and predicted positions."""
    x = model.mesh.points + pose.displacement
    nodes = np.asarray(pose.lane.effectors.nodes)
    weights = np.asarray(pose.lane.effectors.shares)
    written = []
    for record in pose.effectors:
        if record.quantity != "point":
            continue
        used = weights[record.index] != 0.0
        carriers, share = nodes[record.index][used], weights[record.index][used]
        measured = scale * np.asarray(record.measured)
        written.append(
            {
                "name": record.name,
                "nodes": carriers.tolist(),
                "weights": share.tolist(),
                "predicted": (scale * share @ x[carriers]).tolist(),
                "measured": plain(measured) if np.isfinite(measured).any() else None,
            }
        )
    return written


_NEEDED = {
    "SoftRobots": "SoftRobots (cables and chambers), which the binaries of SOFA hold",
    "Anisotropy": "Anisotropy (https://github.com/VannesteFelix/anisotropy), with "
    "SoftRobots.Inverse that it needs: both must be built from source against this "
    "release, and loaded by `-l Anisotropy`",
}


def write_scene(
    directory: Path,
    data: dict[str, Any],
    tets: Int[HostArray, "n_tets 4"],
    *,
    text: Sequence[str],
    notes: Sequence[str],
    force: bool = False,
) -> None:
    """Write a scene to a folder, whole or not at all, from its `scene_data`.

    README.md quotes `text`, lines on the calibration in columns, and `notes`.
    """
    with results_folder(directory, force=force) as folder:
        mesh = meshio.Mesh(data["positions"], [("tetra", tets)])
        with redirect_stderr(io.StringIO()):  # meshio warns of text, which SOFA reads
            mesh.write(folder / "robot.vtk", file_format="vtk42", binary=False)
        shutil.copyfile(Path(__file__).with_name("scene.py"), folder / "scene.py")
        readme = _readme(data, text, notes)
        (folder / "README.md").write_text(readme, encoding="utf-8")
        write_json(folder / "robot.json", data)


def _readme(data: dict[str, Any], text: Sequence[str], notes: Sequence[str]) -> str:
    """Say what is needed, how to run the scene, and what to expect of it."""
    poses, elasticity = data["configurations"], data["elasticity"]
    driven = [name for name, p in poses.items() if p["cables"] or p["chambers"]]
    plugins = ["SoftRobots"] * bool(driven)
    plugins += [elasticity["plugin"]] * (elasticity["plugin"] in _NEEDED)
    units = ", ".join(f"{what} {unit}" for what, unit in data["units"].items())
    needed = "".join(f"\n- {_NEEDED[plugin]}." for plugin in plugins)
    loaded = "".join(f" -l {plugin}" for plugin in ["SofaPython3", *plugins])
    steps = 100 if next(iter(poses)) in driven else 1
    on_driven = f"""
With cables or chambers: {", ".join(driven)}. SOFA solves these in time, by long \
implicit steps that lose all motion: run on until the effectors stand still. If they \
do not, shorten TIME_STEP in scene.py.
"""
    return f"""\
# {data["name"]} in SOFA

Written by softcal_jax for SOFA {data["release"]} (from the sources of \
{data["release"]}.00), to be run with

- SofaPython3, with NumPy in its Python.{needed}

```sh
runSofa{loaded} -g batch -n {steps} scene.py
```

or, to see it, without `-g batch -n ...` and then Animate. Each step writes where the \
effectors are to `effectors_CONFIGURATION.csv`, with the distance from what \
softcal_jax predicts for the same mesh and law: it should fall to the tolerance of the \
solver.

Configurations: {", ".join(poses)}. The first is run, another one with \
the environment variable SOFTCAL_CONFIGURATION set to its name.
{on_driven if driven else ""}
Units: {units}, mass kg, time s. The law is that of `{elasticity["component"]}`.

## Calibrated for this mesh

SOFA runs linear tets, which are too stiff, and corotational ones with a rotation of \
its own. The values were therefore calibrated again with the mesh and the law of this \
scene, and belong to them alone:

```text
{chr(10).join(text)}
```
""" + "".join(f"\n{note}\n" for note in notes)


class SofaExport(Module):
    """What was written for SOFA.

    Attributes:
        component: The component that computes the law.
        result: Calibration of the model of SOFA, whose values the scene has.
        lines: Values and predictions of both models, and notes.
    """

    component: str
    result: CalibrationResult
    lines: tuple[str, ...]


def export_sofa(
    result: LoadedResult | str | os.PathLike[str],
    directory: str | os.PathLike[str],
    *,
    release: SofaRelease = "v26.06",
    units: SofaUnits = "mm-kg-s",
    law: SofaLaw = "same",
    rotation: SofaRotation = "edge",
    force: bool = False,
    watch: Watch | Literal[False] | None = None,
) -> SofaExport:
    """Write a calibrated robot as a static scene of SOFA, calibrated again for it.

    SOFA runs linear tets, which are too stiff, with a rotation of its own. So the model
    is fitted once more to the same measurements, with the mesh and the law of SOFA.

    The folder holds `scene.py` for SofaPython3, `robot.vtk` (the linear mesh),
    `robot.json` (all numbers, in the units of the scene), and `README.md` with the
    command that runs it. The scene holds all configurations, follows their markers and
    compares them with what the model predicts.

    Args:
        result: The results folder, its `result.json`, or what `load_result` returned.
        directory: The folder; it must be new or empty, or hold an earlier scene.
        release: Release of SOFA.
        units: Unit system of the scene.
        law: "same" writes the counterpart of the calibrated law; "corotational" takes
            SOFA's corotational tets for laws with the constants E and nu.
        rotation: Rotation of the corotational tets, see `SofaCorotational`; laws with a
            fibre take that of the plugin Anisotropy.
        force: Replace an earlier scene; files that a user added stay.
        watch: Called with what the calibration does, see `calibrate`.

    Raises:
        ResultError: If the result cannot be loaded, see `load_result`.
        FileExistsError: If the folder is not empty, and `force` is off or it holds
            something else.
        NotConvergedError: If the calibration does not converge; nothing is written.
        RuntimeError: If no configuration has an equilibrium with the model of SOFA.
        ValueError: If an option is unknown, or the law, the robot or a support has no
            counterpart in SOFA; the text says why, and what to do.
    """
    check_known("release", get_args(SofaRelease), release)
    check_known("unit system", SCALES, units)
    check_known("law", get_args(SofaLaw), law)
    folder = Path(directory)
    loaded, project = formats.linear_result(result, folder, force=force)
    model = project.model
    check_robot(model)
    sofa_law = law_for_sofa(model.law, model.mesh, choice=law, rotation=rotation)
    assert project.space is not None  # it has been calibrated
    of_plugin = isinstance(getattr(sofa_law, "elasticity", None), PluginElasticity)
    if of_plugin and "mu_l" in project.space.field_names:
        raise ValueError(
            "mu_l is a parameter, but the plugin Anisotropy takes the shear modulus "
            "along the fibre from E_t; calibrate without it, and export that."
        )
    model = model_for_law(model, sofa_law)
    # Refused before the work is done.
    component_of(model.law, model.n_tets, release, SCALES[units])
    refit = formats.recalibrate(loaded, project, model, "SOFA", watch)
    refitted = refit.result
    scene = scene_data(
        project.name, refitted.model, refit.poses, release=release, units=units
    )
    notes = [*refit.notes]
    others = [f"{e.name} ({c.name})" for c in refitted.configurations for e in c.others]
    if others:
        notes.append(
            "Only points are followed; lengths, volumes and forces are not: "
            f"{', '.join(others)}."
        )
    if of_plugin:
        notes.append(
            "The plugin Anisotropy takes the shear modulus along the fibre from E_t, "
            "and its C13 is not that of the textbook: the values make up for both, and "
            "are no material constants."
        )
    tets = model.mesh.tets
    write_scene(folder, scene, tets, text=refit.lines, notes=notes, force=force)
    lines = *refit.lines, *([""] if notes else []), *notes
    return SofaExport(scene["elasticity"]["component"], refitted, lines)
