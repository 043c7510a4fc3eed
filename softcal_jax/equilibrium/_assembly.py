"""Energy, internal force and tangent of the whole mesh."""

import functools
from collections.abc import Callable, Mapping
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._typing import Array, Bool, Float, is_traced
from softcal_jax.elements import determinant, sum_of
from softcal_jax.equilibrium._element import (
    Strains,
    Tet,
    TetStates,
    TetStresses,
    deformation_gradients,
    element_energy_and_force,
    element_state,
    element_stresses,
    newton_system,
    predicted_strains,
    stiffness_of_law,
)
from softcal_jax.equilibrium._model import Model, Nodal, check_law
from softcal_jax.equilibrium._sparsity import element_entries
from softcal_jax.materials import split_law

T = TypeVar("T")


def _map_blocks(model: Model, u: Float[Array, "n_points _"], kernel, *per_tet, **same):
    """Apply a function of (u, tet, ...) to all tets, block by block.

    The kernel is defined at module level so that its trace is cached; a closure would
    be traced at every call and keep its program alive. `per_tet` are further values of
    each tet, in blocks; `same` are arrays or hashable options that all tets share.
    """
    if u.shape[0] not in (model.n_points, model.mesh.n_nodes) or u.shape[1] % 3:
        raise ValueError(  # else JAX reads other nodes in place of missing ones
            f"displacements have the shape {u.shape}; expected ({model.n_points}, 3): "
            "nodes of the mesh, then those of the rigid bodies' frames."
        )
    model.mechanism.check_on(model.mesh)
    if is_traced(model.mesh.points):
        u = jnp.where(model.mechanism.is_off(model.mesh), jnp.nan, u)
    law, shared = split_law(model.law)
    law = jax.tree.map(model.blocks, law)
    blocks = (model.shape_gradients, model.weights, law, model.active)
    arrays, static = eqx.partition((shared, same), eqx.is_array)
    # Flattened, as a module that holds a list has no hash.
    leaves, tree = jax.tree.flatten(static)
    how = kernel, model.averages_volume, tuple(leaves), tree
    return _mapped(how, u, arrays, model.nodes, *blocks, *per_tet)


@functools.partial(jax.jit, static_argnums=0)
def _mapped(how, u, arrays, nodes, *of_tets):
    kernel, mixed, leaves, tree = how
    shared, same = eqx.combine(arrays, jax.tree.unflatten(tree, leaves))
    axes = (-1, -1, -1, 0, -1) + (-1,) * (len(of_tets) - 4)

    def one(u, dN, w, law, active, *others):
        tet = Tet(dN, w, eqx.combine(law, shared), active, mixed)
        return kernel(u, tet, *others, **same)

    vectorised = jax.vmap(one, in_axes=axes, out_axes=-1)

    def block(args):
        nodes, *rest = args
        return vectorised(jnp.moveaxis(u[nodes], -1, 1), *rest)

    return jax.lax.map(block, (nodes, *of_tets))


def tet_states(model: Model, u: Nodal) -> TetStates:
    """Compute energy, stress and deformation of each tet; zero energy if rigid."""
    return jax.tree.map(np.asarray, traced_tet_states(model, u))


@eqx.filter_jit
def traced_tet_states(model: Model, u: Nodal) -> TetStates:
    """Compute the same as `tet_states`, as arrays that can be differentiated."""
    return _by_tet(model, _map_blocks(model, u, element_state))


def _by_tet(model: Model, blocks: T) -> T:
    """Return values of all tets, without the copies that pad the last block."""

    def joined(values):
        by_tet = jnp.moveaxis(values, -1, 1)
        return by_tet.reshape(-1, *by_tet.shape[2:])[: model.n_tets]

    return jax.tree.map(joined, blocks)


def shear_moduli(model: Model) -> Float[Array, " n_tets"]:
    """Compute the mean shear modulus of each tet at rest [Pa]."""
    rest = jnp.zeros((model.mesh.n_nodes, 3))
    return _by_tet(model, _map_blocks(model, rest, _shear_modulus))


def _shear_modulus(u, tet):
    C, (i, j) = tet.law.tangent(jnp.eye(3)), np.triu_indices(3, 1)
    return jnp.mean(C[i, j, i, j])


