"""Row of the error of the mesh, estimated on the mesh at hand."""

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
    return rows_of_forces(lin, force[None], held=jnp.zeros((1, *force.shape)))


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
