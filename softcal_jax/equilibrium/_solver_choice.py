"""Choice of the sparse direct solver of a model; its name is part of every result."""

from importlib.util import find_spec
from typing import ClassVar

import jax

from softcal_jax._names import suggestion
from softcal_jax.equilibrium._host_pardiso import HostPardiso
from softcal_jax.equilibrium._linear_solver import AbstractLinearSolver, Klu, Pardiso
from softcal_jax.equilibrium._sparsity import Sparsity


class NoSolver(AbstractLinearSolver):
    """No solver, so that nothing is analysed for a model that is only looked at."""

    sparsity: Sparsity
    name: ClassVar[str] = "none"
    can_count: ClassVar[bool] = False

    @classmethod
    def analyse(cls, sparsity):
        return cls(sparsity)

    def _factor_solve(self, values, rhs):
        raise RuntimeError(
            'this model was built with solver="none": build it again without.'
        )


_ON_CPU = {"pardiso": Pardiso, "klu": Klu}
_PACKAGES = {"pardiso_mkl_jax": Pardiso, "klujax": Klu}
_ANYWHERE = {"none": NoSolver, "pardiso-host": HostPardiso}
_NAMES = sorted(_ON_CPU | _ANYWHERE)


def solver_kind(name: str | None) -> type[AbstractLinearSolver]:
    """Choose the solver of this name, without falling back to others.

    None takes the one that pyproject.toml installs on the platform, or "pardiso-host"
    where JAX does not compute on the CPU.
    """
    backend = jax.default_backend()
    if name in _ANYWHERE:
        return _ANYWHERE[name]
    if name in _ON_CPU:
        if backend == "cpu":
            return _ON_CPU[name]
        raise ValueError(
            f"solver={name!r} runs on the CPU alone, and JAX computes on {backend!r}: "
            'leave solver out for "pardiso-host", or set JAX_PLATFORMS=cpu before '
            "Python starts."
        )
    if name is not None:
        raise ValueError(
            f"solver must be one of {_NAMES}, or left out for that of the platform, "
            f"got {name!r}.{suggestion(name, _NAMES)}"
        )
    if backend != "cpu":
        return HostPardiso
    for package, kind in _PACKAGES.items():
        if find_spec(package) is not None:
            return kind
    raise ImportError(
        "no sparse direct solver is installed: `pip install softcal-jax` brings the "
        "one of your platform (pardiso-mkl-jax or klujax)."
    )
