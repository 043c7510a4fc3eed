"""PARDISO on the host, called from a program that runs on a GPU.

The solvers of `_linear_solver` are part of a program for the CPU. Here the program
hands its matrix to the host and waits for the solution, through a callback that JAX has
on every platform. Such programs run one at a time: on a CPU, as many at once as JAX has
threads wait for each other for ever.
"""

import os
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from threading import Lock
from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np
from scipy import sparse

from softcal_jax._typing import HostArray
from softcal_jax.equilibrium._linear_solver import AbstractLinearSolver
from softcal_jax.equilibrium._sparsity import Sparsity

_ANALYSE, _FACTORIZE, _SOLVE = 11, 22, 33
_SYMMETRIC_INDEFINITE, _STRUCTURALLY_SYMMETRIC = -2, 1
_ZERO_PIVOT = -4
"""Phases, kinds of matrices and an error, by PARDISO's numbers."""

# The settings of `_linear_solver`, entries of iparm from 1 on as oneMKL counts them:
# all are given, nested dissection, no iterative refinement, no scaling or matching, 1x1
# pivots, the one-level factorization.
_OPTIONS = {1: 1, 2: 2, 8: 0, 11: 0, 13: 0, 21: 0, 24: 0}
_PERTURBATION = 10  # small pivots become 10 to minus this
_PERTURBED, _NEGATIVE = 14, 23  # pivots and eigenvalues that PARDISO reports


class HostPardiso(AbstractLinearSolver):
    """Intel oneMKL PARDISO through pypardiso, for symmetric matrices and others.

    All symmetric ones share one set of factors, and so do all others.
    """

    sparsity: Sparsity
    name: str = eqx.field(static=True, default="PARDISO on the host (pypardiso)")
    counts_negative: bool = eqx.field(static=True, default=True)

    @classmethod
    def analyse(cls, sparsity: Sparsity) -> "HostPardiso":
        """Keep the pattern; the analysis follows with the first matrix.

        Raises:
            ImportError: If pypardiso is not installed.
        """
        if find_spec("pypardiso") is None:
            raise ImportError(
                'solver="pardiso-host", that of a GPU, needs pypardiso: '
                "`pip install 'softcal-jax[gpu]'` on x86-64."
            )
        return cls(sparsity=sparsity, counts_negative=sparsity.symmetric)

    def _factor_solve(self, values, rhs):
        results = (
            jax.ShapeDtypeStruct(rhs.shape, rhs.dtype),
            jax.ShapeDtypeStruct((), np.int32),
            jax.ShapeDtypeStruct((), bool),
        )
        s = self.sparsity
        return jax.pure_callback(
            _OnHost(s.symmetric), results, s.indptr, s.indices, values, rhs
        )

    @property
    def runs_in_threads(self):
        """No."""
        return False

    def solve_again(self, values, rhs):
        """Solve on the factors of the last matrix, if that was this one."""
        return self._factor_solve(values, rhs)[0]


@dataclass
class _Slot:
    """The factors of one solver, and what they are of."""

    pardiso: Any
    lock: Lock
    analysed: bool = False
    kept: sparse.csr_array | None = None

    def prepare(self, matrix: sparse.csr_array) -> None:
        """Factorize, unless these factors are there."""
        kept, self.kept = self.kept, None  # in case that it fails
        nothing = np.zeros((matrix.indptr.size - 1, 1))
        if kept is None or not _same_pattern(kept, matrix):
            if self.analysed:
                self.pardiso.free_memory(everything=True)
            self.analysed, kept = True, None
            self.call(_ANALYSE, matrix, nothing)
        if kept is None or not np.array_equal(kept.data, matrix.data):
            self.call(_FACTORIZE, matrix, nothing)
        self.kept = matrix

    def call(self, phase: int, matrix: sparse.csr_array, b: HostArray) -> HostArray:
        """One phase; PARDISO's solutions by columns, where it is to solve."""
        self.pardiso.set_phase(phase)
        return self.pardiso._call_pardiso(matrix, np.asfortranarray(b))


@cache
def _slot(symmetric: bool) -> _Slot:
    """Where the factors of all symmetric matrices are kept, or of all others."""
    # Threads that do not spin: others want these cores for the assembly.
    os.environ.setdefault("KMP_BLOCKTIME", "1")
    from pypardiso import PyPardisoSolver

    kind = _SYMMETRIC_INDEFINITE if symmetric else _STRUCTURALLY_SYMMETRIC
    pardiso = PyPardisoSolver(mtype=kind)
    for entry, value in _OPTIONS.items():
        pardiso.set_iparm(entry, value)
    pardiso.set_iparm(_PERTURBATION, 8 if symmetric else 13)
    return _Slot(pardiso, Lock())


class _Solved(NamedTuple):
    """What the callback gives back."""

    x: HostArray
    n_negative: np.int32
    ok: np.bool_


@dataclass(frozen=True)
class _OnHost:
    """The solve outside JAX; equal ones are one to the compiled programs."""

    symmetric: bool

    def __call__(self, indptr, indices, values, rhs) -> _Solved:
        from pypardiso.pardiso_wrapper import PyPardisoError

        # Copies: what is kept outlives the buffers that JAX lends.
        indptr, indices, values, rhs = map(np.array, (indptr, indices, values, rhs))
        n = indptr.size - 1
        matrix = sparse.csr_array((values, indices, indptr), shape=(n, n))
        slot = _slot(self.symmetric)
        with slot.lock:
            try:
                slot.prepare(matrix)
                x = slot.call(_SOLVE, matrix, rhs.T).T
            except PyPardisoError as error:
                if error.value != _ZERO_PIVOT:
                    raise
                return _Solved(np.zeros_like(rhs), np.int32(0), np.bool_(False))
            regular = slot.pardiso.get_iparm(_PERTURBED) == 0
            n_negative = slot.pardiso.get_iparm(_NEGATIVE) if self.symmetric else -1
        return _Solved(np.ascontiguousarray(x), np.int32(n_negative), np.bool_(regular))


def _same_pattern(one: sparse.csr_array, other: sparse.csr_array) -> bool:
    same_rows = np.array_equal(one.indptr, other.indptr)
    return same_rows and np.array_equal(one.indices, other.indices)
