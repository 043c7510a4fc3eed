"""Models of MuJoCo: a calibrated robot, calibrated again for MuJoCo's flex.

Written as XML (MJCF): body, actuators, loads, and a keyframe per configuration.
"""

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal
from xml.etree.ElementTree import Comment, Element, SubElement, indent, tostring

import jax.numpy as jnp
import numpy as np

from softcal_jax._module import Module
from softcal_jax._typing import Bool, Float, HostArray
from softcal_jax.actuators import Cable, ForceActuator, SurfaceForceActuator
from softcal_jax.calibration import CalibrationResult, Watch
from softcal_jax.equilibrium import Model, model_for_law
from softcal_jax.exchange import _formats as formats
from softcal_jax.exchange._formats import ExportedPose
from softcal_jax.materials import AbstractLaw, StVenantKirchhoff
from softcal_jax.results import LoadedResult, file_stems, results_folder, write_json

OPTION = {"timestep": 0.002, "integrator": "discrete", "solver": "Newton"}
"""With the one integrator that is implicit in the stiffness of a flex."""

DAMPING = 0.02
"""Damping over stiffness of a flex, so that bodies come to rest within seconds [s]."""

TIE = 10.0
"""Stiffness between a guide and its place in the body, over E times the size of a tet.

Stiffer ones slow the iterative solver of MuJoCo down, and ties by its equality
constraints let the body explode (tried with MuJoCo 4.0).
"""

GUIDE_MASS = 0.05
"""Mass of a guide over the mean mass of a node, so that it hardly adds to it [-]."""


class MujocoExport(Module):
    """What was written for MuJoCo.

    Attributes:
        files: The file of each configuration, which is a keyframe there.
        result: Calibration of the model of MuJoCo, whose values the files have.
        lines: Values and predictions of both models, and notes.
    """

    files: dict[str, str]
    result: CalibrationResult
    lines: tuple[str, ...]


def export_mujoco(
    result: LoadedResult | str | os.PathLike[str],
    directory: str | os.PathLike[str],
    *,
    force: bool = False,
    watch: Watch | Literal[False] | None = None,
) -> MujocoExport:
    """Write a calibrated robot as a model of MuJoCo, calibrated again for it.

    MuJoCo's flex has linear tets, which are too stiff, with the St. Venant-Kirchhoff
    law. The model is therefore fitted once more to the same measurements with both, and
    its values are written. In SI.

    The folder holds `robot.xml` with a keyframe per configuration, its controls and
    equilibrium; or a file per configuration if their gravity or supports differ.

    Args:
        result: The results folder, its `result.json`, or what `load_result` returned.
        directory: The folder; it must be new or empty, or hold an earlier model.
        force: Replace an earlier model; files that a user added stay.
        watch: Called with what the calibration does, see `calibrate`.

    Raises:
        ResultError: If the result cannot be loaded, see `load_result`.
        FileExistsError: If the folder is not empty, and `force` is off or it holds
            something else.
        NotConvergedError: If the calibration for MuJoCo does not converge. Nothing is
            written then.
        RuntimeError: If no configuration has an equilibrium with MuJoCo's law.
        ValueError: If the law, the robot or a support has no counterpart in MuJoCo; the
            text says why, and what to do.
    """
    folder = Path(directory)
    loaded, project = formats.linear_result(result, folder, force=force)
    model = model_for_law(project.model, law_for_mujoco(project.model.law))
    assert project.space is not None  # it has been calibrated
    check_robot(model)  # refused before the work
    asked = project.space, loaded.z, project.configurations
    check_poses(formats.exported_poses(model, *asked))
    refit = formats.recalibrate(loaded, project, model, "MuJoCo", watch)
    refitted, poses = refit.result, refit.poses
    check_poses(poses)
    lines = [*refit.lines, "", *refit.notes]
    lines.append(
        "Damping and time step only bring the body to rest: neither was calibrated, "
        "and motions take another time."
    )
    alike = len({_surroundings(pose) for pose in poses}) == 1
    stems = ["robot"] * len(poses) if alike else file_stems([p.name for p in poses])
    files = {pose.name: f"{stem}.xml" for pose, stem in zip(poses, stems, strict=True)}
    with results_folder(folder, force=force) as partial:
        for file in sorted({*files.values()}):
            within = [pose for pose in poses if files[pose.name] == file]
            text = mjcf(project.name, refitted.model, within, lines)
            (partial / file).write_text(text, encoding="utf-8")
        index = {"format": "softcal_jax.mujoco/1", "configurations": files}
        write_json(partial / "robot.json", index)
    return MujocoExport(files, refitted, tuple(lines))


def _surroundings(pose: ExportedPose) -> bytes:
    """Return what the poses of one file have in common: supports and gravity."""
    lane = pose.lane
    parts = lane.fixed, lane.springs.coefficients(), lane.acceleration
    return b"".join(np.asarray(part).tobytes() for part in parts)


