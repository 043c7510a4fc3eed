"""Choice of the sparse direct solver of a model; its name is part of every result."""

from importlib.util import find_spec
from typing import Any

import equinox as eqx
import jax

from softcal_jax._names import suggestion
from softcal_jax.equilibrium._host_pardiso import HostPardiso
from softcal_jax.equilibrium._linear_solver import AbstractLinearSolver, Klu, Pardiso
from softcal_jax.equilibrium._sparsity import Sparsity

NO_SOLVER = "none"
"""Name of the solver of a model that is only looked at."""


class NoSolver(AbstractLinearSolver):
    """In place of a solver, so that nothing is analysed for a model that is drawn."""

    sparsity: Sparsity
    name: str = eqx.field(static=True, default=NO_SOLVER)
    counts_negative: bool = eqx.field(static=True, default=False)

    def _factor_solve(self, values, rhs):
        raise RuntimeError(
            'this model was built with solver="none": build it again without.'
        )


_ON_CPU = {"pardiso": Pardiso, "klu": Klu}
_PACKAGES = {"pardiso_mkl_jax": Pardiso, "klujax": Klu}
_NAMES = ["klu", "none", "pardiso", "pardiso-host"]


def check_solver(name: str | None) -> None:
    if name is not None and name not in _NAMES:
        raise ValueError(
            f"solver must be one of {_NAMES}, or left out for that of the platform, "
            f"got {name!r}.{suggestion(name, _NAMES)}"
        )


def choose_solver(name: str | None, unknowns: Sparsity) -> AbstractLinearSolver:
    """Prepare the solver of this name for a pattern, without falling back to others.

    None takes the one that pyproject.toml installs on the platform, or "pardiso-host"
    where JAX does not compute on the CPU.
    """
    if name == NO_SOLVER:
        return NoSolver(unknowns)
    backend = jax.default_backend()
    if name is None and backend != "cpu":
        name = "pardiso-host"
    if name == "pardiso-host":
        return HostPardiso.analyse(unknowns)
    if name is not None:
        if backend != "cpu":
            raise ValueError(
                f"solver={name!r} runs on the CPU alone, and JAX computes on "
                f'{backend!r}: leave solver out for "pardiso-host", or set '
                "JAX_PLATFORMS=cpu before Python starts."
            )
        return _ON_CPU[name].analyse(unknowns)
    for package, kind in _PACKAGES.items():
        if find_spec(package) is not None:
            return kind.analyse(unknowns)
    raise ImportError(
        "no sparse direct solver is installed: `pip install softcal-jax` brings the "
        "one of your platform (pardiso-mkl-jax or klujax)."
    )


def same_solver(solver: Any, unknowns: Sparsity) -> AbstractLinearSolver:
    """Prepare a solver of the same kind for another pattern."""
    return type(solver).analyse(unknowns)
