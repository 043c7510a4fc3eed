"""Which sparse solver a model gets; its name is part of every result."""

import os
from importlib.util import find_spec

import jax

from softcal_jax._machine import available_cores
from softcal_jax._names import suggestion
from softcal_jax.configurations import Mechanism
from softcal_jax.equilibrium._host_pardiso import HostPardiso
from softcal_jax.equilibrium._linear_solver import AbstractLinearSolver, Klu, Pardiso
from softcal_jax.equilibrium._multigrid import Multigrid, rigid_motions
from softcal_jax.equilibrium._sparsity import Sparsity

_ON_CPU = {"pardiso": Pardiso, "klu": Klu}
_PACKAGES = {"pardiso_mkl_jax": Pardiso, "klujax": Klu}
_NAMES = ["auto", "klu", "multigrid", "pardiso", "pardiso-host"]

ITERATIVE_FROM = 80_000
"""Unknowns from which on "auto" takes multigrid (`python -m benchmarks run growth`)."""


def check_solver(name: str | None) -> None:
    """Raise unless a solver of this name exists.

    Raises:
        ValueError: If there is none.
    """
    if name is not None and name not in _NAMES:
        raise ValueError(
            f"solver must be one of {_NAMES}, or left out for that of the platform, "
            f"got {name!r}.{suggestion(name, _NAMES)}"
        )


def choose_solver(
    name: str | None, unknowns: Sparsity, mechanism: Mechanism
) -> AbstractLinearSolver:
    """The solver of this name, ready for a pattern.

    By default the direct solver that pyproject.toml installs on the platform, or that
    of the host where JAX does not compute on the CPU; "auto" takes multigrid instead
    for a large matrix that is symmetric. Nothing else is tried.

    Args:
        name: Name of the solver, None for the default.
        unknowns: Pattern of the matrices to come.
        mechanism: Points and rigid bodies of the robot.

    Raises:
        ImportError: If its package is not installed.
        ValueError: If it cannot run where JAX computes, or not on such matrices.
    """
    backend = jax.default_backend()
    if name == "auto":
        iterative = unknowns.symmetric and unknowns.n_dof >= ITERATIVE_FROM
        name = "multigrid" if iterative else None
    if name is None and backend != "cpu":
        name = "pardiso-host"
    if name in ("multigrid", "pardiso-host"):
        _check_threads(name, backend)
    if name == "multigrid":
        return Multigrid.analyse(unknowns, rigid_motions(mechanism))
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


def _check_threads(name: str, backend: str) -> None:
    """Raise where a program would wait for a callback that has no thread to run on."""
    told = os.environ.get("PJRT_NPROC", os.environ.get("NPROC", ""))
    threads = int(told) if told.isdigit() else available_cores()
    if backend == "cpu" and threads < 2:
        raise ValueError(
            f"The solver {name!r} is called back from JAX, which needs two threads "
            f"for that and has {threads}: set PJRT_NPROC=2 before Python starts."
        )
