"""Error of linear tets, by one step towards the equilibrium of quadratic ones."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._typing import Array, Float, HostArray
from softcal_jax.calibration._problem import CalibrationProblem
from softcal_jax.elements import TET_EDGES
from softcal_jax.equilibrium import (
    Model,
    build_model,
    effector_values,
    linearise,
    residual,
)
from softcal_jax.fields import ParameterSpace
from softcal_jax.mesh import TetMesh, to_quadratic

MOST_TETS = 50_000
"""Most tets whose error is estimated: mid nodes make eight times as many nodes."""


def locking_errors(
    problem: CalibrationProblem,
    z: Float[Array, " n_p"],
    displacement: Float[Array, "n_c n_points 3"],
) -> Float[HostArray, "n_c n_e"] | None:
    """Estimate how far the effectors of linear tets are from those of quadratic ones.

    The same body with a node in the middle of each edge: one Newton step from where the
    linear tets are in equilibrium, which is exact for small displacements. Loads and
    markers stay on the corners.

    Args:
        problem: The calibration.
        z: Scaled parameters [-].
        displacement: The equilibria [m].

    Returns:
        Change of the effectors of each configuration; None for quadratic tets, for a
        model with rigid bodies or actuators, and for more than `MOST_TETS`.
    """
    model, mechanism = problem.model, problem.model.mechanism
    bare = mechanism.bodies.n_bodies == 0 and mechanism.n_actuators == 0
    if model.mesh.order == 2 or not bare or model.n_tets > MOST_TETS:
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
