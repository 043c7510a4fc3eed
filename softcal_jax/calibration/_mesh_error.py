"""How far the mesh may have moved the effectors: a consider parameter of its own.

Linear tets lock: one step towards the equilibrium of quadratic tets on the same mesh
tells by how much. Of quadratic tets there are two formulations, see `build_model`. On a
mesh that is too coarse "displacement" is too stiff and "mean-dilatation" too soft, and
the exact solution lies between them (`python -m benchmarks run locking`). How far apart
they are is computed for the linear body at rest, under the loads of the configuration:
at a deformed equilibrium of one formulation the local pressures of the other are so far
off that no single step leads there. Half of it is the standard deviation, so an error
by locking of the volume is within two of them. What else a coarse mesh gets wrong, as
in torsion or where stiff fibres bend, both formulations share, and it is not seen.
"""

from dataclasses import replace
from typing import Any, get_args

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._typing import Array, Float, HostArray
from softcal_jax.calibration._evaluation import Evaluator
from softcal_jax.calibration._lanes import each_lane, lane_of
from softcal_jax.calibration._problem import CalibrationProblem
from softcal_jax.elements import TET_EDGES
from softcal_jax.equilibrium import (
    Formulation,
    Job,
    Model,
    build_model,
    effector_values,
    linearise,
    residual,
)
from softcal_jax.fields import ParameterSpace
from softcal_jax.mesh import TetMesh, to_quadratic

REMEDIES = {"locking": "use quadratic tets", "formulation": "take a finer mesh"}
"""What helps against the error, by its name: that of linear tets, of quadratic ones."""

MOST_TETS = 50_000
"""Most linear tets whose error is estimated: mid nodes make eight times the nodes."""

BETWEEN = 0.5
"""Standard deviation, as a share of what lies between the two formulations [-]."""


def mesh_errors(
    evaluate: Evaluator,
    z: Float[Array, " n_p"],
    displacement: Float[Array, "n_c n_points 3"],
    of_stiffness: Float[HostArray, "n_rows n_c n_e"],
) -> Job[dict[str, Float[HostArray, "n_c n_e"]]]:
    """Estimate the standard deviation of the effectors by the mesh.

    For linear tets, the change by one Newton step towards quadratic tets, exact where
    displacements are small; loads and markers stay on the corners. For quadratic tets,
    half of what lies between the formulations at rest, as large as the loads have moved
    the effectors at the equilibrium.

    Args:
        evaluate: Evaluator of the calibration.
        z: Scaled parameters [-].
        displacement: The equilibria [m].
        of_stiffness: Change of the effectors per relative change of the stiffness, one
            row; none for linear tets.

    Returns:
        Signed change of the effectors of each configuration, which all have in common,
        by one of the names in `REMEDIES`. Empty where it is not known: for linear tets
        with rigid bodies or actuators, or more than `MOST_TETS` of them, for quadratic
        tets whose law has no potential, and where a body at rest has no stiffness.
    """
    problem = evaluate.numbered
    found: dict[str, HostArray] = {}
    if problem.model.mesh.order == 1:
        locking = _by_order(problem, z, displacement)
        if locking is not None:
            found["locking"] = locking
    elif problem.model.law.conservative:
        (by_stiffness,) = of_stiffness
        between = yield from _by_formulation(problem, z, by_stiffness)
        found["formulation"] = between
    return {name: own for name, own in found.items() if np.all(np.isfinite(own))}


def _by_formulation(
    problem: CalibrationProblem, z, by_stiffness: Float[HostArray, "n_c n_e"]
) -> Job[Float[HostArray, "n_c n_e"]]:
    """Return half of what lies between the formulations, see `mesh_errors`."""
    n_c = len(problem.configurations.gravity)
    lanes = [(z, lane_of(problem.configurations, c)) for c in range(n_c)]
    shared = problem.model, problem.space
    of_lanes = yield from each_lane(_motions_at_rest, shared, lanes)
    stiff, soft = np.stack(of_lanes, axis=1)
    weights = np.asarray(problem.configurations.effectors.inverse_std).reshape(n_c, -1)
    size = lambda e: np.linalg.norm(weights * e, axis=1, keepdims=True)
    # To first order a body half as stiff is moved by its loads twice as far. Where they
    # do not move the effectors at rest, all of their motion may be wrong.
    moved = np.maximum(size(soft), size(soft - stiff))
    there = size(by_stiffness) / np.where(moved > 0.0, moved, 1.0)
    return BETWEEN * (soft - stiff) * there


