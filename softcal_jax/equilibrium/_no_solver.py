"""The solver of a model that is only looked at: none, so that nothing is analysed."""

import equinox as eqx

from softcal_jax.equilibrium._linear_solver import AbstractLinearSolver
from softcal_jax.equilibrium._sparsity import Sparsity

NO_SOLVER = "none"
"""Its name."""


class NoSolver(AbstractLinearSolver):
    """In place of a solver, in a model that is described and drawn but not solved."""

    sparsity: Sparsity
    name: str = eqx.field(static=True, default=NO_SOLVER)
    counts_negative: bool = eqx.field(static=True, default=False)

    def _factor_solve(self, values, rhs):
        raise RuntimeError(
            'this model was built to be looked at, with solver="none": build it again '
            "without, to solve it."
        )