def law_for_mujoco(law: AbstractLaw) -> StVenantKirchhoff:
    """Return the law that a flex computes in place of another with E and nu.

    A ValueError says what to do if the law has other constants.
    """
    hooke = formats.hooke_of(law)
    if hooke is not None:
        return StVenantKirchhoff(hooke)
    raise ValueError(
        f"{formats.law_name(law)} has no counterpart in MuJoCo, whose flex has one law,"
        " with E and nu: calibrate an isotropic StVenantKirchhoff law or a NeoHookean "
        "one, and export that."
    )


def check_robot(model: Model) -> None:
    """Raise ValueError unless MuJoCo can hold a body and what is attached to it."""
    formats.check_no_bodies(model, "a model of MuJoCo")
    known = Cable, ForceActuator, SurfaceForceActuator
    holds = "cables without friction and forces of fixed direction"
    formats.check_actuators(model, known, f"MuJoCo; its models hold {holds}")
    if np.any(formats.vertex_masses(model) <= 0.0):
        raise ValueError(
            "parts of the body have no mass, and MuJoCo moves masses: give `density` "
            "in [material]."
        )


def check_poses(poses: Sequence[ExportedPose]) -> None:
    """Raise ValueError unless MuJoCo can hold supports and actuation of poses."""
    for name, lane, *_ in poses:
        if np.any(lane.imposed) or np.any(lane.springs.rest):
            raise ValueError(
                f"configuration {name!r}: a support that is moved is not written to "
                "MuJoCo, whose flex is at rest where it is built. Leave its "
                "displacement out."
            )
        moved = np.flatnonzero(lane.actuation.by_displacement)
        if moved.size:
            raise ValueError(
                f"configuration {name!r}: the displacement of the actuator "
                f"{lane.actuation.names[moved[0]]!r} is imposed, and controls of the "
                "model of MuJoCo are forces. Impose the force that the equilibrium "
                "has (robot.csv)."
            )


def mjcf(
    name: str, model: Model, poses: Sequence[ExportedPose], remarks: Sequence[str]
) -> str:
    """Write a linear model, and poses of the same supports and gravity, as MJCF.

    Each pose is a keyframe of its name: the controls, and the equilibrium. A cable is a
    tendon through its guides; one that is no node is a light point on stiff springs to
    where its nodes carry it. Other forces, and the loads of each pose, act through sums
    of displacements, so that they are those of the model exactly.
    """
    lane, root = poses[0].lane, Element("mujoco", model=name)
    root.append(Comment("\n".join(["", *remarks, ""]).replace("--", "- -")))
    _add(root, "option", gravity=lane.acceleration, **OPTION)
    for section in ("worldbody", "deformable", "tendon", "actuator", "keyframe"):
        _add(root, section)
    fixed = np.asarray(lane.fixed)
    _add_body(root, model, fixed, np.asarray(lane.springs.coefficients()))
    guides: list[Float[HostArray, "n_nodes 3"]] = []
    actuators = model.mechanism.actuators
    rows = np.asarray(actuators.rows(jnp.asarray(model.mechanism.points)))
    motors = [owner for owner, row in enumerate(rows) if np.any(row[~fixed])]
    for owner in motors:
        if actuators.kinds[owner] == Cable.kind:
            guides += _add_cable(root, model, fixed, owner)
        else:
            row = np.where(fixed, 0.0, rows[owner])
            _add_sum(root, actuators.names[owner], row)
            _add_motor(root, actuators.names[owner])
    loads = {pose.name: np.where(fixed, 0.0, pose.lane.dead_loads) for pose in poses}
    loads = {loaded: force for loaded, force in loads.items() if force.any()}
    for loaded, force in loads.items():
        _add_sum(root, f"loads of {loaded}", force)
        _add_motor(root, f"loads of {loaded}")
    for pose in poses:
        u = np.asarray(pose.displacement)
        q = [*u[~fixed], *(np.sum(row * u) for row in guides)]
        forces = np.asarray(pose.lane.actuation.forces)[motors]
        control = [*forces, *(float(loaded == pose.name) for loaded in loads)]
        _add(root.find("keyframe"), "key", name=pose.name, qpos=q, ctrl=control)
    indent(root)
    return tostring(root, encoding="unicode") + "\n"


def _add(parent: Element | None, tag: str, **attributes: Any) -> Element:
    """Add an element; numbers and arrays are written in full precision."""
    assert parent is not None
    element = SubElement(parent, tag)
    for name, value in attributes.items():
        if not isinstance(value, str):
            value = " ".join(map(repr, np.asarray(value).ravel().tolist()))
        element.set(name, value)
    return element