@eqx.filter_jit
def _motions_at_rest(
    model: Model, space: ParameterSpace, z, c
) -> Float[Array, "n_formulations n_e"]:
    """Compute how the loads move the effectors of the linear body, by formulation.

    Without the stiffness of the loads themselves, by which a chamber under pressure may
    have none left at rest.
    """
    model, c = space.apply(model, c, z)
    rest, found = jnp.zeros((model.n_points, 3)), []
    value = lambda c: c.actuation.value
    none = jnp.zeros_like(value(c))
    unloaded = eqx.tree_at(value, c, none)
    for formulation in get_args(Formulation):
        own = replace(model, formulation=formulation)
        lin = linearise(own, unloaded, rest, none)
        load = -lin.free(residual(own, c, rest, none))
        x = lin.solve(load[None], jnp.zeros((1, lin.system.active.size)))
        read = lambda u, own=own: effector_values(own, c, u)
        _, motion = jax.jvp(read, (rest,), (lin.scatter(x.x)[0],))
        found.append(jnp.where(x.ok, motion.ravel(), jnp.nan))
    return jnp.stack(found)


def _by_order(
    problem: CalibrationProblem, z, displacement
) -> Float[HostArray, "n_c n_e"] | None:
    """Return the change by a node in the middle of each edge."""
    model, mechanism = problem.model, problem.model.mechanism
    bare = mechanism.bodies.n_bodies == 0 and mechanism.n_actuators == 0
    if not bare or model.n_tets > MOST_TETS:
        return None
    mesh = to_quadratic(model.mesh)
    finer = build_model(mesh, model.law, density=model.density)
    changes = []
    for c in range(len(displacement)):
        coarse = jax.tree.map(
            lambda leaf, c=c: np.asarray(leaf)[c], problem.configurations
        )
        lane, u = _refined(mesh, coarse, np.asarray(displacement)[c])
        lane, u = jax.device_put((lane, u))
        changes.append(np.asarray(_change(finer, problem.space, z, lane, u)))
    return np.stack(changes)


def _refined(mesh: TetMesh, coarse: Any, u: HostArray) -> tuple[Any, HostArray]:
    """Pose the quadratic mesh like the linear one; edges between held ends are held."""
    n = len(u)
    ends = np.zeros((mesh.n_nodes - n, 2), int)
    ends[mesh.tets[:, 4:] - n] = mesh.tets[:, np.array(TET_EDGES)]
    middle = lambda a: np.concatenate([a, a[ends].mean(axis=1)])
    corners = lambda a: np.concatenate([a, np.zeros((len(ends), *a.shape[1:]))])
    each = lambda a: np.concatenate([a, np.zeros((len(a), len(ends), 3))], axis=1)
    springs = coarse.springs
    where = lambda c: (
        c.fixed,
        c.imposed,
        c.loads.force,
        c.springs.area,
        c.springs.rest,
    )
    posed = (
        np.concatenate([coarse.fixed, coarse.fixed[ends].all(axis=1)]),
        middle(coarse.imposed),
        each(coarse.loads.force),
        each(springs.area),
        corners(springs.rest),
    )
    return eqx.tree_at(where, coarse, posed), middle(u)


@eqx.filter_jit
def _change(
    model: Model, space: ParameterSpace, z, c, u: Float[Array, "n_points 3"]
) -> Float[Array, " n_e"]:
    """Compute the change of the effectors by one Newton step."""
    model, c = space.apply(model, c, z)
    lin = linearise(model, c, u)
    out_of_balance = lin.free(residual(model, c, u))
    step = lin.solve(-out_of_balance[None], jnp.zeros((1, lin.system.active.size)))
    there = u + lin.scatter(step.x)[0]
    change = effector_values(model, c, there) - effector_values(model, c, u)
    return jnp.where(step.ok, change, jnp.nan).ravel()
