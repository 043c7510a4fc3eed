"""Rows of errors of the model: the depth of a clamp, and the size of the tets."""

import weakref

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._typing import Array, Float
from softcal_jax.equilibrium import (
    InputRows,
    Linearisation,
    Model,
    force_of_gradients,
    gravity_load,
    internal_force,
    tet_stresses,
)
from softcal_jax.materials import split_law
from softcal_jax.mesh import Recovery, recovery
from softcal_jax.sensitivity._rows import rows_of_forces

SAFETY = 1.25
"""What the estimate is multiplied by, as for grids whose order is known (Roache, Annu.
Rev. Fluid Mech. 29, 1997) [-]."""

AT_SURFACE = 0.2
"""Share of a tet's volume in which the stress turns into that of a free face [-].

Chosen so that bars one tet thick come out right in torsion, where patches see no
error."""

LOADED = 1e-4
"""Force on a node, relative to the largest, from which its faces are not free [-]. An
unloaded node has only the force that Newton's method leaves."""

_KEPT: dict[int, Recovery] = {}  # by id of the model, while that lives


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
    follow = jnp.zeros((model.n_points, 3)).at[: model.mesh.n_nodes].set(motion)
    turned = jnp.zeros_like(follow)
    if bodies.n_bodies > 0:
        # What a body holds goes with it: its displacement is (R - 1) X, at any X.
        R = model.frames(lin.u).rotation[bodies.body]
        moved = follow[bodies.attached]
        turned = turned.at[bodies.attached].set(
            jnp.sum(R * moved[:, None, :], axis=2) - moved
        )

    def force(depth: Float[Array, ""]) -> Float[Array, "n_points 3"]:
        longer = _stretched(model, depth * motion)
        weight = gravity_load(longer, lin.posed.configuration.acceleration)
        return weight - internal_force(longer, lin.u + depth * turned)

    _, row = jax.jvp(force, (jnp.zeros(()),), (jnp.ones(()),))
    return rows_of_forces(lin, row[None], turned[None])


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


def stress_patches(model: Model) -> Recovery:
    """Prepare the recovery of the stress in the tets that deform, once per model.

    It is kept as long as the model, so that the calibrations of a sweep share it.
    """
    key = id(model)
    patches = _KEPT.get(key)
    if patches is None:
        deforming = np.asarray(model.active).ravel()[: model.n_tets] > 0.0
        patches = _KEPT[key] = jax.device_put(recovery(model.mesh, deforming))
        weakref.finalize(model, _KEPT.pop, key, None)
    return patches


@eqx.filter_jit
def mesh_row(linearisation: Linearisation, patches: Recovery) -> InputRows:
    """Compute the row of Eq. (9) of the finite size of the tets.

    Stresses P that are recovered as a continuous field, P*, are better than those of
    the tets. With the dual solution z of a reading, recovered alike, the error of the
    reading, exact minus computed, is the integral of (P* - P) : (grad z* - grad z)
    (goal-oriented recovery; Korotov, Neittaanmaki and Repin, J. Numer. Math. 11, 2003).
    It is linear in z, so it is the work of a force on the nodes: that force is this
    row, whatever is read.

    With `mean-dilatation`, volume ratios that differ from the mean of their tet are an
    error of the same kind, dual to the pressure. On free faces the traction P N should
    vanish; what is left of it works on the dual traction through the acoustic tensor.
    """
    lin = linearisation
    model = lin.posed.model
    state = tet_stresses(model, lin.u)
    gradient = _squared(patches, state.stress)
    gradient += AT_SURFACE * _at_free_faces(lin, patches, state.stress, state.F)
    if state.excess is not None and state.pressure_slope is not None:
        of_pressure = jnp.sum(_squared(patches, state.excess), axis=1)
        gradient += of_pressure[:, None, None, None] * state.pressure_slope
    force = SAFETY * force_of_gradients(model, gradient)
    return rows_of_forces(lin, force[None])


def _squared(
    r: Recovery, values: Float[Array, "n_tets n_qp *each"]
) -> Float[Array, "n_tets n_qp *each"]:
    """Apply the form that integrates the changes by recovery of two fields."""
    n_tets, n_qp = values.shape[:2]

    def of_component(s: Float[Array, "n_tets n_qp"]) -> Float[Array, "n_tets n_qp"]:
        nodal = jnp.zeros(r.tets.size).at[r.node].add(r.weight * s.ravel()[r.point])
        changed = nodal[r.tets] @ r.from_nodes.T - s @ r.from_points.T
        changed = r.volumes * changed
        back = jnp.zeros_like(nodal).at[r.tets].add(changed @ r.from_nodes)
        spread = jnp.zeros(s.size).at[r.point].add(r.weight * back[r.node])
        return spread.reshape(s.shape) - changed @ r.from_points

    # One component after the other, since the patches have many weights.
    components = jnp.moveaxis(values.reshape(n_tets, n_qp, -1), -1, 0)
    squared = jnp.moveaxis(jax.lax.map(of_component, components), 0, -1)
    return squared.reshape(values.shape)


def _at_free_faces(
    lin: Linearisation,
    r: Recovery,
    stress: Float[Array, "n_tets n_qp 3 3"],
    F: Float[Array, "n_tets 3 3"],
) -> Float[Array, "n_tets n_qp 3 3"]:
    """Differentiate the term of the traction on free faces by grad z [Pa m3]."""
    model = lin.posed.model
    weight = gravity_load(model, lin.posed.configuration.acceleration)
    others = jnp.linalg.norm(internal_force(model, lin.u) - weight, axis=1)
    others = others[: model.mesh.n_nodes]
    free = jnp.all((others <= LOADED * jnp.max(others))[r.face_nodes], axis=1)
    A = _tangents(model, r.face_tet, F[r.face_tet])
    N, E = r.face_normal, r.face_from_points
    traction = jnp.einsum("fkq,fqij,fj->fki", E, stress[r.face_tet], N)
    acoustic = jnp.einsum("fJ,fiJkL,fL->fik", N, A, N)
    strain = jnp.linalg.solve(acoustic, jnp.swapaxes(traction, 1, 2))
    # The dual equilibrium has the transposed tangent.
    dual = jnp.einsum("fmk,fL,fiJmL->fkiJ", strain, N, A)
    volume = jnp.where(free, r.face_volume, 0.0)
    at_points = jnp.einsum("f,fkq,fkiJ->fqiJ", volume, E, dual)
    return jnp.zeros_like(stress).at[r.face_tet].add(at_points)


def _tangents(model: Model, tets, F: Float[Array, "n 3 3"]):
    varying, shared = split_law(model.law)
    varying = jax.tree.map(lambda v: v[tets] if jnp.ndim(v) else v, varying)
    of_tet = jax.tree.map(lambda v: 0 if jnp.ndim(v) else None, varying)
    tangent = lambda varying, F: eqx.combine(varying, shared).stress_and_tangent(F)[1]
    return jax.vmap(tangent, (of_tet, 0))(varying, F)
