"""The finite-element model of a robot, and what it leaves out.

That is the weight of a body, and that forces act on an area: a force at a point of the
mesh digs a dent, which is unbounded in the exact solution: how deep it is on a mesh
depends on the size of the tets.
"""

from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Shaped

from softcal_jax._module import Module
from softcal_jax._typing import Array, Float, HostArray, Int
from softcal_jax.actuators import AbstractGuided, ActuatorArrays, WeightedNodes
from softcal_jax.bodies import KINDS, Frames
from softcal_jax.configurations import (
    ActuatorDisplacement,
    Configuration,
    ConfigurationArrays,
    EffectorRecord,
    Mechanism,
    PointForce,
)
from softcal_jax.equilibrium._element import Formulation
from softcal_jax.equilibrium._linear_solver import AbstractLinearSolver
from softcal_jax.equilibrium._sparsity import Reduction, Sparsity
from softcal_jax.materials import AbstractLaw, fields_of_tets, with_arrays
from softcal_jax.mesh import TetMesh, volumes

Nodal = Float[Array, "n_points 3"]
"""One vector per node, those of the rigid bodies' frames included."""


class Shapes(Module):
    """Named ways in which the shape of a body may be off, or can be designed.

    Attributes:
        motion: Motion of the nodes of the mesh per metre of each offset [-].
        offset: How far each is off the shape of which the model was built; to set it
            moves no nodes, as `with_offset` does [m].
    """

    motion: Float[Array, "n_shapes n_nodes 3"]
    offset: Float[Array, " n_shapes"]
    names: tuple[str, ...] = eqx.field(static=True)


class Model(Module):
    """A mesh with its law and mechanism; its arrays are traced arguments of the solver.

    Attributes:
        law: Constitutive law; its arrays hold one value, or one per tet, except for
            arrays that all tets share, see `AbstractLaw`.
        density: Mass density, one value or one per tet [kg/m3].
        mechanism: Rigid bodies and actuators.
        active: 1 for each tet; 0 for copies that pad the last block, and for tets
            whose nodes all belong to one rigid body.
        pattern: Sparsity of the tangent over all nodes.
        curvature_at: Positions in the pattern of the actuators' tangents.
        contact_at: Positions in the pattern of the tangents of contact.
        reduction: How the tangent is reduced to the unknowns; None without bodies.
        shapes: Its shapes by name, see `build_model`.
        formulation: "displacement" or "mean-dilatation"; see `build_model`.
        moved: Whether its points are traced ones, see `with_points`.
    """

    mesh: TetMesh
    law: AbstractLaw
    density: Float[Array, "..."]
    mechanism: Mechanism
    shape_gradients: Float[Array, "n_blocks n_qp n_en 3 block"]
    weights: Float[Array, "n_blocks n_qp block"]
    active: Float[Array, "n_blocks block"]
    nodes: Int[Array, "n_blocks n_en block"]
    destination: Int[Array, "n_blocks n_entries block"]
    node_volumes: Float[Array, "n_tets n_en"]
    pattern: Sparsity
    curvature_at: tuple[Int[HostArray, "_ _"], ...]
    contact_at: tuple[Int[HostArray, "_ _"], ...]
    reduction: Reduction | None
    solver: AbstractLinearSolver
    shapes: Shapes
    formulation: Formulation = eqx.field(static=True)
    moved: bool = eqx.field(static=True, default=False)

    def _words(self) -> str:
        bodies, actuators = self.mechanism.bodies, self.mechanism.actuators
        parts = [f"rigid body {name}" for name in bodies.names]
        named = zip(actuators.kinds, actuators.names, strict=True)
        parts += [f"{kind.noun} {name}" for kind, name in named]
        return ", ".join([self.mesh.words, type(self.law).__name__, *parts])

    @property
    def n_points(self) -> int:
        """Number of nodes, those of the rigid bodies' frames included."""
        return self.mechanism.points.shape[0]

    @property
    def n_dof(self) -> int:
        """Number of unknowns: three per node, held or free, and six per rigid body."""
        return self.solver.sparsity.n_dof

    @property
    def with_multiplier(self) -> Int[HostArray, " n_m"]:
        """Indices of actuators whose force is unknown if their displacement is imposed.

        Motors are left out: an imposed angle holds the body itself.
        """
        actuators = self.mechanism.actuators
        motor = np.array(actuators.motor_body) >= 0
        return np.flatnonzero(actuators.has_displacement & ~motor)

    def among_all(self, values: Float[Array, "*b n_m"]) -> Float[Array, "*b n_a"]:
        """Expand values of the actuators `with_multiplier` to all, 0 elsewhere."""
        none = jnp.zeros((*values.shape[:-1], self.mechanism.n_actuators), values.dtype)
        return none.at[..., self.with_multiplier].set(values, unique_indices=True)

    def positions(self, u: Nodal) -> Nodal:
        """Return the positions of all nodes [m]."""
        return jnp.asarray(self.mechanism.points) + u

    def frames(self, u: Nodal) -> Frames:
        """Return the frames of the rigid bodies."""
        return self.mechanism.bodies.frames_at(self.positions(u)[self.mesh.n_nodes :])

    def displacements(self, u: Nodal) -> Float[Array, " n_a"]:
        """Return the displacements delta_a of the actuators."""
        return self.mechanism.displacements(self.positions(u))

    @property
    def n_tets(self) -> int:
        """Number of tets."""
        return self.mesh.tets.shape[0]

    @property
    def mass(self) -> float:
        """Mass of all tets and rigid bodies [kg]."""
        tets = np.asarray(self.density) * volumes(self.mesh)
        return float(np.sum(tets) + np.sum(np.asarray(self.mechanism.bodies.mass)))

    @property
    def has_energy(self) -> bool:
        """Whether all forces but friction on obstacles have a potential."""
        return self.law.conservative and self.mechanism.actuators.symmetric

    @property
    def conservative(self) -> bool:
        """Whether a potential exists, so that the tangent is symmetric.

        Without one, the solver takes the full tangent, Newton reduces the residual, and
        negative eigenvalues do not tell whether a state is stable.
        """
        return self.solver.sparsity.symmetric

    @property
    def averages_volume(self) -> bool:
        """Whether the volume ratio of points is replaced by the mean of their tet."""
        return self.formulation == "mean-dilatation" and self.weights.shape[1] > 1

    def with_law(self, law: AbstractLaw) -> "Model":
        """Return the model with another law.

        Raises:
            ValueError: If a per-tet array has the wrong length, or the law has no
                potential and the model was built for one that has.
        """
        law = with_arrays(law)
        check_fields(law, self.n_tets)
        check_law(law, self.conservative, self.formulation)
        return eqx.tree_at(lambda m: m.law, self, law)

    def tabulated(self) -> "Model":
        """Return the model with all precomputed that does not depend on deformation."""
        arrays, rest = eqx.partition(self.law.tabulated(), eqx.is_array)
        law = eqx.combine(jax.lax.optimization_barrier(arrays), rest)
        return eqx.tree_at(lambda m: m.law, self, law)

    def blocks(self, values: Shaped[Array, "..."]) -> Any:
        """Cut values of all tets into blocks, see `to_blocks`."""
        n_blocks, _, block = self.weights.shape
        return to_blocks(values, self.n_tets, n_blocks, block)


