"""Energy, internal force and tangent of the whole mesh."""

from collections.abc import Callable, Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from softcal_jax._typing import Array, Float
from softcal_jax.elements import determinant, sum_of
from softcal_jax.equilibrium._element import (
    deformation_gradients,
    element_energy,
    element_energy_and_force,
    element_force,
    element_stiffness,
    mean_dilatation,
    mixed_newton,
)
from softcal_jax.equilibrium._model import Model, check_law
from softcal_jax.equilibrium._sparsity import element_entries
from softcal_jax.materials import PointValues, is_point_values

FieldOfLaw = Callable[[Any], Any]
"""Accessor of one field of a law, as `eqx.tree_at` takes it."""


def _map_blocks(model: Model, u: Float[Array, "n_points _"], function, *per_tet):
    """Apply a function of (u, dN, w, law, active, ...) to all tets, block by block.

    Returns arrays with axes (block number, ..., tet in block).
    """
    axes = (-1, -1, -1, 0, -1) + (-1,) * len(per_tet)
    vectorised = jax.vmap(function, in_axes=axes, out_axes=-1)

    def block(args):
        nodes, *rest = args
        return vectorised(jnp.moveaxis(u[nodes], -1, 1), *rest)

    return jax.lax.map(
        block,
        (
            model.nodes,
            model.shape_gradients,
            model.weights,
            model.law_blocks(),
            model.active,
            *per_tet,
        ),
    )


def strain_energy(
    model: Model, u: Float[Array, "n_points 3"]
) -> Float[Array, "n_blocks block"]:
    """Strain energy of each tet, in blocks [J]."""
    return _map_blocks(
        model,
        u,
        lambda u, dN, w, law, active: (
            active * element_energy(u, dN, w, law, model.formulation)
        ),
    )


def internal_force(
    model: Model, u: Float[Array, "n_points 3"]
) -> Float[Array, "n_points 3"]:
    """Internal force f(u; p), the gradient of the strain energy [N]."""
    forces = _map_blocks(
        model,
        u,
        lambda u, dN, w, law, active: (
            active * element_force(u, dN, w, law, model.formulation)
        ),
    )
    return _add_forces(model, forces)


def energy_and_force(model: Model, u: Float[Array, "n_points 3"]):
    """Strain energy, the sum of its absolute parts, internal force, smallest det F."""

    def both(u, dN, w, law, active):
        energy, force = element_energy_and_force(u, dN, w, law, model.formulation)
        det = jax.vmap(determinant)(deformation_gradients(u, dN))
        return active * energy, active * force, jnp.min(det)

    energy, forces, det = _map_blocks(model, u, both)
    force = _add_forces(model, forces)
    return jnp.sum(energy), jnp.sum(jnp.abs(energy)), force, jnp.min(det)


def tangent_values(
    model: Model,
    u: Float[Array, "n_points 3"],
    before: Float[Array, "n_points 3"] | None = None,
) -> Float[Array, " nnz"]:
    """Tangent stiffness K = df/du over all nodes, in the order of the pattern [N/m].

    The upper triangle of a conservative model, where K is symmetric; all entries of
    any other.

    Args:
        model: The body.
        u: Displacement [m].
        before: Where a step to `u` began, see `element_stiffness`; it has no place in
            the mixed formulation, which has its own [m].
    """
    p, q = _kept_entries(model)
    both, stepped = u, None
    if before is not None:
        both, stepped = jnp.concatenate([u, before], axis=1), jnp.any(before != u)

    def entries(u, dN, w, law, active):
        u, before = u[:, :3], None if stepped is None else u[:, 3:]
        K = element_stiffness(u, dN, w, law, model.formulation, before, stepped)
        return active * K.reshape(3 * u.shape[0], -1)[p, q]

    return _add_entries(model, _map_blocks(model, both, entries))


def mixed_tangent(
    model: Model, u: Float[Array, "n_points 3"], theta: Float[Array, "n_blocks block"]
) -> tuple[Float[Array, " nnz"], Float[Array, "n_points 3"]]:
    """Stiffness and force of the Newton step with volume ratios of their own."""
    p, q = _kept_entries(model)

    def both(u, dN, w, law, active, theta):
        K, f = mixed_newton(u, theta, dN, w, law)
        return active * K.reshape(3 * u.shape[0], -1)[p, q], active * f

    entries, forces = _map_blocks(model, u, both, theta)
    return _add_entries(model, entries), _add_forces(model, forces)


