"""Choice of the sparse direct solver of a model; its name is part of every result.

Beside those of the CPU there is PARDISO on the host, called back from a program that
runs on a GPU. On a CPU, as many such programs at a time as JAX has threads would
deadlock.
"""

import os
from functools import cache
from importlib.util import find_spec
from threading import Lock
from typing import Any, ClassVar

import jax
import numpy as np
from scipy import sparse

from softcal_jax._process import available_cores
from softcal_jax._text import suggestion
from softcal_jax.equilibrium._linear_solver import (
    AbstractLinearSolver,
    Klu,
    Pardiso,
    fix_threads,
)
from softcal_jax.equilibrium._sparsity import Sparsity

_SYMMETRIC_INDEFINITE, _STRUCTURALLY_SYMMETRIC, _ZERO_PIVOT = -2, 1, -4
"""PARDISO's codes of matrix types and an error."""

_IN_USE = Lock()  # held while factors are made and used

# As in `_linear_solver`, but indices count from 1 as in oneMKL: no default settings,
# nested dissection, no iterative refinement, no scaling or matching, 1x1 pivots,
# one-level factorization.
_OPTIONS = {1: 1, 2: 2, 8: 0, 11: 0, 13: 0, 21: 0, 24: 0}
_PERTURBATION = 10  # exponent: small pivots are replaced by 10^-exponent
_PERTURBED, _NEGATIVE = 14, 23  # counts of perturbed pivots, negative eigenvalues


class HostPardiso(AbstractLinearSolver):
    """Intel oneMKL PARDISO through pypardiso.

    All symmetric matrices share one set of factors, all others share another; factors
    of the same matrix are used again.
    """

    sparsity: Sparsity
    name: ClassVar[str] = "PARDISO on the host (pypardiso)"
    runs_in_threads: ClassVar[bool] = False

    @classmethod
    def analyse(cls, sparsity):
        limit = os.environ.get("PJRT_NPROC", os.environ.get("NPROC", ""))
        threads = int(limit) if limit.isdigit() else available_cores()
        if jax.default_backend() == "cpu" and threads < 2:
            raise ValueError(
                f"solver='pardiso-host' needs two threads of JAX, which has {threads}: "
                "set PJRT_NPROC=2 before Python starts."
            )
        return cls(sparsity)

    def _factor_solve(self, values, rhs):
        results = (
            jax.ShapeDtypeStruct(rhs.shape, rhs.dtype),
            jax.ShapeDtypeStruct((), np.int32),
            jax.ShapeDtypeStruct((), bool),
        )
        s = self.sparsity
        arrays = s.symmetric, s.indptr, s.indices, values, rhs
        return jax.pure_callback(_on_host, results, *arrays, vmap_method="sequential")


@cache
def _pardiso(symmetric: bool) -> Any:
    """Make the instance that keeps the factors of all matrices of one kind."""
    # Do not let idle threads spin: the assembly needs their cores.
    os.environ.setdefault("KMP_BLOCKTIME", "1")
    from pypardiso import PyPardisoSolver

    kind = _SYMMETRIC_INDEFINITE if symmetric else _STRUCTURALLY_SYMMETRIC
    pardiso = PyPardisoSolver(mtype=kind)
    fix_threads(pardiso.libmkl)  # type: ignore[arg-type]  # its constructor loads it
    for entry, value in _OPTIONS.items():
        pardiso.set_iparm(entry, value)
    pardiso.set_iparm(_PERTURBATION, 8 if symmetric else 13)
    return pardiso


def _on_host(symmetric, indptr, indices, values, rhs):
    from pypardiso.pardiso_wrapper import PyPardisoError

    # Copies: the kept matrix outlives the buffers of JAX.
    indptr, indices, values, rhs = map(np.array, (indptr, indices, values, rhs))
    n, symmetric = indptr.size - 1, bool(symmetric)
    matrix = sparse.csr_array((values, indices, indptr), shape=(n, n))
    with _IN_USE:
        pardiso = _pardiso(symmetric)
        try:
            if not pardiso._is_already_factorized(matrix):
                pardiso.factorize(matrix)
            x = pardiso.solve(matrix, rhs.T).T
        except PyPardisoError as error:
            pardiso.remove_stored_factorization()
            if error.value != _ZERO_PIVOT:
                raise
            return np.zeros_like(rhs), np.int32(0), np.bool_(False)
        regular = pardiso.get_iparm(_PERTURBED) == 0
        n_negative = pardiso.get_iparm(_NEGATIVE) if symmetric else -1
    return np.ascontiguousarray(x), np.int32(n_negative), np.bool_(regular)


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
_KINDS = {**_ON_CPU, "none": NoSolver, "pardiso-host": HostPardiso}
_PACKAGES = {"pardiso": "pardiso_mkl_jax", "klu": "klujax", "pardiso-host": "pypardiso"}


def solver_kind(name: str | None) -> type[AbstractLinearSolver]:
    """Choose the solver of this name, without falling back to others.

    None takes the one that pyproject.toml installs on the platform, or "pardiso-host"
    where JAX does not compute on the CPU.
    """
    backend = jax.default_backend()
    if name in _ON_CPU and backend != "cpu":
        raise ValueError(
            f"solver={name!r} runs on the CPU alone, and JAX computes on {backend!r}: "
            'leave solver out for "pardiso-host", or set JAX_PLATFORMS=cpu before '
            "Python starts."
        )
    installed = [key for key in _PACKAGES if find_spec(_PACKAGES[key]) is not None]
    if name is None and backend != "cpu":
        name = "pardiso-host"
    elif name is None:
        name = next((key for key in _ON_CPU if key in installed), None)
    if name is None:
        raise ImportError(
            "no sparse direct solver is installed: `pip install softcal-jax` brings "
            "the one of your platform (pardiso-mkl-jax or klujax)."
        )
    if name not in _KINDS:
        raise ValueError(
            f"solver must be one of {sorted(_KINDS)}, or left out for that of the "
            f"platform, got {name!r}.{suggestion(name, _KINDS)}"
        )
    if name in _PACKAGES and name not in installed:
        package = _PACKAGES[name].replace("_", "-")
        source = "'softcal-jax[gpu]'" if name == "pardiso-host" else package
        raise ImportError(f"solver={name!r} needs {package}: `pip install {source}`.")
    return _KINDS[name]
