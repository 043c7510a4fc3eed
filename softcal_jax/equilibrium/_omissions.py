"""What a model leaves out: the weight of a body, and that forces act on an area.

A force at a point of the mesh digs a dent, which is unbounded in the exact solution:
how deep it is on a mesh depends on the size of the tets.
"""

from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence

import jax
import numpy as np

from softcal_jax._typing import Float, HostArray, Int
from softcal_jax.actuators import AbstractGuided, ActuatorArrays, WeightedNodes
from softcal_jax.bodies import KINDS
from softcal_jax.configurations import (
    ActuatorDisplacement,
    Configuration,
    ConfigurationArrays,
    EffectorRecord,
    PointForce,
)
from softcal_jax.equilibrium._model import Model
from softcal_jax.mesh import TetMesh

DENT = 0.1  # share of a displacement from which a dent in it is named [-]

_NOTHING = 1e-12  # displacement that counts as none [m]

Omission = tuple[str, float]
"""A sentence, and the share of a displacement with which it begins, or 0 [-]."""


def omission_sentences(omissions: Iterable[Omission]) -> tuple[str, ...]:
    """Return each sentence once, with the largest share of all configurations."""
    largest = dict(sorted(omissions, key=lambda omission: omission[1]))
    part = lambda share: f"Up to {100 * share:.0f} %" if share < np.inf else "A part"
    begin = lambda share: f"{part(share)} " if share else ""
    return tuple(begin(share) + text for text, share in largest.items())


def omissions(
    model: Model,
    configuration: Configuration,
    lane: ConfigurationArrays,
    u: Float[HostArray, "n_points 3"] | None = None,
    records: Sequence[EffectorRecord] = (),
) -> Iterator[Omission]:
    """List what a configuration leaves out; `lane` are its arrays, on the host.

    Dents count in displacements of actuators that are imposed or read, and at markers
    among `records`. They are estimated at the equilibrium `u` [m]; before a solve, they
    are named where such an actuator ends.
    """
    for name in _unweighed(model, lane):
        yield (
            f"No mass is stated for the rigid body {name!r}, on which gravity acts: "
            "weigh it (mass; 0 if it has none).",
            0.0,
        )
    mesh, actuators = model.mesh, model.mechanism.actuators
    bare = np.logical_not(np.any(lane.fixed, axis=1))
    bare[model.mechanism.bodies.attached], bare[mesh.n_nodes :] = False, False
    readings = [e for e in configuration.effectors if type(e) is ActuatorDisplacement]
    read, by = [e.actuator for e in readings], lane.actuation.by_displacement
    under, counts = [], {}
    for a, points in _points(actuators).items():
        matters = by[a] or actuators.names[a] in read
        some = points if matters and u is not None else (points[0], points[-1])
        under += (dented := [nodes for nodes in some if any(bare[nodes])])
        if dented and matters:
            counts[a] = f"{actuators.kinds[a].noun} {actuators.names[a]!r}"
    shares = dict.fromkeys(counts.values(), np.inf)
    if u is not None:
        loads = [f for f in configuration.loads if type(f) is PointForce]
        forces = [np.flatnonzero(f.nodal_forces(mesh).any(axis=1)) for f in loads]
        dent = _dent(mesh, u, [*under, *(at for at in forces if any(bare[at]))])
        if counts:
            both = map(model.displacements, jax.device_put((u, u - dent)))
            all_of, rest_of = map(np.asarray, both)
            part = np.abs(all_of - rest_of) / np.maximum(np.abs(all_of), _NOTHING)
            shares = {label: float(part[a]) for a, label in counts.items()}
        for e in records:
            if e.quantity == "point" and e.seen.any():
                at, w = lane.effectors.nodes[e.index], lane.effectors.weights[e.index]
                part, moved = (np.linalg.norm(w @ v[at]) for v in (dent, u))
                shares[f"marker {e.name!r}"] = float(part / max(moved, _NOTHING))
    for what, share in shares.items():
        if share > DENT:
            yield (
                f"of what {what} moves is the dent of a force at a point of bare "
                "tets, which depends on their size: let it act on a plate, a rigid "
                "body ([bodies] in a project file), or on a surface.",
                share,
            )


def _points(actuators: ActuatorArrays) -> dict[int, list[Int[HostArray, " n"]]]:
    """Return the nodes that carry the points of each cable and force actuator."""
    points = defaultdict(list)
    for group in actuators.groups:
        weights = np.zeros((0, 0, 0))
        if isinstance(group, AbstractGuided):
            weights = np.asarray(group.weights)
        elif isinstance(group, WeightedNodes) and not group.by_area:
            weights = np.linalg.norm(group.weights, axis=2)[:, None]
        nodes, owner = np.asarray(group.nodes), np.asarray(group.owner).tolist()
        for a, at, rows in zip(owner, nodes, weights, strict=False):
            points[a] += [at[np.abs(w) > 1e-9] for w in rows]
    return points


def _dent(
    mesh: TetMesh, u: Float[HostArray, "n_points 3"], under: Sequence[HostArray]
) -> Float[HostArray, "n_points 3"]:
    """Compute how far nodes under a force move beyond the body around them [m].

    That moves by the quadratic map of the second layer of nodes. Pulled with a plate at
    its end and without, beams show 1.0 to 1.6 times such a dent.
    """
    dent = np.zeros_like(u)
    around = lambda some: np.unique(mesh.tets[np.isin(mesh.tets, some).any(axis=1)])
    for nodes in under:
        near = around(nodes)
        ring = np.setdiff1d(around(near), near)
        X = (mesh.points - mesh.points[nodes[0]]) / mesh.size
        squares = X[:, [0, 1, 2, 0, 1, 2]] * X[:, [0, 1, 2, 1, 2, 0]]
        terms = np.column_stack([np.ones(len(X)), X, squares])
        fit, _, rank, _ = np.linalg.lstsq(terms[ring], u[ring], rcond=None)
        if rank == terms.shape[1]:  # else the mesh is too coarse to say
            dent[nodes] = u[nodes] - terms[nodes] @ fit
    return dent


def _unweighed(model: Model, lane: ConfigurationArrays) -> Iterator[str]:
    """Name bodies that gravity can move, without tets of their own or a stated mass."""
    bodies, motors = model.mechanism.bodies, model.mechanism.actuators.motor_body
    body_of = np.full(model.mesh.n_nodes, -1)
    body_of[bodies.attached] = bodies.body
    of = body_of[model.mesh.tets]
    rigid = (of == of[:, :1]).all(axis=1) & (of[:, 0] >= 0)
    known = np.array(bodies.is_weighed, bool)
    known[of[rigid & (np.asarray(model.density) > 0.0), 0]] = True
    known[bodies.owner[known]] = True
    known |= np.isin(lane.bodies.kind, [KINDS.index(k) for k in ("held", "absent")])
    turned = zip(motors, lane.actuation.by_displacement, strict=True)
    known[[body for body, turns in turned if turns and body >= 0]] = True
    known |= (bodies.owner != np.arange(bodies.n_bodies)) | ~np.any(lane.gravity)
    yield from (name for name, k in zip(bodies.names, known, strict=True) if not k)
