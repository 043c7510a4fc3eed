"""One posed robot: how it is held and loaded, and what was measured on it."""

from collections.abc import Iterable, Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike

from softcal_jax._typing import Float, HostArray
from softcal_jax.bodies import KINDS, BodyStateArrays
from softcal_jax.configurations._actuation import (
    Actuation,
    BodyStates,
    actuation_arrays,
    body_state_arrays,
)
from softcal_jax.configurations._arrays import ConfigurationArrays, EffectorArrays
from softcal_jax.configurations._carriers import carriers
from softcal_jax.configurations._loads import AbstractLoad
from softcal_jax.configurations._markers import Markers
from softcal_jax.configurations._mechanism import Mechanism, build_mechanism
from softcal_jax.configurations._supports import Support
from softcal_jax.mesh import TetMesh

STANDARD_GRAVITY = 9.80665
"""Standard acceleration of gravity [m/s2]."""


def _as_supports(
    supports: str | Support | Iterable[str | Support],
) -> tuple[Support, ...]:
    several = [supports] if isinstance(supports, str | Support) else supports
    return tuple(Support(s) if isinstance(s, str) else s for s in several)


def _as_loads(loads: AbstractLoad | Iterable[AbstractLoad]) -> tuple[AbstractLoad, ...]:
    return (loads,) if isinstance(loads, AbstractLoad) else tuple(loads)


def _as_measured(
    measured: Float[ArrayLike, "..."] | Sequence | None,
) -> Float[HostArray, "..."] | None:
    return None if measured is None else np.asarray(measured, float)


class Configuration(eqx.Module):
    """A static pose of the robot.

    Attributes:
        name: Name in results, tables and pictures.
        supports: How the body is held: one or several; the name of a group clamps it.
        gravity: Acceleration of gravity, in the frame of the mesh [m/s2].
        loads: Dead loads, one or several.
        markers: Points that are measured or followed; may be left out.
        measured: Measured marker positions in the frame of the mesh [m].
        bodies: What rigid bodies do, by name: a `Pose` where they are held, "held",
            "hinged", or a `BodyState`; the others are free.
        actuation: What is asked of actuators, by name: `ImposedForce` or
            `ImposedDisplacement`. Of the others nothing: no force; a motor at zero.
    """

    name: str
    supports: tuple[Support, ...] = eqx.field(converter=_as_supports, default=())
    gravity: tuple[float, float, float] = (0.0, 0.0, -STANDARD_GRAVITY)
    loads: tuple[AbstractLoad, ...] = eqx.field(converter=_as_loads, default=())
    markers: Markers | None = None
    measured: Float[HostArray, "n_markers 3"] | None = eqx.field(
        converter=_as_measured, default=None
    )
    bodies: BodyStates = eqx.field(default_factory=dict)
    actuation: Actuation = eqx.field(default_factory=dict)

    def __check_init__(self):
        gravity = np.asarray(self.gravity, float)
        if gravity.shape != (3,) or not np.all(np.isfinite(gravity)):
            raise ValueError(
                f"gravity of configuration {self.name!r} must be three finite numbers "
                f"[m/s2], got {self.gravity!r}."
            )
        if self.measured is not None:
            if self.markers is None:
                raise ValueError(
                    f"configuration {self.name!r} has measured positions but no "
                    "markers."
                )
            self.markers.check_measured(self.measured, self.name)


def configuration_arrays(
    mesh: TetMesh,
    configurations: Sequence[Configuration],
    mechanism: Mechanism | None = None,
) -> ConfigurationArrays:
    """Stack configurations of one mesh into the batch that is solved at once.

    Args:
        mesh: The mesh that all of them share.
        configurations: At least one; they may differ in everything but the mesh.
        mechanism: Rigid bodies and actuators of the model; none by default.

    Returns:
        Arrays with a leading axis, one lane per configuration.

    Raises:
        ValueError: If there is none, names repeat, nothing is held, a group, body or
            actuator is unknown, a body has held nodes, or a marker stands too far from
            the mesh.
    """
    if not configurations:
        raise ValueError("at least one configuration is needed, got none.")
    mechanism = build_mechanism(mesh) if mechanism is None else mechanism
    names = [configuration.name for configuration in configurations]
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"configuration {name!r} is named more than once.")
    carried = [_carriers(mesh, c) for c in configurations]
    most = max(len(markers) for markers in carried)
    widest = max((len(n) for markers in carried for n, _ in markers), default=0)
    lanes = [
        _lane(mesh, mechanism, c, _effectors(c, markers, (most, widest)))
        for c, markers in zip(configurations, carried, strict=True)
    ]
    return jax.tree.map(lambda *leaves: jnp.asarray(np.stack(leaves)), *lanes)


