"""Rows of the parameters at a fixed state, from which Eq. (9) is built.

Sign: Eqs. (1) and (7) of the paper give K dx = ... - (df/dp) S lambda_p, Eq. (8) writes
+ H_p^T lambda_p. Hence H_p^T = -(dR/dp) S, with R = f - f_ext; it is defined here, in
`parameter_forces`, and nowhere else.

Rows of errors of the model are the depth of a clamp, and the size of the tets.
"""

import weakref
from collections.abc import Callable
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._module import Module
from softcal_jax._typing import Array, Float, HostArray, Int
from softcal_jax.configurations import ConfigurationArrays
from softcal_jax.equilibrium import (
    InputRows,
    Linearisation,
    Model,
    Readings,
    add_weighted,
    derivatives,
    effector_values,
    field_forces,
    force_of_gradients,
    gravity_load,
    input_rows,
    internal_force,
    residual,
    solved_forces,
    tet_stresses,
)
from softcal_jax.fields import ParameterSpace, find_field
from softcal_jax.materials import split_law
from softcal_jax.mesh import Recovery, recovery

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


@eqx.filter_jit
def parameter_forces(
    model: Model,
    configuration: ConfigurationArrays,
    u: Float[Array, "n_points 3"],
    space: ParameterSpace,
    z: Float[Array, " n_p"],
    *,
    step: float | Float[Array, ""] | None = None,
) -> Float[Array, "n_p n_points 3"]:
    """Compute H_p^T by rows: the force on the nodes per unit of each parameter [N].

    H_p^T = -(d R / d p) S at fixed displacement u [m], by autodiff or, where a `step`
    in scaled units is given [-], by the paper's finite differences of the internal
    force (Sec. III; central here, hence of second order). Parameters that only move
    held nodes or bodies, such as the zero of a motor, exert no force in a fixed state.
    """
    lambda_a = solved_forces(*space.apply(model, configuration, z), u)
    force = lambda model, configuration: -residual(model, configuration, u, lambda_a)
    if step is not None:
        force_at = lambda z: force(*space.apply(model, configuration, z))
        return jax.lax.map(
            lambda d: (force_at(z + step * d) - force_at(z - step * d)) / (2.0 * step),
            jnp.eye(z.shape[0]),
        )
    forces = _field_rows(*space.apply(model, configuration, z), u, space, z)
    others = _others(space)
    if others.size == 0:
        return forces
    of_others = _by_others(model, configuration, space, z)(force)
    return forces.at[others].set(of_others)


@eqx.filter_jit
def parameter_rows(
    linearisation: Linearisation,
    space: ParameterSpace,
    z: Float[Array, " n_p"],
    readings: Readings = effector_values,
) -> InputRows:
    """Compute the rows of all parameters at an equilibrium, per unit of lambda_p.

    Parameters that set fields of the law need one pass over the tets per field and move
    nothing held. The linearisation is that of a model with the parameters `z`. Give the
    same `readings` as to `sensitivity`.
    """
    lin = linearisation
    model, configuration = lin.posed.model, lin.posed.configuration
    forces = _field_rows(model, configuration, lin.u, space, z)
    by_steps = lambda dz: space.apply(model, configuration, z + dz)
    rows = rows_of_forces(lin, forces, readings=readings, by_steps=by_steps)
    others = _others(space)
    if others.size == 0:
        return rows
    by_others = _by_others(model, configuration, space, z)
    of_others = input_rows(lin, by_others, readings)
    return jax.tree.map(lambda leaf, new: leaf.at[others].set(new), rows, of_others)


@eqx.filter_jit
def following_rows(
    linearisation: Linearisation,
    rows: InputRows,
    slopes: Float[Array, "n n_stages n_points 3"] | None,
) -> InputRows:
    """Add to rows of inputs what friction remembers: changes of earlier equilibria.

    `slopes` are the changes of their displacements per unit of each input [m].
    """
    if slopes is None:
        return rows
    lin = linearisation
    model, lane = lin.posed.model, lin.posed.configuration
    moved = lambda w: jnp.asarray(lane.stages) + jnp.tensordot(w, slopes, 1)
    changed = lambda w: eqx.tree_at(lambda c: c.stages, lane, moved(w))

    def by_stages(function):
        return derivatives(
            lambda w: function(model, changed(w)), jnp.zeros(len(slopes))
        )

    return jax.tree.map(jnp.add, rows, input_rows(lin, by_stages, effector_values))


