"""The law of MuJoCo's flex, and a body of tets as flexes between point masses."""

from typing import Any
from xml.etree.ElementTree import Element, SubElement

import numpy as np

from softcal_jax._typing import Bool, Float, HostArray
from softcal_jax.equilibrium import Model
from softcal_jax.exchange._recalibrated import vertex_masses
from softcal_jax.materials import (
    AbstractLaw,
    ClassicalCorotational,
    Corotational,
    Isotropic,
    NeoHookean,
    StVenantKirchhoff,
)

DAMPING = 0.02
"""Damping over stiffness of a flex, so that bodies come to rest within seconds [s]."""


def law_for_mujoco(law: AbstractLaw) -> StVenantKirchhoff:
    """Return the law that a flex computes in place of another with E and nu.

    Raises:
        ValueError: If the law has other constants; the text says what to do.
    """
    linear = StVenantKirchhoff, Corotational, ClassicalCorotational
    constants = law.elasticity if isinstance(law, linear) else law
    if isinstance(constants, NeoHookean | Isotropic):
        return StVenantKirchhoff(Isotropic(constants.E, constants.nu))
    name = type(law).__name__
    if constants is not law:
        name += f" with {type(constants).__name__}"
    raise ValueError(
        f"{name} has no counterpart in MuJoCo, whose flex has one law, with E and nu: "
        "calibrate an isotropic StVenantKirchhoff law or a NeoHookean one, and export "
        "that."
    )


def constants_of_flex(
    model: Model,
) -> tuple[Float[HostArray, " n_tets"], Float[HostArray, " n_tets"]]:
    """Return E [Pa] and nu [-] of each tet."""
    law = law_for_mujoco(model.law).elasticity
    assert isinstance(law, Isotropic)
    each = lambda value: np.broadcast_to(np.asarray(value), model.n_tets)
    return each(law.E), each(law.nu)


def add(parent: Element, tag: str, **attributes: Any) -> Element:
    """Add an element; numbers and arrays are written in full precision."""
    element = SubElement(parent, tag)
    for name, value in attributes.items():
        if not isinstance(value, str):
            value = " ".join(map(repr, np.asarray(value).ravel().tolist()))
        element.set(name, value)
    return element


def add_body(
    root: Element,
    model: Model,
    *,
    fixed: Bool[HostArray, "n_nodes 3"],
    stiffness: Float[HostArray, "n_nodes 3"],
) -> list[Element]:
    """Add the nodes as point masses on slide joints, and flexes between them.

    `stiffness` is that of elastic supports along the axes [N/m]. A node that is held in
    all directions is a point of the world.

    Returns:
        The body of each node.
    """
    world, points = add(root, "worldbody"), model.mesh.points
    bodies = []
    for i, mass in enumerate(vertex_masses(model)):
        body = world
        if not fixed[i].all():
            body = add_point(world, f"node{i}", points[i], mass)
        bodies.append(body)
        for axis in np.flatnonzero(~fixed[i]).tolist():
            add_slide(body, axis, stiffness=stiffness[i, axis])
    constants = np.stack(constants_of_flex(model))
    distinct, of_tet = np.unique(constants, axis=1, return_inverse=True)
    deformable = add(root, "deformable")
    for k in range(distinct.shape[1]):
        E, nu = distinct[:, k]
        tets = model.mesh.tets[of_tet.ravel() == k]
        nodes, vertices = np.unique(tets, return_inverse=True)
        flex = add(
            deformable,
            "flex",
            name=f"tets{k}",
            dim=3,
            radius=0,
            body=" ".join(bodies[i].get("name", "world") for i in nodes),
            vertex=np.where(fixed[nodes].all(axis=1, keepdims=True), points[nodes], 0),
            element=vertices,
        )
        add(flex, "elasticity", young=E, poisson=nu, damping=DAMPING)
        add(flex, "contact", contype=0, conaffinity=0, selfcollide="none")
    return bodies


def add_point(
    world: Element, name: str, at: Float[HostArray, "3"], mass: float, **more: Any
) -> Element:
    """Add a point mass at a place [m]; its inertia plays no part, but must be there."""
    body = add(world, "body", name=name, pos=at, **more)
    add(body, "inertial", mass=mass, pos=np.zeros(3), diaginertia=np.full(3, 1e-9))
    return body


def add_slide(body: Element, axis: int, **more: Any) -> str:
    """Let a point slide along an axis, and return the name of this joint."""
    name = joint_name(body, axis)
    add(body, "joint", name=name, type="slide", axis=np.eye(3)[axis], **more)
    return name


def joint_name(body: Element, axis: int) -> str:
    """Return the name of the joint of a point along an axis."""
    return f"{body.get('name')}.{'xyz'[axis]}"
