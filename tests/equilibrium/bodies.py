"""Compiled entry points and small bodies that the tests of this folder share."""

from functools import cache, partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from problems import lane_of

from softcal_jax.configurations import Configuration, Support, configuration_arrays
from softcal_jax.equilibrium import (
    Model,
    NewtonSettings,
    build_model,
    energy_and_force,
    internal_force,
    linearise,
    solve_equilibrium,
    tangent_values,
)
from softcal_jax.materials import Corotational, Isotropic
from softcal_jax.mesh import beam

# The discretised equations solved to rounding, for derivatives by differences.
TIGHT = NewtonSettings(rtol=1e-12)


# Compiled as a user has it who has not called `use_compilation_cache`: as by it, and as
# in other tests, a batch differs from its members in the last bit. Later versions of
# XLA do not know the option.
OLDER = jax.__version_info__ < (0, 11, 1)


@partial(
    jax.jit,
    compiler_options={"xla_cpu_use_fusion_emitters": True} if OLDER else {},
)
def _as_users(model, lanes, settings):
    one = partial(solve_equilibrium, settings=settings)
    return jax.vmap(one, in_axes=(None, 0))(model, lanes)


def solve(model, lanes, settings=NewtonSettings()):  # noqa: B008 (it is immutable)
    """All lanes of a batch, by the program that scripts and calibrations share."""
    one = partial(solve_equilibrium, model, settings=settings)
    alone = [one(lane(lanes, i)) for i in range(len(lanes))]
    return jax.device_put(jax.tree.map(lambda *same: np.stack(same), *alone))


def solve_as_users(model, lanes, settings=NewtonSettings()):  # noqa: B008
    return _as_users(model, lanes, settings)


def lane(lanes, index: int):
    """One lane of a batch of configurations or solutions."""
    return lane_of(lanes, index)


def imposed_on(mesh, nodes, u) -> object:
    """A configuration that only imposes the displacements `u` [m] on `nodes`."""
    clamp = Configuration("imposed", (Support(nodes),), gravity=(0.0, 0.0, 0.0))
    arrays = configuration_arrays(mesh, [clamp])
    u = jnp.where(arrays.fixed, jnp.asarray(u)[None], 0.0)
    return eqx.tree_at(lambda c: c.imposed, arrays, u)


force = jax.jit(internal_force)
_energy = lambda model, u: energy_and_force(model, u)[0]
_energy_and_gradient = jax.jit(jax.value_and_grad(_energy, argnums=1))
force_jacobian = jax.jit(jax.jacfwd(internal_force, argnums=1))
_values = jax.jit(tangent_values)


def energy(model: Model, u):
    return _energy_and_gradient(model, u)[0]


def energy_gradient(model: Model, u):
    return _energy_and_gradient(model, u)[1]


def factor_solve(model, configuration, u, rhs, *, transpose=False):
    """Solve K(u) dx = rhs for steps of all nodes, or with K^T; see `Bordered`."""
    lin = linearise(model, configuration, u)
    gap = jnp.zeros((rhs.shape[0], lin.system.active.size))
    solved = lin.solve(jax.vmap(lin.free)(rhs), gap, transpose=transpose)
    return solved._replace(x=lin.scatter(solved.x))


def times(sparsity, values, v):
    """K v of a matrix of which the upper triangle is stored, or all of it."""
    rows, columns = sparsity.rows, sparsity.indices
    Kv = jnp.zeros_like(v).at[rows].add(values * v[columns])
    if not sparsity.symmetric:
        return Kv
    return Kv.at[columns].add(jnp.where(rows == columns, 0.0, values) * v[rows])


def stiffness(model: Model, u) -> np.ndarray:
    """The assembled tangent as a dense matrix, both triangles."""
    sparsity = model.solver.sparsity
    kept = np.zeros((model.n_dof, model.n_dof))
    kept[sparsity.rows, sparsity.indices] = _values(model, u)
    return kept + np.triu(kept, 1).T if sparsity.symmetric else kept


# A beam of corotational quadratic tets that most tests of this folder share: one shape,
# one law, so that one compiled program serves them all. L / h = 10.
LENGTH, SIDE = 0.2, 0.02
YOUNG, POISSON, DENSITY = 3e5, 0.3, 1100.0
CLAMP = (Support("x_min"),)
TIP_POINT = (LENGTH, SIDE / 2, SIDE / 2)


@cache
def small_mesh():
    return beam(LENGTH, SIDE, SIDE, (10, 2, 2), order=2)


@cache
def small_model(solver: str | None = None) -> Model:
    law = Corotational(Isotropic(YOUNG, POISSON))
    return build_model(small_mesh(), law, density=DENSITY, solver=solver)


def small_lanes(*configurations: Configuration):
    return configuration_arrays(small_mesh(), configurations)


def hanging(name: str = "hanging", factor: float = 1.0, **changed) -> Configuration:
    """The small beam clamped at x = 0 under a multiple of its weight along -z."""
    settings = {"supports": CLAMP, "gravity": (0.0, 0.0, -9.81 * factor)} | changed
    return Configuration(name, **settings)