def _others(space: ParameterSpace) -> Int[HostArray, " n_other"]:
    """Return the indices of the parameters that set more than fields of the law."""
    return np.flatnonzero(~np.asarray(space.sets_fields))


def _by_others(
    model: Model,
    configuration: ConfigurationArrays,
    space: ParameterSpace,
    z: Float[Array, " n_p"],
) -> Callable[[Callable], Any]:
    """Return a function that differentiates by the parameters of `_others` alone."""
    others = _others(space)
    changed = lambda w: space.apply(model, configuration, z, others, w)
    return lambda function: derivatives(lambda w: function(*changed(w)), z[others])


def rows_of_forces(
    lin: Linearisation,
    forces: Float[Array, "n n_points 3"],
    held: Float[Array, "n n_points 3"] | None = None,
    *,
    readings: Readings = effector_values,
    by_steps: Callable[[Array], tuple[Model, ConfigurationArrays]] | None = None,
) -> InputRows:
    """Build rows from forces on the nodes [N] and the motion of held nodes [m].

    In a fixed state, readings of forces change directly, and those of the robot that
    steps of the inputs change, as `by_steps` says.
    """
    robot = lin.posed.model, lin.posed.configuration
    reading = jnp.zeros((len(forces), robot[1].effectors.measured.size))
    if readings is not effector_values or robot[1].effectors.observed:

        def read(steps, unbalanced):
            changed = robot if by_steps is None else by_steps(steps)
            return readings(*changed, lin.u, lin.lambda_a, unbalanced).ravel()

        at = jnp.zeros(len(forces)), lin.unbalanced(lin.u, lin.lambda_a)
        _, slope = jax.linearize(read, *at)
        inputs = jnp.eye(len(forces)), forces
        reading = jax.lax.map(lambda d: slope(d[0], -d[1]), inputs)
    return InputRows(
        force=jax.vmap(lin.free)(forces),
        held=jnp.zeros_like(forces) if held is None else held,
        gap=jnp.zeros((len(forces), lin.system.active.size)),
        reading=reading,
    )


def _field_rows(
    model: Model,
    configuration: ConfigurationArrays,
    u: Float[Array, "n_points 3"],
    space: ParameterSpace,
    z: Float[Array, " n_p"],
) -> Float[Array, "n_p n_points 3"]:
    """Compute the forces of parameters that set fields of the law, or the density [N].

    Autodiff in two factors: force by the field in each tet, and field by z, so that all
    control points of one field share one pass over the tets. Rows of other parameters
    are zero. The model has the parameters of `z` applied.
    """
    wheres = {name: find_field(model, name) for name in space.field_names}
    in_law = {f: where for f, where in wheres.items() if f != "density"}
    fields = lambda z: {
        name: jnp.broadcast_to(where(space.model_at(model, z)), (model.n_tets,))
        for name, where in wheres.items()
    }
    directions = jnp.eye(z.shape[0])
    slopes = jax.vmap(lambda d: jax.jvp(fields, (z,), (d,))[1])(directions)
    total = jnp.zeros((z.shape[0], *u.shape))
    if "density" in wheres:
        # The load is linear in the density once the bodies' extra mass is set to zero.
        bare = eqx.tree_at(
            lambda m: m.mechanism.bodies.mass, model, replace_fn=jnp.zeros_like
        )
        of_slope = lambda slope: eqx.tree_at(wheres["density"], bare, slope)
        weight = lambda slope: gravity_load(of_slope(slope), configuration.acceleration)
        total = total + jax.vmap(weight)(slopes["density"])
    if in_law:
        forces = field_forces(model, u, in_law)
        total = total - add_weighted(model, forces, slopes)
    return total


