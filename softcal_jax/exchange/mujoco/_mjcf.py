"""A model of MuJoCo as XML (MJCF): body, actuators, loads, and a keyframe per pose."""

from collections.abc import Sequence
from typing import NamedTuple
from xml.etree.ElementTree import Comment, Element, indent, tostring

import jax.numpy as jnp
import numpy as np

from softcal_jax._typing import Bool, Float, HostArray, Int
from softcal_jax.actuators import Cable, CableSegments, actuator_rows
from softcal_jax.configurations import ConfigurationArrays
from softcal_jax.equilibrium import Model
from softcal_jax.exchange.mujoco._flex import (
    add,
    add_body,
    add_point,
    add_slide,
    constants_of_flex,
    joint_name,
)

OPTION = {"timestep": 0.002, "integrator": "discrete", "solver": "Newton"}
"""With the one integrator that is implicit in the stiffness of a flex."""

TIE = 10.0
"""Stiffness between a guide and its place in the body, over E times the size of a tet.

Stiffer ones slow the iterative solver of MuJoCo down, and ties by its equality
constraints let the body explode (tried with MuJoCo 4.0).
"""

GUIDE_MASS = 0.05
"""Mass of a guide over the mean mass of a node, so that it hardly adds to it [-]."""

_ON_NODE = 1e-9
"""Weight of a node below which a guide does not depend on it [-]."""


class Pose(NamedTuple):
    """A configuration by its name and arrays, and its displacements [m]."""

    name: str
    lane: ConfigurationArrays
    displacement: Float[HostArray, "n_nodes 3"]


class _Robot(NamedTuple):
    """A model of MuJoCo while it is written.

    Attributes:
        root: The whole model.
        bodies: The body of each node.
        points: The nodes at rest [m].
        fixed: Which of their coordinates are held.
        guide_mass: Mass of the guides that are no nodes [kg].
        tie: Stiffness that ties them to nodes [N/m].
        tied: Rows of the displacements of their joints, by nodes.
    """

    root: Element
    bodies: list[Element]
    points: Float[HostArray, "n_nodes 3"]
    fixed: Bool[HostArray, "n_nodes 3"]
    guide_mass: float
    tie: float
    tied: list[Float[HostArray, "n_nodes 3"]]

    def section(self, name: str) -> Element:
        """Return the part of the model of some name, which is added at first use."""
        known = self.root.find(name)
        return add(self.root, name) if known is None else known

    def add_combination(
        self, name: str, coefficients: Float[HostArray, "n_nodes 3"], **more: float
    ) -> Element:
        """Add a tendon whose length is a sum of the displacements of nodes."""
        tendon = add(self.section("tendon"), "fixed", name=name, **more)
        for node, axis in np.argwhere((coefficients != 0.0) & ~self.fixed):
            joint = joint_name(self.bodies[node], axis)
            add(tendon, "joint", joint=joint, coef=coefficients[node, axis])
        return tendon

    def add_motor(self, tendon: str, gear: float = 1.0) -> None:
        """Let a control pull at a tendon."""
        section = self.section("actuator")
        add(section, "motor", name=tendon, tendon=tendon, gear=gear)