def to_blocks(
    leaf: Shaped[Array | HostArray, "..."], n_tets: int, n_blocks: int, block: int
) -> Shaped[Array | HostArray, "n_blocks block ..."]:
    """Cut per-tet values into blocks; NumPy arrays stay on the host, uncompiled."""
    xp: Any = np if isinstance(leaf, np.ndarray) else jnp
    if leaf.ndim == 0:
        return xp.broadcast_to(leaf, (n_blocks, block))
    pad = n_blocks * block - n_tets
    filled = xp.concatenate([leaf, xp.broadcast_to(leaf[:1], (pad, *leaf.shape[1:]))])
    return filled.reshape(n_blocks, block, *leaf.shape[1:])


def check_fields(law: AbstractLaw, n_tets: int, density: Any = 0.0) -> None:
    if (shape := np.shape(density)) not in ((), (n_tets,)):
        raise ValueError(
            f"density must be one value or one per tet, shape ({n_tets},), "
            f"got shape {shape}."
        )
    for path, leaf, _ in fields_of_tets(law):
        if jnp.ndim(leaf) > 0 and jnp.shape(leaf)[0] != n_tets:
            raise ValueError(
                f"law{path} has shape {jnp.shape(leaf)}; expected one value, or one "
                f"per tet: the mesh has {n_tets} tets. If all tets share it, like the "
                "weights of a network, give the field of the law "
                "equinox.field(metadata=SHARED), see AbstractLaw."
            )


def check_law(law: AbstractLaw, conservative: bool, formulation: Formulation) -> None:
    name = type(law).__name__
    if conservative and not law.conservative:
        raise ValueError(
            f"{name} has no potential, but the model was built for a law that has one; "
            "call build_model with this law."
        )
    if formulation == "mean-dilatation" and not law.conservative:
        raise ValueError(
            f'formulation "mean-dilatation" needs a potential, and {name} has none; '
            'take formulation="displacement", or a law with a potential.'
        )


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