@eqx.filter_jit
def stiffness_of_laws(model: Model, u: Nodal, du: Nodal) -> Float[Array, "2"]:
    """Sum `stiffness_of_law` over all tets [J]."""
    both = jnp.concatenate([u, du], axis=1)
    of_tets = _by_tet(model, _map_blocks(model, both, _stiffness_of_law))
    return jnp.sum(of_tets, axis=0)


def _stiffness_of_law(both, tet):
    return stiffness_of_law(both[:, :3], both[:, 3:], tet)


def tet_stresses(model: Model, u: Nodal) -> TetStresses:
    """Compute stress and deformation of each tet."""
    return _by_tet(model, _map_blocks(model, u, element_stresses))


def force_of_gradients(model: Model, values: Float[Array, "n_tets n_qp 3 3"]) -> Nodal:
    """Compute the nodal forces whose work is sum_q values_q : grad z [N].

    The values are stresses times the volumes of the points [Pa m3]; those of a tet that
    does not deform do not count.
    """
    blocked = jnp.moveaxis(model.blocks(values), 1, -1)
    both = jnp.einsum("bqiJt,bqaJt->bait", blocked, model.shape_gradients)
    return _add_forces(model, model.active[:, None, None] * both)


def internal_force(model: Model, u: Nodal) -> Nodal:
    """Compute the internal force f(u; p), the gradient of the strain energy [N]."""
    return _add_forces(model, _map_blocks(model, u, _force))


def _force(u, tet):
    return tet.active * element_energy_and_force(u, tet)[1]


def energy_and_force(model: Model, u: Nodal):
    """Compute energy, sum of its absolute parts, internal force and smallest det F."""
    energy, forces, det = _map_blocks(model, u, _energy_and_force)
    force = _add_forces(model, forces)
    return jnp.sum(energy), jnp.sum(jnp.abs(energy)), force, _smallest(det)


def _energy_and_force(u, tet):
    energy, force = element_energy_and_force(u, tet)
    return tet.active * energy, tet.active * force, _det_F(u, tet)


def _det_F(u, tet):
    return _smallest(jax.vmap(determinant)(deformation_gradients(u, tet.dN)))


@jax.custom_jvp
def _smallest(values: Float[Array, "..."]) -> Float[Array, ""]:
    """Return the minimum; JAX's own derivative is nan where a program rounds twice."""
    return jnp.min(values)


_smallest.defjvp(lambda x, d: (jnp.min(x[0]), d[0].ravel()[jnp.argmin(x[0])]))


def smallest_det_F(u: Nodal, nodes, dN) -> Float[Array, ""]:
    """Compute the smallest det F over all quadrature points, differentiably [-].

    `nodes` and `dN` are those of a model. It compiles faster than block by block.
    """
    arms = u[nodes][:, 1:] - u[nodes][:, :1]  # as `deformation_gradients`
    H = jnp.einsum("baki,bqaJk->iJbqk", arms, dN[:, :, 1:])
    return _smallest(determinant(jnp.eye(3)[:, :, None, None, None] + H))


def tangent_values(model: Model, u: Nodal) -> Float[Array, " nnz"]:
    """Compute the tangent K = df/du over all nodes, in the pattern's order [N/m]."""
    options = {"symmetric": model.pattern.symmetric}
    return _add_entries(model, _map_blocks(model, u, _stiffness, **options))


def _stiffness(u, tet, symmetric):
    return tet.active * _kept(newton_system(u, tet)[0], symmetric)


def newton_terms(
    model: Model,
    u: Nodal,
    force: Nodal,
    strains: Strains,
    exact: bool | Bool[Array, ""],
) -> tuple[Float[Array, " nnz"], Nodal]:
    """Compute tangent [N/m] and force [N] of a Newton step, see `newton_system`.

    If `exact`, the strains are those of u, at which the internal `force` is known.
    """

    def turned():
        options = {"symmetric": model.pattern.symmetric}
        entries, forces = _map_blocks(model, u, _newton_terms, strains, **options)
        return _add_entries(model, entries), _add_forces(model, forces)

    if exact is True:  # without a program for the other way
        return tangent_values(model, u), force
    return jax.lax.cond(exact, lambda: (tangent_values(model, u), force), turned)


