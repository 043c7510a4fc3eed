"""How far the mesh may have moved the effectors: a consider parameter of its own.

The body is solved once more on a finer mesh: linear tets become quadratic, and each
quadratic tet becomes eight. What the effectors change by is the standard deviation. The
error of quadratic tets falls to about a quarter, so that the change is three quarters
of it, and the exact solution is within two standard deviations; linear tets lock, and
quadratic ones show nearly all of that.

Both meshes are solved for the linear body at rest, under the loads and motions of the
configuration. That takes one factorization, while a deformed equilibrium of the coarse
mesh is far from that of the finer one where the volume hardly changes: the pressures of
its parts are not those of the whole. As the body deforms, the loads move it less, or
more, than they move the linear one; so does the error.
"""

from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._lanes import lane_of
from softcal_jax._typing import Array, Bool, Float, HostArray
from softcal_jax.configurations import (
    Centroid,
    Configuration,
    ConfigurationArrays,
    EdgeForce,
    NodalForces,
    SupportReaction,
    configuration_lanes,
)
from softcal_jax.equilibrium import (
    InputRows,
    Model,
    derivatives,
    effector_values,
    input_rows,
    internal_force,
    linearise,
    refined_model,
    sensitivity,
)
from softcal_jax.fields import ParameterSpace
from softcal_jax.inference import REMEDIES
from softcal_jax.mesh import Refinement, node_indices
from softcal_jax.sensitivity import stiffness_row
from softcal_jax.unknowns._unknowns import Setting

LOCKING, REFINEMENT = REMEDIES

MOST_TETS = {1: 50_000, 2: 12_500}
"""Most tets whose error is estimated, by order: the finer mesh has at most 100 000
quadratic tets, hence about 150 000 nodes."""

AT_ONCE = 4
"""Configurations of one factorization in one program."""

MOST_CHANGE = 10.0
"""Largest change, relative to that of the linear coarse body as it becomes softer [-].

Loads may leave the effectors of a linear body where they are, and move those of the
deformed one."""


class MeshErrors(NamedTuple):
    """Standard deviation of the effectors by the mesh.

    Attributes:
        name: Which error it is, see `REMEDIES`.
        changes: Signed change of the effectors of each configuration, which all have in
            common.
        known: Whether it is known. It is not where the body at rest has no stiffness,
            and nowhere with more than `MOST_TETS`, where curved tets cannot be split or
            a group does not exist on the finer mesh.
    """

    name: str
    changes: Float[HostArray, "n_c n_e"]
    known: Bool[HostArray, " n_c"]


def mesh_errors(
    setting: Setting,
    z: Float[Array, " n_p"],
    *,
    forces: Float[Array, "n_c n_a"],
    of_stiffness: Float[HostArray, "n_c n_e"],
) -> MeshErrors:
    """Estimate the standard deviation of the effectors by the mesh.

    Once for all configurations, since preparing and factorizing the finer body is
    nearly all of the work. `forces` are those of the actuators at the equilibria, and
    `of_stiffness` the change of the effectors per relative change of the stiffness.
    """
    model, batch, n_c = setting.model, setting.arrays, len(setting.configurations)
    name = LOCKING if model.mesh.order == 1 else REFINEMENT
    if of_stiffness.size == 0:
        return MeshErrors(name, of_stiffness, np.ones(n_c, bool))
    unknown = MeshErrors(name, of_stiffness, np.zeros(n_c, bool))
    if model.n_tets > MOST_TETS[model.mesh.order]:
        return unknown
    try:
        fine, refinement = refined_model(model)
        posed = _refined(setting, fine, refinement)
    except ValueError:  # a group may name what the finer mesh does not have
        return unknown
    if np.any(np.asarray(fine.weights) < 0.0):
        return unknown
    motions = partial(_linear_motions, space=setting.space, z=z)
    seen = _comparable(model, batch, forces)
    *coarse, at_rest = motions(model, seen, of_stiffness=True)
    exact = motions(fine, _comparable(fine, posed, forces), of_stiffness=False)
    changes = exact - np.stack(coarse)
    known = np.all(np.isfinite([*changes, at_rest]), axis=(0, 2))
    weights = np.asarray(batch.effectors.inverse_std).reshape(n_c, -1)
    size = lambda e: np.linalg.norm(weights * e, axis=1, keepdims=True)
    # To first order a body half as stiff is moved by its loads twice as far.
    moved = np.maximum(size(at_rest), size(changes[0]) / MOST_CHANGE)
    softening = size(of_stiffness) / np.where(moved > 0.0, moved, 1.0)
    return MeshErrors(name, softening * changes[0] + changes[1:].sum(axis=0), known)


