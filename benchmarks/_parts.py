"""Parts of a Newton iteration, to be timed, beside the bare sparse solver."""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp

from softcal_jax.configurations import ConfigurationArrays
from softcal_jax.equilibrium import Model, energy_and_force, tangent_values
from softcal_jax.equilibrium._sparsity import mask_supports


def parts(
    model: Model, lane: ConfigurationArrays, u: jax.Array
) -> dict[str, Callable[[], object]]:
    """Parts of an iteration, and bare PARDISO with its defaults on the same matrix.

    Args:
        model: The body.
        lane: One configuration.
        u: Displacement at which they are timed [m].

    Returns:
        Calls that wait for their end: "pardiso" factorizes and solves, "assembly" makes
        the tangent, "evaluation" energy and forces.
    """
    from pardiso_mkl_jax import MatrixType, primitive

    assembly = eqx.filter_jit(tangent_values)
    evaluation = eqx.filter_jit(energy_and_force)
    sparsity = model.solver.sparsity
    fixed = lane.fixed.ravel()
    values, _ = jax.jit(mask_supports)(sparsity, assembly(model, u), fixed)
    rhs = jnp.where(fixed, 0.0, 1.0)[None]
    indptr, indices = jnp.asarray(sparsity.indptr), jnp.asarray(sparsity.indices)
    kind = MatrixType.REAL_SYMMETRIC_INDEFINITE
    token, _ = primitive.analyze(indptr, indices, values, matrix_type=kind)

    @jax.jit
    def pardiso(token, indptr, indices, values, rhs):
        return primitive.factor_and_solve_stateful(
            token, indptr, indices, values, rhs, matrix_type=kind
        )[0]

    wait = jax.block_until_ready
    return {
        "pardiso": lambda: wait(pardiso(token, indptr, indices, values, rhs)),
        "assembly": lambda: wait(assembly(model, u)),
        "evaluation": lambda: wait(evaluation(model, u)),
    }