def _newton_terms(u, tet, strains, symmetric):
    K, f = newton_system(u, tet, strains)
    return tet.active * _kept(K, symmetric), tet.active * f


def _kept(K: Float[Array, "n_en 3 n_en 3"], symmetric: bool):
    n_en = K.shape[0]
    p, q = element_entries(n_en, symmetric)
    return K.reshape(3 * n_en, -1)[p, q]


def no_strains(model: Model) -> Strains:
    """Return the strains and stresses at rest."""
    n_blocks, n_qp, _, _, block = model.shape_gradients.shape
    one = jnp.eye(3)[None, None, :, :, None]
    one = jnp.broadcast_to(one, (n_blocks, n_qp, 3, 3, block))
    return Strains(one, jnp.zeros_like(one), one[:, 0, 0, 0])


def predict(
    model: Model, u: Nodal, du: Nodal, strains: Strains, exact: Bool[Array, ""]
) -> tuple[Strains, Bool[Array, ""]]:
    """Predict strains and stresses after a step, see `predicted_strains`."""
    both = jnp.concatenate([u, du], axis=1)
    strains, sound = _map_blocks(model, both, _predicted, strains, exact=exact)
    return strains, jnp.all(sound)


def _predicted(both, tet, strains, exact):
    return predicted_strains(both[:, :3], both[:, 3:], tet, strains, exact)


def field_forces(
    model: Model, u: Nodal, fields: Mapping[str, Callable[[Any], Any]]
) -> dict[str, Float[Array, "n_blocks n_en 3 block"]]:
    """Differentiate each tet's internal force by its own value of some fields [N].

    Each field is a function, which can be hashed, from a model to a field of its law.
    One pass over the tets gives the derivatives by all values. Those by a parameter
    that spreads a field over the mesh are weighted sums of these.
    """
    return _map_blocks(model, u, _field_forces, fields=tuple(fields.items()))


def _field_forces(u, tet, fields):
    values = {name: where(tet) for name, where in fields}

    def force(values):
        changed = tet
        for name, where in fields:
            changed = eqx.tree_at(where, changed, values[name])
        return element_energy_and_force(u, changed)[1]

    # Linearise once: what a law computes from F is shared by all fields.
    _, slope = jax.linearize(force, values)
    still = jax.tree.map(jnp.zeros_like, values)
    along = lambda name: slope(still | {name: jnp.ones_like(values[name])})
    return {name: tet.active * along(name) for name in values}


def add_weighted(
    model: Model,
    forces: Mapping[str, Float[Array, "n_blocks n_en 3 block"]],
    weights: Mapping[str, Float[Array, "n_p n_tets"]],
) -> Float[Array, "n_p n_points 3"]:
    """Sum `field_forces`, weighted by the change of each field per parameter [N]."""

    def of_tets(name, weight):
        return forces[name] * model.blocks(weight)[:, None, None, :]

    def one(weight):
        return _add_forces(model, sum_of(of_tets(n, w) for n, w in weight.items()))

    return jax.lax.map(one, {name: weights[name] for name in forces})


def _add_entries(
    model: Model, entries: Float[Array, "n_blocks n_entries block"]
) -> Float[Array, " nnz"]:
    check_law(model.law, model.conservative, model.formulation)
    zero = jnp.zeros(model.pattern.nnz, entries.dtype)
    return zero.at[model.destination].add(entries)


def _add_forces(model: Model, forces: Float[Array, "n_blocks n_en 3 block"]) -> Nodal:
    zero = jnp.zeros((model.n_points, 3), forces.dtype)
    return zero.at[model.nodes].add(jnp.moveaxis(forces, -1, 2))


def gravity_load(model: Model, gravity: Float[Array, "3"]) -> Nodal:
    """Compute the weight of mesh and rigid bodies as nodal forces [N]."""
    density = jnp.broadcast_to(model.density, (model.n_tets,))
    mass = density[:, None] * model.node_volumes
    nodal = jnp.zeros(model.n_points).at[model.mesh.tets].add(mass)
    bodies = model.mechanism.bodies
    if bodies.n_bodies > 0:
        on_frames = bodies.mass[:, None] * bodies.mass_weights
        nodal = nodal.at[model.mesh.n_nodes :].add(on_frames.ravel())
    return nodal[:, None] * gravity[None, :]
