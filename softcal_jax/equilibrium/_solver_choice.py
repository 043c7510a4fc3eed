"""Choice of the sparse direct solver of a model; its name is part of every result."""

import os
from importlib.util import find_spec

import jax

from softcal_jax._machine import available_cores
from softcal_jax._names import suggestion
from softcal_jax.equilibrium._host_pardiso import HostPardiso
from softcal_jax.equilibrium._linear_solver import AbstractLinearSolver, Klu, Pardiso
from softcal_jax.equilibrium._sparsity import Sparsity

_ON_CPU = {"pardiso": Pardiso, "klu": Klu}
_PACKAGES = {"pardiso_mkl_jax": Pardiso, "klujax": Klu}
_NAMES = ["klu", "pardiso", "pardiso-host"]

_REMOVED = ("auto", "multigrid")
"""Names of former solvers. With six parameters at 58 719 and 106 624 nodes, one
calibration step with multigrid took 1.5 times as long as with PARDISO."""


def check_solver(name: str | None) -> None:
    """Raise unless a solver of this name exists.

    Raises:
        ValueError: If there is none.
    """
    if name in _REMOVED:
        raise ValueError(
            f"solver {name!r} was removed with multigrid, which was slower in "
            "calibrations: leave solver out for the direct solver of the platform."
        )
    if name is not None and name not in _NAMES:
        raise ValueError(
            f"solver must be one of {_NAMES}, or left out for that of the platform, "
            f"got {name!r}.{suggestion(name, _NAMES)}"
        )


def choose_solver(name: str | None, unknowns: Sparsity) -> AbstractLinearSolver:
    """Prepare the solver of this name for a pattern, without falling back to others.

    Args:
        name: Name of the solver. None takes the one that pyproject.toml installs on the
            platform, or "pardiso-host" where JAX does not compute on the CPU.
        unknowns: Pattern of the matrices to solve.

    Raises:
        ImportError: If its package is not installed.
        ValueError: If it cannot run where JAX computes.
    """
    backend = jax.default_backend()
    if name is None and backend != "cpu":
        name = "pardiso-host"
    if name == "pardiso-host":
        _check_threads(name, backend)
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


def _check_threads(name: str, backend: str) -> None:
    """Raise if JAX has no second thread to run the callback of a solver on."""
    told = os.environ.get("PJRT_NPROC", os.environ.get("NPROC", ""))
    threads = int(told) if told.isdigit() else available_cores()
    if backend == "cpu" and threads < 2:
        raise ValueError(
            f"The solver {name!r} is called back from JAX, which needs two threads "
            f"for that and has {threads}: set PJRT_NPROC=2 before Python starts."
        )