def _refined(setting: Setting, fine: Model, r: Refinement) -> ConfigurationArrays:
    """Pose the finer mesh like the coarse one, with the same supports and loads."""
    batch = setting.arrays
    alike = [_as_found(c, r) for c in setting.configurations]
    posed, _ = configuration_lanes(fine.mesh, alike, fine.mechanism, like=batch)
    held = [r.with_new(fixed, r.among(fixed)) for fixed in np.asarray(batch.fixed)]
    moved = [r.with_new(u, r.carried(u)) for u in np.asarray(batch.imposed)]
    where = lambda c: (c.fixed, c.imposed)
    return eqx.tree_at(where, posed, (np.stack(held), np.stack(moved)))


def _as_found(configuration: Configuration, r: Refinement) -> Configuration:
    """Return a configuration whose groups mean on a finer mesh what they did before.

    Means over nodes and forces on nodes stay with the nodes that they had; a reaction
    sums over what is held between them too. Posts are as long as before but for
    rounding.
    """
    n, c = r.coarse.n_nodes, configuration
    markers = c.markers and replace(c.markers, max_distance=r.mesh.size)
    loads = [
        NodalForces(np.arange(n), load.nodal_forces(r.coarse), name=load.name)
        if isinstance(load, NodalForces | EdgeForce)
        else load
        for load in c.loads
    ]
    effectors = []
    for effector in c.effectors:
        if isinstance(effector, Centroid | SupportReaction):
            nodes = node_indices(r.coarse, effector.where, effector.name)
            if isinstance(effector, SupportReaction):
                summed = np.isin(np.arange(n), nodes)
                nodes = np.flatnonzero(r.with_new(summed, r.among(summed)))
            effector = replace(effector, where=nodes)
        effectors.append(effector)
    return replace(c, markers=markers, loads=loads, effectors=effectors)


def _comparable(
    model: Model, batch: ConfigurationArrays, forces: Float[Array, "n_c n_a"]
) -> ConfigurationArrays:
    """Return configurations in which cables that are slack there do nothing at rest.

    And turns count from rest, since readings are linear there.
    """
    unilateral = model.mechanism.actuators.unilateral
    imposed = np.asarray(batch.actuation.by_displacement)
    slack = imposed & unilateral & (np.asarray(forces) <= 0.0)
    value = np.where(slack, 0.0, np.asarray(batch.actuation.value))
    turns = lambda c: c.effectors.turn_reference
    upright = np.broadcast_to(np.eye(3), np.shape(turns(batch)))
    driven = lambda c: (c.actuation.by_displacement, c.actuation.value)
    batch = eqx.tree_at(turns, batch, upright)
    return eqx.tree_at(driven, batch, (imposed & ~slack, value))


def _linear_motions(
    model: Model,
    batch: ConfigurationArrays,
    *,
    space: ParameterSpace,
    z: Float[Array, " n_p"],
    of_stiffness: bool,
) -> Float[HostArray, "n_rows n_c n_e"]:
    """Compute how far loads, then imposed motions if any, move the effectors.

    And last, `of_stiffness`, the change of these per relative change of the stiffness.
    One group of those held alike after the other, since a body eight times as large
    needs all cores for itself.
    """
    actuation = batch.actuation
    imposed = np.asarray(actuation.value)[np.asarray(actuation.by_displacement)]
    # Parameters set no such motion: mountings and zeros of motors are in the model.
    moves = any(np.asarray(m).any() for m in (imposed, *_motions(batch)))
    found: dict[int, HostArray] = {}
    for group in _held_alike(batch):
        for k in range(0, len(group), AT_ONCE):
            some = group[k : k + AT_ONCE]
            # Always as many, so that one program serves any number of them.
            lanes = lane_of(batch, np.resize(some, AT_ONCE))
            rows = _linear_motion(model, space, moves, of_stiffness, z, lanes)
            found |= dict(zip(some, np.asarray(rows), strict=False))
    return np.stack([found[c] for c in sorted(found)], axis=1)


