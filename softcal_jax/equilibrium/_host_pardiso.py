"""PARDISO on the host, called back from a program that runs on a GPU.

On a CPU, as many such programs at a time as JAX has threads would deadlock.
"""

import os
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from threading import Lock
from typing import Any, ClassVar

import jax
import numpy as np
from scipy import sparse

from softcal_jax._machine import available_cores
from softcal_jax._typing import HostArray
from softcal_jax.equilibrium._linear_solver import AbstractLinearSolver, fix_threads
from softcal_jax.equilibrium._sparsity import Sparsity

_ANALYSE, _FACTORIZE, _SOLVE = 11, 22, 33
_SYMMETRIC_INDEFINITE, _STRUCTURALLY_SYMMETRIC, _ZERO_PIVOT = -2, 1, -4
"""PARDISO's codes of phases, matrix types and an error."""

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
        if find_spec("pypardiso") is None:
            raise ImportError(
                'solver="pardiso-host", that of a GPU, needs pypardiso: '
                "`pip install 'softcal-jax[gpu]'` on x86-64."
            )
        return cls(sparsity)

    def _factor_solve(self, values, rhs):
        results = (
            jax.ShapeDtypeStruct(rhs.shape, rhs.dtype),
            jax.ShapeDtypeStruct((), np.int32),
            jax.ShapeDtypeStruct((), bool),
        )
        s = self.sparsity
        return jax.pure_callback(
            _on_host, results, s.symmetric, s.indptr, s.indices, values, rhs
        )


@dataclass
class _Slot:
    """The factors kept by one PARDISO instance, and their matrix."""

    pardiso: Any
    lock: Lock
    analysed: bool = False
    kept: sparse.csr_array | None = None

    def prepare(self, matrix: sparse.csr_array) -> None:
        """Factorize a matrix unless its factors are already stored."""
        kept, self.kept = self.kept, None  # forget the factors if this fails
        nothing = np.zeros((matrix.indptr.size - 1, 1))
        if kept is None or not (
            np.array_equal(kept.indptr, matrix.indptr)
            and np.array_equal(kept.indices, matrix.indices)
        ):
            if self.analysed:
                self.pardiso.free_memory(everything=True)
            self.analysed, kept = True, None
            self.call(_ANALYSE, matrix, nothing)
        if kept is None or not np.array_equal(kept.data, matrix.data):
            self.call(_FACTORIZE, matrix, nothing)
        self.kept = matrix

    def call(self, phase: int, matrix: sparse.csr_array, b: HostArray) -> HostArray:
        self.pardiso.set_phase(phase)
        return self.pardiso._call_pardiso(matrix, np.asfortranarray(b))


@cache
def _slot(symmetric: bool) -> _Slot:
    # Do not let idle threads spin: the assembly needs their cores.
    os.environ.setdefault("KMP_BLOCKTIME", "1")
    from pypardiso import PyPardisoSolver

    kind = _SYMMETRIC_INDEFINITE if symmetric else _STRUCTURALLY_SYMMETRIC
    pardiso = PyPardisoSolver(mtype=kind)
    fix_threads(pardiso.libmkl)  # type: ignore[arg-type]  # its constructor loads it
    for entry, value in _OPTIONS.items():
        pardiso.set_iparm(entry, value)
    pardiso.set_iparm(_PERTURBATION, 8 if symmetric else 13)
    return _Slot(pardiso, Lock())


def _on_host(symmetric, indptr, indices, values, rhs):
    from pypardiso.pardiso_wrapper import PyPardisoError

    # Copies: the kept matrix outlives the buffers of JAX.
    indptr, indices, values, rhs = map(np.array, (indptr, indices, values, rhs))
    n, symmetric = indptr.size - 1, bool(symmetric)
    matrix = sparse.csr_array((values, indices, indptr), shape=(n, n))
    slot = _slot(symmetric)
    with slot.lock:
        try:
            slot.prepare(matrix)
            x = slot.call(_SOLVE, matrix, rhs.T).T
        except PyPardisoError as error:
            if error.value != _ZERO_PIVOT:
                raise
            return np.zeros_like(rhs), np.int32(0), np.bool_(False)
        regular = slot.pardiso.get_iparm(_PERTURBED) == 0
        n_negative = slot.pardiso.get_iparm(_NEGATIVE) if symmetric else -1
    return np.ascontiguousarray(x), np.int32(n_negative), np.bool_(regular)