@eqx.filter_jit
def adjoint_of_tets(
    linearisation: Linearisation,
    fields: tuple[str, ...],
    adjoint: Float[Array, "n_e n_dof"],
) -> Float[Array, "n_fields n_e n_tets"]:
    """Compute the change of readings per SI unit of fields in each tet.

    `fields` are those of the law, or "density"; for `adjoint` see `adjoint_rows`.
    """
    model, configuration = linearisation.posed.model, linearisation.posed.configuration
    moved = linearisation.scatter(adjoint)
    law = {f: find_field(model, f) for f in fields if f != "density"}
    forces = field_forces(model, linearisation.u, law) if law else {}

    def of_law(field: str, row: Float[Array, "n_points 3"]) -> Float[Array, " n_tets"]:
        motion = jnp.moveaxis(row[model.nodes], -1, 2)
        work = jnp.sum(forces[field] * motion, axis=(1, 2))
        return -work.ravel()[: model.n_tets]

    def of_density(row: Float[Array, "n_points 3"]) -> Float[Array, " n_tets"]:
        fall = jnp.sum(row * configuration.acceleration[None], axis=1)
        return jnp.sum(model.node_volumes * fall[model.mesh.tets], axis=1)

    one = lambda row: jnp.stack(
        [of_density(row) if f == "density" else of_law(f, row) for f in fields]
    )
    return jnp.swapaxes(jax.lax.map(one, moved), 0, 1)


class DerivativeCheck(Module):
    """Error of the finite-difference H_p against autodiff, per step and parameter.

    Attributes:
        steps: Steps, in scaled units [-].
        errors: Largest difference over the nodes, relative to the largest force [-].
        orders: Order of each error, from steps above rounding [-]; 2 is expected.
    """

    names: tuple[str, ...]
    steps: Float[HostArray, " n_steps"]
    errors: Float[HostArray, "n_steps n_p"]
    orders: Float[HostArray, " n_p"]

    def __str__(self) -> str:
        """Format a table with one row per step."""
        lines = ["step      " + "  ".join(f"{name:>12}" for name in self.names)]
        for step, row in zip(self.steps, self.errors, strict=True):
            lines.append(f"{step:8.1e}  " + "  ".join(f"{e:12.3e}" for e in row))
        lines.append("order     " + "  ".join(f"{o:12.2f}" for o in self.orders))
        return "\n".join(lines)


def check_parameter_derivatives(
    model: Model,
    configuration: ConfigurationArrays,
    u: Float[Array, "n_nodes 3"],
    space: ParameterSpace,
    z: Float[Array, " n_p"],
    *,
    steps: tuple[float, ...] = (1e-1, 3e-2, 1e-2, 3e-3, 1e-3),
) -> DerivativeCheck:
    """Compare the paper's finite-difference H_p with autodiff over a sweep of steps.

    If the force is linear in a parameter, like a modulus on a linear scale, there is
    only rounding and the order is nan. Forces are compared at a displacement `u` that
    is not all zero [m]; steps are in scaled units [-].

    Raises:
        ValueError: If fewer than two steps are given, or they do not decrease.
    """
    if len(steps) < 2 or np.any(np.diff(steps) >= 0):
        raise ValueError(f"steps must be at least two falling numbers, got {steps}.")
    forces = partial(parameter_forces, model, configuration, u, space)
    exact = np.asarray(forces(z))
    largest = lambda rows: np.max(np.abs(rows), axis=(1, 2))
    rows = [np.asarray(forces(z, step=jnp.asarray(step))) for step in steps]
    with np.errstate(divide="ignore", invalid="ignore"):  # no effect here: nan or inf
        errors = np.stack([largest(row - exact) for row in rows]) / largest(exact)
    orders = np.full(len(space.names), np.nan)
    for i, column in enumerate(errors.T):
        clear = column > 1e-9  # above the rounding of the difference
        if clear.sum() >= 2:
            h, e = np.log(np.asarray(steps)[clear]), np.log(column[clear])
            orders[i] = np.polyfit(h, e, 1)[0]
    return DerivativeCheck(tuple(space.names), np.asarray(steps), errors, orders)