def _held_alike(batch: ConfigurationArrays) -> list[list[int]]:
    """Group configurations whose bodies at rest share a factorization."""
    # A parameter may set the stiffness of springs by the name of their configuration.
    sprung = np.any(np.asarray(batch.springs.stiffness) > 0.0, axis=1, keepdims=True)
    held = (
        batch.fixed,
        sprung * np.asarray(batch.key),
        batch.bodies.kind,
        batch.actuation.by_displacement,
        batch.actuation.releasing,
    )
    groups: dict[tuple[bytes, ...], list[int]] = {}
    for c in range(len(batch.fixed)):
        same = tuple(np.asarray(part)[c].tobytes() for part in held)
        groups.setdefault(same, []).append(c)
    return list(groups.values())


@eqx.filter_jit
def _linear_motion(
    model: Model,
    space: ParameterSpace,
    moves: bool,
    of_stiffness: bool,
    z: Float[Array, " n_p"],
    lanes: ConfigurationArrays,
) -> Float[Array, "n_lanes n_rows n_e"]:
    """Compute what `_linear_motions` does for lanes held alike; nan without a solution.

    Without the stiffness of the loads themselves, by which a chamber under pressure may
    have none left at rest.
    """
    model, first = space.apply(model, jax.tree.map(lambda leaf: leaf[0], lanes), z)
    rest = jnp.zeros((model.n_points, 3))
    state = (rest, jnp.zeros(model.mechanism.n_actuators))
    lin = linearise(model, _at_share(first, 0.0, 0.0), *state)
    n_rows = 1 + moves

    def rows_of(lane: ConfigurationArrays) -> InputRows:
        _, c = space.apply(model, lane, z)

        def by_shares(function):
            # At a fixed state loads and motions are linear, and so are their readings.
            motions = lambda shares: shares[1] if moves else 0.0
            at = lambda shares: function(
                model, _at_share(c, shares[0], motions(shares))
            )
            return derivatives(at, jnp.zeros(n_rows))

        return input_rows(lin, by_shares, effector_values)

    rows = jax.vmap(rows_of)(lanes)
    joined = lambda own: own.reshape(AT_ONCE * n_rows, *own.shape[2:])
    flat = jax.tree.map(joined, rows)
    solved = sensitivity(lin, flat)
    assert solved.displacement is not None
    assert solved.multipliers is not None
    of_lane = lambda own: own.reshape(AT_ONCE, n_rows, *own.shape[1:])
    u, forces = of_lane(solved.displacement - flat.held), of_lane(solved.multipliers)

    def readings(lane, row: InputRows, u, forces):
        _, c = space.apply(model, lane, z)
        read = lambda *at: effector_values(model, _at_share(c, 0.0, 0.0), *at).ravel()
        follow = lambda du, dl: jax.jvp(read, state, (du, dl))[1]
        return row.reading + jax.vmap(follow)(u, forces)

    found = jax.vmap(readings)(lanes, rows, u, forces)
    if of_stiffness:
        # Of the whole motion, and of the body alone: supports may be elastic.
        whole = of_lane(solved.displacement).sum(axis=1)
        internal = jax.vmap(
            lambda du: jax.jvp(lambda u: internal_force(model, u), (rest,), (du,))[1]
        )(whole)
        softer = jax.vmap(lambda f: stiffness_row(lin, f))(internal)
        more = sensitivity(lin, jax.tree.map(lambda rows: rows[:, 0], softer))
        assert more.displacement is not None
        assert more.multipliers is not None
        states = more.displacement[:, None], more.multipliers[:, None]
        by_stiffness = jax.vmap(readings)(lanes, softer, *states)
        found = jnp.concatenate([found, by_stiffness], axis=1)
    return jnp.where(solved.ok, found, jnp.nan)


def _motions(c: ConfigurationArrays) -> tuple[Any, ...]:
    """Return what is imposed on nodes, springs and bodies [m], [rad]."""
    return c.imposed, c.springs.rest, c.bodies.translation, c.bodies.rotation


def _at_share(c: ConfigurationArrays, loads, motions) -> ConfigurationArrays:
    """Return a configuration at shares of its loads and of its imposed motions."""
    share = jnp.where(jnp.asarray(c.actuation.by_displacement), motions, loads)
    where = lambda c: (c.loads.force, c.actuation.value, c.gravity, c.tilt)
    scaled = (
        loads * jnp.asarray(c.loads.force),
        share * jnp.asarray(c.actuation.value),
        loads * c.acceleration,  # which has no tilt where there is no gravity
        jnp.zeros(2),
    )
    moved = tuple(motions * jnp.asarray(own) for own in _motions(c))
    return eqx.tree_at(_motions, eqx.tree_at(where, c, scaled), moved)
