"""Row of the depth at which a clamp really holds the body."""

import equinox as eqx
import jax
import jax.numpy as jnp

from softcal_jax._typing import Array, Float
from softcal_jax.bodies import frames_at
from softcal_jax.equilibrium import (
    InputRows,
    Linearisation,
    Model,
    gravity_load,
    internal_force,
)
from softcal_jax.sensitivity._rows import rows_of_forces


def clamp_row(
    linearisation: Linearisation, motion: Float[Array, "n_nodes 3"]
) -> InputRows:
    """Compute the row of Eq. (9) of a clamp that holds the body 1 m farther out.

    The held nodes of the reference shape move, and are held there; the tets that they
    share with free nodes become longer and heavier. Loads, cables and readings stay
    where they are; in these tets this causes an error of the order of their strain.
    `motion` is how far reference positions move per unit of the depth, zero where
    nothing is held [-].
    """
    lin = linearisation
    model, bodies = lin.posed.model, lin.posed.model.mechanism.bodies
    n_nodes = model.mesh.n_nodes
    follow = jnp.zeros((model.n_points, 3)).at[:n_nodes].set(motion)
    turned = jnp.zeros_like(follow)
    if bodies.n_bodies > 0:
        # What a body holds goes with it: its displacement is (R - 1) X, at any X.
        frames = (jnp.asarray(model.mechanism.points) + lin.u)[n_nodes:]
        R = frames_at(bodies, frames).rotation[bodies.body]
        moved = follow[bodies.attached]
        turned = turned.at[bodies.attached].set(
            jnp.sum(R * moved[:, None, :], axis=2) - moved
        )

    def force(depth: Float[Array, ""]) -> Float[Array, "n_points 3"]:
        longer = _stretched(model, depth * motion)
        weight = gravity_load(longer, lin.posed.configuration.acceleration)
        return weight - internal_force(longer, lin.u + depth * turned)

    _, row = jax.jvp(force, (jnp.zeros(()),), (jnp.ones(()),))
    return rows_of_forces(lin, row[None], held=turned[None])


def _stretched(model: Model, v: Float[Array, "n_nodes 3"]) -> Model:
    """Move reference points by v, to first order.

    dN/dX changes by -dN/dX dv/dX, and a volume V by V div v.
    """
    dN = model.shape_gradients
    dv = jnp.einsum("batk,bqajt->bqkjt", v[model.nodes], dN)
    div = jnp.einsum("bqkkt->bqt", dv)
    # Edges stay straight, so the motion is linear in each tet.
    of_tet = div[:, 0].ravel()[: model.n_tets]
    changed = (
        dN - jnp.einsum("bqakt,bqkjt->bqajt", dN, dv),
        model.weights * (1.0 + div),
        model.node_volumes * (1.0 + of_tet)[:, None],
    )
    where = lambda m: (m.shape_gradients, m.weights, m.node_volumes)
    return eqx.tree_at(where, model, changed)