def predicted_dilatation(
    model: Model, u: Float[Array, "n_points 3"], du: Float[Array, "n_points 3"]
) -> Float[Array, "n_blocks block"]:
    """Volume ratio of each tet after a step, to first order: J_bar + dJ_bar du [-]."""

    def linear(both, dN, w, law, active):
        del law, active
        u, du = both[:, :3], both[:, 3:]
        J, dJ = jax.jvp(lambda u: mean_dilatation(u, dN, w), (u,), (du,))
        # A step that would turn a tet inside out is not believed beyond a factor 4.
        return jnp.clip(J + dJ, 0.25, 4.0)

    return _map_blocks(model, jnp.concatenate([u, du], axis=1), linear)


def _kept_entries(model: Model):
    """Local rows and columns of the entries that the pattern of the model keeps."""
    check_law(model.law, model.conservative, model.formulation)
    return element_entries(model.nodes.shape[1], model.pattern.symmetric)


def field_forces(
    model: Model, u: Float[Array, "n_points 3"], fields: Mapping[str, FieldOfLaw]
) -> dict[str, Float[Array, "n_blocks m n_en 3 block"]]:
    """Derivatives of each tet's internal force by its own values of some fields [N].

    A field is one number per tet, or one per quadrature point, so one pass over the
    tets tells the derivative by all of them; parameters that spread the field over the
    body only weigh it.

    Args:
        model: The body.
        u: Displacement [m].
        fields: Accessors of fields of the law, by name.

    Returns:
        Nodal forces in blocks; m is 1, or the number of quadrature points.
    """

    def per_tet(u, dN, w, law, active):
        values = {name: where(law) for name, where in fields.items()}
        plain = {
            name: value.values if is_point_values(value) else value[None]
            for name, value in values.items()
        }

        def force(plain):
            new = law
            for name, where in fields.items():
                points = is_point_values(values[name])
                value = PointValues(plain[name]) if points else plain[name][0]
                new = eqx.tree_at(where, new, value)
            return element_force(u, dN, w, new, model.formulation)

        # Once for all fields: what a law computes of F is the same for each of them.
        _, slope = jax.linearize(force, plain)
        still = jax.tree.map(jnp.zeros_like, plain)

        def along(name):
            directions = jnp.eye(plain[name].shape[0])
            return active * jax.vmap(lambda d: slope(still | {name: d}))(directions)

        return {name: along(name) for name in plain}

    return _map_blocks(model, u, per_tet)


def add_weighted(
    model: Model,
    forces: Mapping[str, Float[Array, "n_blocks _ n_en 3 block"]],
    weights: Mapping[str, Float[Array, "n_p n_tets _"]],
) -> Float[Array, "n_p n_points 3"]:
    """Nodal forces of the body, each tet's multiplied by its weight [N].

    Args:
        model: The body.
        forces: Forces of each tet per unit of each field, from `field_forces`.
        weights: How far each parameter moves these fields.
    """

    def of_tets(name, weight):
        n_blocks, m, *_, block = forces[name].shape
        pad = n_blocks * block - model.n_tets
        full = jnp.concatenate([weight, jnp.zeros((pad, m))])
        blocked = jnp.moveaxis(full.reshape(n_blocks, block, m), 1, 2)
        return jnp.sum(forces[name] * blocked[:, :, None, None, :], axis=1)

    def one(weight):
        return _add_forces(model, sum_of(of_tets(n, w) for n, w in weight.items()))

    return jax.lax.map(one, {name: weights[name] for name in forces})


def _add_entries(
    model: Model, entries: Float[Array, "n_blocks n_entries block"]
) -> Float[Array, " nnz"]:
    zero = jnp.zeros(model.pattern.nnz, entries.dtype)
    return zero.at[model.destination].add(entries)


def _add_forces(
    model: Model, forces: Float[Array, "n_blocks n_en 3 block"]
) -> Float[Array, "n_points 3"]:
    zero = jnp.zeros((model.n_points, 3), forces.dtype)
    return zero.at[model.nodes].add(jnp.moveaxis(forces, -1, 2))


def gravity_load(
    model: Model, gravity: Float[Array, "3"]
) -> Float[Array, "n_points 3"]:
    """Weight of mesh and rigid bodies as nodal forces [N], for an acceleration."""
    density = jnp.broadcast_to(model.density, (model.n_tets,))
    mass = density[:, None] * model.node_volumes
    nodal = jnp.zeros(model.n_points).at[model.mesh.tets].add(mass)
    bodies = model.mechanism.bodies
    if bodies.n_bodies > 0:
        on_frames = bodies.mass[:, None] * bodies.mass_weights
        nodal = nodal.at[model.mesh.n_nodes :].add(on_frames.ravel())
    return nodal[:, None] * gravity[None, :]