def _lane(
    mesh: TetMesh, mechanism: Mechanism, c: Configuration, effectors: EffectorArrays
) -> ConfigurationArrays:
    fixed = np.zeros((mesh.n_nodes, 3), bool)
    imposed = np.zeros((mesh.n_nodes, 3))
    for support in c.supports:
        support.apply(mesh, fixed, imposed)
    _check_apart(mesh, mechanism, fixed, c.name)
    bodies = body_state_arrays(mechanism, c.bodies, c.name)
    actuation = actuation_arrays(mechanism, c.actuation, c.name)
    _check_held(mesh, mechanism, fixed, bodies, c.name)
    force = np.zeros((mesh.n_nodes, 3))
    for load in c.loads:
        force += load.nodal_forces(mesh)
    # Nodes of the bodies' frames come after those of the mesh.
    more = len(mechanism.points) - mesh.n_nodes
    all_nodes = lambda a: np.concatenate([a, np.zeros((more, 3), a.dtype)])
    return ConfigurationArrays(
        all_nodes(fixed),
        all_nodes(imposed),
        all_nodes(force),
        np.asarray(c.gravity, float),
        bodies,
        actuation,
        effectors,
    )


def _check_apart(mesh: TetMesh, mechanism: Mechanism, fixed, name: str) -> None:
    """Raise if a node is both held by a support and part of a rigid body."""
    bodies = mechanism.bodies
    both = np.flatnonzero(fixed[bodies.attached].any(axis=1))
    if both.size:
        node = bodies.attached[both[0]]
        body = bodies.names[bodies.body[both[0]]]
        raise ValueError(
            f"configuration {name!r}: its supports hold {both.size} nodes of rigid "
            f"bodies, such as node {node} of {body!r} at "
            f"{mesh.points[node].tolist()} m. Hold the body instead, with bodies="
            f'{{{body!r}: "held"}}, or keep the groups apart.'
        )


def _carriers(mesh: TetMesh, c: Configuration):
    """Nodes and weights of each marker; the error names the configuration."""
    if c.markers is None:
        return []
    try:
        return carriers(mesh, c.markers)
    except ValueError as error:
        raise ValueError(
            f"markers {', '.join(c.markers.names)} of configuration {c.name!r}: {error}"
        ) from error


def _effectors(c: Configuration, carried: list, shape: tuple[int, int]):
    """Effector arrays, padded to a number of markers and of nodes per marker."""
    n_markers, n_nodes = shape
    out = EffectorArrays(
        np.zeros((n_markers, n_nodes), np.int32),
        np.zeros((n_markers, n_nodes)),
        np.zeros((n_markers, 3)),
        np.zeros((n_markers, 3)),
    )
    for i, (nodes, weights) in enumerate(carried):
        out.nodes[i, : len(nodes)], out.weights[i, : len(nodes)] = nodes, weights
    if c.markers is not None and c.measured is not None:
        n = len(carried)
        out.measured[:n] = np.nan_to_num(c.measured)
        out.inverse_std[:n] = c.markers.inverse_std()
    return out


def _check_held(
    mesh: TetMesh, mechanism: Mechanism, fixed, states: BodyStateArrays, name: str
) -> None:
    """Raise unless the held coordinates block all six rigid motions."""
    bodies, centre = mechanism.bodies, mesh.points.mean(axis=0)
    size = np.abs(mesh.points - centre).max()
    motions = lambda x: np.concatenate(
        [
            np.broadcast_to(np.eye(3)[:, None], (3, len(x), 3)),
            np.cross(np.eye(3)[:, None], ((x - centre) / size)[None]),
        ]
    )
    kind = np.asarray(states.kind).copy()
    motors = mechanism.actuators.motor_body
    kind[[body for body in motors if body >= 0]] = KINDS.index("held")
    rows = [motions(mesh.points)[:, fixed]]
    for k in np.flatnonzero(kind != KINDS.index("free")):
        rows.append(motions(bodies.origin[k][None])[:, 0])
        turns = np.concatenate([np.zeros((3, 3)), bodies.axes[k].T])
        rows.append(turns if kind[k] == KINDS.index("held") else turns[:, :2])
    held = np.concatenate(rows, axis=1)
    rank = np.linalg.matrix_rank(held @ held.T) if held.size else 0
    if rank < 6:
        nodes = int(fixed.any(axis=1).sum())
        raise ValueError(
            f"configuration {name!r} is not held: its supports ({nodes} nodes) leave "
            f"{6 - rank} of the 6 rigid motions free. Clamp a surface, add supports, "
            "or hold a rigid body."
        )