def _add_body(
    root: Element,
    model: Model,
    fixed: Bool[HostArray, "n_nodes 3"],
    stiffness: Float[HostArray, "n_nodes 3"],
) -> None:
    """Add the nodes as point masses on slide joints, and the flexes between them.

    `stiffness` is that of elastic supports along the axes [N/m]. A node that is held in
    all directions is a point of the world. Tets of equal constants share a flex.
    """
    points, held = model.mesh.points, np.asarray(fixed.all(axis=1))
    for i, mass in enumerate(formats.vertex_masses(model)):
        if not held[i]:
            springs = {axis: stiffness[i, axis] for axis in np.flatnonzero(~fixed[i])}
            _add_point(root, f"node{i}", points[i], mass, springs)
    distinct, of_tet = np.unique(_constants(model), axis=1, return_inverse=True)
    for k in range(distinct.shape[1]):
        E, nu = distinct[:, k]
        tets = model.mesh.tets[of_tet.ravel() == k]
        nodes, vertices = np.unique(tets, return_inverse=True)
        flex = _add(
            root.find("deformable"),
            "flex",
            name=f"tets{k}",
            dim=3,
            radius=0,
            body=" ".join("world" if held[i] else f"node{i}" for i in nodes),
            vertex=np.where(held[nodes, None], points[nodes], 0.0),
            element=vertices,
        )
        _add(flex, "elasticity", young=E, poisson=nu, damping=DAMPING)
        _add(flex, "contact", contype=0, conaffinity=0, selfcollide="none")


def _add_point(
    root: Element,
    name: str,
    at: Float[HostArray, "3"],
    mass: float,
    springs: dict[Any, float],
    **more: Any,
) -> Element:
    """Add a point mass that slides along axes; its inertia must be, but has no part."""
    body = _add(root.find("worldbody"), "body", name=name, pos=at, **more)
    _add(body, "inertial", mass=mass, pos=np.zeros(3), diaginertia=np.full(3, 1e-9))
    for axis, stiffness in springs.items():
        spring = {"stiffness": stiffness} if stiffness else {}
        joint = {"name": f"{name}.{axis}", "axis": np.eye(3)[axis]}
        _add(body, "joint", type="slide", **joint, **spring)
    return body


def _add_sum(
    root: Element, name: str, row: Float[HostArray, "n_nodes 3"], **more: float
) -> Element:
    """Add a tendon whose length is a sum of displacements of nodes by weights."""
    tendon = _add(root.find("tendon"), "fixed", name=name, **more)
    for node, axis in np.argwhere(row):
        _add(tendon, "joint", joint=f"node{node}.{axis}", coef=row[node, axis])
    return tendon


def _add_motor(root: Element, tendon: str, gear: float = 1.0) -> None:
    _add(root.find("actuator"), "motor", name=tendon, tendon=tendon, gear=gear)


def _constants(model: Model) -> Float[HostArray, "2 n_tets"]:
    """Return E [Pa] and nu [-] of each tet."""
    assert isinstance(model.law, StVenantKirchhoff)
    C: Any = model.law.elasticity
    return np.stack([np.broadcast_to(c, model.n_tets) for c in (C.E, C.nu)])


def _add_cable(
    root: Element, model: Model, fixed: Bool[HostArray, "n_nodes 3"], owner: int
) -> list[Float[HostArray, "n_nodes 3"]]:
    """Add a cable; return the displacements of guides that are no nodes, as sums."""
    cable, sums = model.mechanism.actuators.names[owner], []
    world = root.find("worldbody")
    path = _add(root.find("tendon"), "spatial", name=cable)
    assert world is not None
    mass = GUIDE_MASS * model.mass / model.mesh.n_nodes
    size = np.cbrt(model.node_volumes.sum() / model.n_tets)
    stiffness = TIE * _constants(model)[0].mean() * size
    for k, (point, weights) in enumerate(formats.cable_guides(model, owner)):
        name, nodes = f"{cable}, guide {k}", np.flatnonzero(weights)
        if fixed[nodes].all():  # on the ground, or held
            _add(world, "site", name=name, pos=point, size=0.001)
        elif nodes.size == 1:
            node = world.find(f"body[@name='node{nodes[0]}']")
            _add(node, "site", name=name, size=0.001)
        else:
            axes = np.flatnonzero(~fixed[nodes].all(axis=0))
            free = dict.fromkeys(axes, 0.0)
            body = _add_point(root, name, point, mass, free, gravcomp=1.0)
            _add(body, "site", name=name, size=0.001)
            for axis in axes:
                row = weights[:, None] * ~fixed * (np.arange(3) == axis)
                tie = {"stiffness": stiffness, "springlength": 0.0}
                tendon = _add_sum(root, f"{name}.{axis}", row, **tie)
                _add(tendon, "joint", joint=f"{name}.{axis}", coef=-1.0)
                sums.append(row)
        _add(path, "site", site=name)
    _add_motor(root, cable, gear=-1.0)  # a tension shortens it
    return sums
