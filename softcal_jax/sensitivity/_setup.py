"""How an equilibrium follows errors of the setup: motor zeros, mountings (Sec. VII).

These move what is held, so the displacement changes by more than K^-1 of a force; the
implicit response tells both parts together.
"""

import equinox as eqx
import jax
import jax.numpy as jnp

from softcal_jax._typing import Array, Float
from softcal_jax.configurations import ConfigurationArrays, EffectorArrays
from softcal_jax.equilibrium import (
    RESULTS,
    EquilibriumSolution,
    Model,
    effector_positions,
    implicit_response,
    solved_forces,
)
from softcal_jax.fields import ParameterSpace, SetupParameter


def setup_columns(space: ParameterSpace) -> list[int]:
    """Which parameters belong to the setup."""
    flags = [
        isinstance(entry, SetupParameter)
        for entry in space.entries
        for _ in entry.parameters
    ]
    return [i for i, flag in enumerate(flags) if flag]


def setup_readings(
    model: Model,
    effectors: EffectorArrays,
    u: Float[Array, "n_points 3"],
    space: ParameterSpace,
    z: Float[Array, " n_p"],
) -> Float[Array, "n_s n_rows 3"]:
    """de/dz of the parameters of the setup at fixed positions, where x plays no part.

    The encoder of a motor shows the angle without its error of zero.

    Args:
        model: The body with the parameters of `z` applied.
        effectors: Effectors; those that are forces are left out.
        u: Displacement [m].
        space: The parameters.
        z: Their scaled values [-].
    """
    read = lambda z: effector_positions(space.apply(model, z), effectors, u)
    unit = jnp.eye(z.shape[0])[jnp.asarray(setup_columns(space))]
    return jax.vmap(lambda d: jax.jvp(read, (z,), (d,))[1])(unit)


def setup_displacements(
    model: Model,
    configuration: ConfigurationArrays,
    u: Float[Array, "n_points 3"],
    space: ParameterSpace,
    z: Float[Array, " n_p"],
) -> Float[Array, "n_s n_points 3"]:
    """dx/dz of the parameters of the setup, at an equilibrium [m].

    Args:
        model: The body with the parameters of `z` applied.
        configuration: One configuration.
        u: Equilibrium displacement [m].
        space: The parameters.
        z: Their scaled values [-].
    """
    columns = setup_columns(space)
    count = jnp.zeros((), jnp.int32)
    real = jnp.zeros((), u.dtype)
    solution = EquilibriumSolution(
        u,
        solved_forces(model, configuration, u),
        RESULTS.converged,
        count,
        count,
        real + 1.0,
        real,
        real + 1.0,
        count,
    )
    apply = lambda z: eqx.filter(space.apply(model, z), eqx.is_inexact_array)
    still = jax.tree.map(lambda _: None, configuration)

    def column(direction: Float[Array, " n_p"]) -> Float[Array, "n_points 3"]:
        _, t_model = jax.jvp(apply, (z,), (direction,))
        found = implicit_response(model, configuration, solution, t_model, still)
        return found.displacement

    return jax.vmap(column)(jnp.eye(z.shape[0])[jnp.asarray(columns)])


def setup_compliance(
    model: Model,
    configuration: ConfigurationArrays,
    u: Float[Array, "n_points 3"],
    space: ParameterSpace,
    z: Float[Array, " n_p"],
    rows: Float[Array, "n_e n_points 3"],
) -> Float[Array, "n_e n_s"]:
    """Columns of W_ep of the parameters of the setup, H_e dx/dz + de/dz.

    Args:
        model: The body with the parameters of `z` applied.
        configuration: One configuration, without effectors that are forces.
        u: Equilibrium displacement [m].
        space: The parameters.
        z: Their scaled values [-].
        rows: H_e by rows [-].
    """
    moved = setup_displacements(model, configuration, u, space, z)
    read = setup_readings(model, configuration.effectors, u, space, z)
    by_positions = jnp.sum(rows[:, None] * moved[None], axis=(2, 3))
    return by_positions + read.reshape(moved.shape[0], -1).T