def mjcf(name: str, model: Model, poses: Sequence[Pose], remarks: Sequence[str]) -> str:
    """Write a linear model, and poses of the same supports and gravity, as MJCF.

    Each pose is a keyframe of its name: the controls, and the equilibrium. A cable is a
    tendon through its guides; one that is no node is a light point on stiff springs to
    where its nodes carry it. Other forces, and the loads of each pose, act through sums
    of displacements, so that they are those of the model exactly.
    """
    lane, root = poses[0].lane, Element("mujoco", model=name)
    root.append(Comment("\n".join(["", *remarks, ""]).replace("--", "- -")))
    add(root, "option", gravity=lane.acceleration, **OPTION)
    fixed, springs = np.asarray(lane.fixed), np.asarray(lane.springs.coefficients())
    bodies = add_body(root, model, fixed=fixed, stiffness=springs)
    mass = GUIDE_MASS * model.mass / len(bodies)
    E, _ = constants_of_flex(model)
    size = np.cbrt(model.node_volumes.sum() / model.n_tets)
    tie = TIE * float(E.mean() * size)
    robot = _Robot(root, bodies, model.mesh.points, fixed, mass, tie, [])
    actuators = model.mechanism.actuators
    rows = actuator_rows(actuators, jnp.asarray(model.mechanism.points))
    every = zip(actuators.names, actuators.kinds, np.asarray(rows), strict=True)
    for owner, (actuator, kind, row) in enumerate(every):
        if kind == Cable.kind:
            _add_cable(robot, actuator, _guides(model, owner))
        else:
            robot.add_combination(actuator, row)
            robot.add_motor(actuator)
    loads = {pose.name: np.where(fixed, 0.0, pose.lane.dead_loads) for pose in poses}
    loads = {name: load for name, load in loads.items() if load.any()}
    for loaded, load in loads.items():
        robot.add_combination(f"loads of {loaded}", load)
        robot.add_motor(f"loads of {loaded}")
    keys = robot.section("keyframe")
    for pose in poses:
        u = np.asarray(pose.displacement)
        q = [*u[~fixed], *(np.sum(row * u) for row in robot.tied)]
        forces = np.asarray(pose.lane.actuation.forces)
        control = [*forces, *(float(loaded == pose.name) for loaded in loads)]
        add(keys, "key", name=pose.name, qpos=q, ctrl=control)
    indent(root)
    return tostring(root, encoding="unicode") + "\n"


class _Guide(NamedTuple):
    """A point that a cable runs through: nodes, weights, and its place at rest [m]."""

    nodes: Int[HostArray, " m"]
    weights: Float[HostArray, " m"]
    point: Float[HostArray, "3"]


def _guides(model: Model, owner: int) -> list[_Guide]:
    """Return the guides of a cable in order; those on the ground have no nodes."""
    guides: list[_Guide] = []
    groups = model.mechanism.actuators.groups
    (cable,) = (g for g in groups if isinstance(g, CableSegments))
    for segment in np.flatnonzero(np.asarray(cable.owner) == owner):
        nodes = np.asarray(cable.nodes)[segment]
        both = np.asarray(cable.weights)[segment], np.asarray(cable.fixed)[segment]
        for weights, ground in zip(*both, strict=True):
            used = weights > _ON_NODE
            point = weights @ model.mesh.points[nodes] + ground
            if not guides or not np.allclose(point, guides[-1].point, rtol=1e-9):
                guides.append(_Guide(nodes[used], weights[used], point))
    return guides


def _add_cable(robot: _Robot, name: str, guides: Sequence[_Guide]) -> None:
    sites = []
    for k, guide in enumerate(guides):
        sites.append(f"{name}, guide {k}")
        carrier, at = robot.section("worldbody"), guide.point
        if robot.fixed[guide.nodes].all():
            pass  # on the ground, or held
        elif len(guide.nodes) == 1:
            carrier, at = robot.bodies[guide.nodes[0]], np.zeros(3)
        else:
            carrier, at = _tied_point(robot, sites[-1], guide), np.zeros(3)
        add(carrier, "site", name=sites[-1], pos=at, size=0.001)
    path = add(robot.section("tendon"), "spatial", name=name)
    for site in sites:
        add(path, "site", site=site)
    robot.add_motor(name, gear=-1.0)  # a tension shortens it


def _tied_point(robot: _Robot, name: str, guide: _Guide) -> Element:
    """Add a point that moves with the nodes that carry it."""
    world = robot.section("worldbody")
    body = add_point(world, name, guide.point, robot.guide_mass, gravcomp=1.0)
    for axis in np.flatnonzero(~robot.fixed[guide.nodes].all(axis=0)).tolist():
        row = np.zeros_like(robot.points)
        row[guide.nodes, axis] = guide.weights
        joint = add_slide(body, axis)
        tie = robot.add_combination(joint, row, stiffness=robot.tie, springlength=0.0)
        add(tie, "joint", joint=joint, coef=-1.0)
        robot.tied.append(row)
    return body
