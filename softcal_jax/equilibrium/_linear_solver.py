"""Sparse direct solvers with one interface, usable inside jit and vmap.

pyproject.toml installs PARDISO on x86-64 Linux and Windows, and KLU elsewhere.
"""

import ctypes
import os
from abc import abstractmethod
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import replace
from functools import cache
from typing import Any, ClassVar, NamedTuple, Self

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._module import Module
from softcal_jax._typing import Array, Bool, Float, HostArray, Int
from softcal_jax.equilibrium._sparsity import Sparsity, product


class LinearSolution(NamedTuple):
    """Solutions by rows, zero if the matrix was singular or not finite: not `ok`.

    `n_negative` is the number of negative eigenvalues; -1 if not counted.
    """

    x: Float[Array, "n_rhs n_dof"]
    n_negative: Int[Array, ""]
    ok: Bool[Array, ""]


REFINED = 1e-6
"""Residual over its right-hand side at which a solution belongs to its matrix [-]."""

_ROUNDING = float(np.finfo(float).eps)
"""Backward error at which a solution is as good as that of a factorization [-]."""


class AbstractLinearSolver(Module):
    """A solver for matrices of one sparsity pattern, symmetric or not."""

    sparsity: eqx.AbstractVar[Sparsity]
    name: ClassVar[str]
    can_count: ClassVar[bool] = True
    runs_in_threads: ClassVar[bool] = True
    keeps_factors: ClassVar[bool] = False

    @property
    def solves_per_factor(self) -> float | Float[Array | HostArray, ""]:
        """Right-hand sides that are solved in the time of a factorization, about."""
        return 1.0

    @classmethod
    @abstractmethod
    def analyse(cls, sparsity: Sparsity) -> Self:
        """Prepare the solver for a pattern."""

    @property
    def counts_negative(self) -> bool:
        """Whether `n_negative` is known; never of matrices that are not symmetric."""
        return self.can_count and self.sparsity.symmetric

    @abstractmethod
    def _factor_solve(
        self, values: Float[Array, " nnz"], rhs: Float[Array, "n_rhs n_dof"]
    ) -> tuple[Float[Array, "n_rhs n_dof"], Int[Array, ""], Bool[Array, ""]]:
        """Factorize finite values and solve; return x, n_negative and ok."""

    def factor_solve(
        self,
        values: Float[Array, " nnz"],
        rhs: Float[Array, "n_rhs n_dof"],
        *,
        transpose: bool = False,
    ) -> LinearSolution:
        """Factorize once and solve for all rows of `rhs`, with K^T if `transpose`."""
        if transpose and self.sparsity.mirror is not None:
            values = values[self.sparsity.mirror]
        finite = jnp.all(jnp.isfinite(values)) & jnp.all(jnp.isfinite(rhs))
        # NaN makes PARDISO abort the process: factorize the identity instead.
        x, n_negative, ok = self._factor_solve(
            jnp.where(finite, values, self.sparsity.identity()),
            jnp.where(finite, rhs, 0.0),
        )
        ok = ok & finite & jnp.all(jnp.isfinite(x))
        return LinearSolution(jnp.where(ok, x, 0.0), n_negative, ok)

    def another(self, number: int) -> "AbstractLinearSolver":
        """Return a solver for a thread, with its own factors if this one keeps any."""
        del number
        return self

    def on_device(self, index: Int[Array, ""]) -> "AbstractLinearSolver":
        """Return the solver for a device of JAX, like `another` for a thread."""
        return self

    def side_by_side(self) -> AbstractContextManager[None]:
        """Enter a context in which only solvers of threads are made and used."""
        return nullcontext()

    def solve_again(
        self, values: Float[Array, " nnz"], rhs: Float[Array, "n_rhs n_dof"]
    ) -> Float[Array, "n_rhs n_dof"]:
        """Solve with the factors of the last `factor_solve`, for its matrix `values`.

        Another program may have replaced the factors, so the caller must check the
        solution. A solver that keeps no factors factorizes again.
        """
        return self._factor_solve(values, rhs)[0]

    def solve_near(
        self,
        values: Float[Array, " nnz"],
        rhs: Float[Array, "n_rhs n_dof"],
        *,
        exact: bool = False,
    ) -> LinearSolution:
        """Solve with the factors of the last `factor_solve`, of a matrix that is near.

        Iterative refinement (Higham, Accuracy and Stability of Numerical Algorithms,
        2002, ch. 12) goes on until the residual of every right-hand side is small, or
        mere rounding if `exact` (the backward error of ch. 7), as long as it seems to
        end before a factorization would. Otherwise the matrix is factorized, as where
        another program replaced the factors, or the solver keeps none. Negative
        eigenvalues are only counted then.
        """
        if not self.keeps_factors:
            return self.factor_solve(values, rhs)
        times = lambda x: product(self.sparsity, values, x)
        size = jnp.maximum(jnp.linalg.norm(rhs, axis=1), jnp.finfo(rhs.dtype).tiny)
        largest, tolerance = 0.0, REFINED
        if exact:
            row_sums = product(self.sparsity, jnp.abs(values), jnp.ones(rhs.shape[1]))
            largest, tolerance = jnp.max(row_sums), _ROUNDING
        # What is left may take as long as a factorization with its own solve.
        most = self.solves_per_factor / len(rhs) + 1.0

        def refine(carry):
            x, left, _, count = carry
            x = x + self.solve_again(values, left)
            left = rhs - jax.lax.map(times, x)
            # One by one: in a sum of them, residuals may cancel.
            scale = size + largest * jnp.linalg.norm(x, axis=1)
            ratio = jnp.max(jnp.linalg.norm(left, axis=1) / scale)
            return x, left, ratio, count + 1.0

        def worth_it(carry):
            _, _, ratio, count = carry
            # By the rate so far, which is none where the ratio is 1 or more.
            whole = count * np.log(tolerance) / jnp.minimum(jnp.log(ratio), -1e-9)
            return (ratio > tolerance) & (whole - count <= most)

        begun = refine((jnp.zeros_like(rhs), rhs, jnp.ones(()), jnp.zeros(())))
        x, _, ratio, _ = jax.lax.while_loop(worth_it, refine, begun)
        refined = lambda: (x, jnp.full((), -1, jnp.int32), jnp.ones((), bool))
        anew = lambda: tuple(self.factor_solve(values, rhs))
        return LinearSolution(*jax.lax.cond(ratio <= tolerance, refined, anew))


_Options = tuple[tuple[int, int], ...]
"""Settings of PARDISO: pairs of an index into iparm, counted from 0, and a value."""

# No iterative refinement (Newton's method refines anyway; the residual grows by less
# than a factor of 2), 1x1 pivots, and the one-level factorization: only this one
# supports minimum degree and reports its work, and a process that mixes both can crash.
_COMMON: _Options = ((7, 0), (20, 0), (23, 0), (18, -1), (17, -1))

_NESTED: _Options = (*_COMMON, (1, 2))  # dissection (METIS), for bulky bodies
_MINIMUM_DEGREE: _Options = (*_COMMON, (1, 0))  # for slender bodies and sheets

_MFLOP = 18
"""Index into iparm of the work of a factorization, which the analysis reports."""

_ENTRIES = 17
"""Index into iparm of the entries of the factors, which the analysis reports."""

_PER_SOLVE = 20.0
"""Operations of a factorization that take as long as an entry of it in a solve [-].

Roughly: it only has to tell a sheet, whose factors take no longer than a few solves,
from a bulky body.
"""

_BY_ALL_CORES = 4_000
"""Work above which all cores share a factorization of a lane [million operations].

pardiso-mkl-jax does one factorization at a time. In a small one, most threads wait.
"""

_MKL_DOMAIN_PARDISO = 4  # code of PARDISO among the domains of oneMKL (mkl_types.h)


def fix_threads(mkl: ctypes.CDLL) -> None:
    """Fix the number of threads of PARDISO at what it would take now.

    Otherwise `torch.set_num_threads` would change it, and PARDISO crashes where a
    factorization has fewer threads than its analysis. With a device of JAX for each
    core it is one: teams of threads on all devices would wait for each other.
    """
    n = mkl.MKL_Domain_Get_Max_Threads(_MKL_DOMAIN_PARDISO)
    n = n if jax.local_device_count("cpu") == 1 else 1
    mkl.MKL_Domain_Set_Num_Threads(n, _MKL_DOMAIN_PARDISO)


@cache
def _mkl() -> ctypes.CDLL:
    """Load oneMKL with a fixed number of OpenMP threads."""
    # Do not let idle threads spin: the assembly needs their cores.
    os.environ.setdefault("KMP_BLOCKTIME", "1")
    from pardiso_mkl_jax._mkl_loader import libmkl_rt

    fix_threads(libmkl_rt)
    return libmkl_rt


def _load_pardiso(sparsity: Sparsity):
    _mkl()
    from pardiso_mkl_jax import MatrixType, primitive

    if sparsity.symmetric:
        return primitive, MatrixType.REAL_SYMMETRIC_INDEFINITE
    return primitive, MatrixType.REAL_STRUCTURALLY_SYMMETRIC


class Pardiso(AbstractLinearSolver):
    """Intel oneMKL PARDISO through pardiso-mkl-jax.

    Symmetric matrices are treated as indefinite: the definite type aborts at the first
    non-positive pivot, the indefinite one continues and counts negative eigenvalues.
    Other matrices use the structurally symmetric type, because the general one scales
    and matches by values, which are unknown when the pattern is analysed.

    `token` is the analysis, `work` what a factorization takes [million operations], and
    `entries` are those of its factors.
    `spare` uses nested dissection, because minimum degree can meet a zero pivot in a
    regular, indefinite matrix; None if this one does. `devices` stacks their tokens.
    """

    sparsity: Sparsity
    token: Any
    options: _Options = eqx.field(static=True)
    work: Float[Array | HostArray, ""]  # a static value compiles anew if it differs
    entries: Float[Array | HostArray, ""]
    spare: "Pardiso | None" = None
    devices: Any = None
    name: ClassVar[str] = "PARDISO (pardiso-mkl-jax)"
    keeps_factors: ClassVar[bool] = True

    @classmethod
    def analyse(cls, sparsity):
        nested = cls._of(sparsity, _NESTED, 0)
        degree = replace(cls._of(sparsity, _MINIMUM_DEGREE, 0), spare=nested)
        solver = min((degree, nested), key=lambda solver: solver.work)
        if (n := jax.local_device_count()) == 1:
            return solver
        each = [cls._of(sparsity, solver.options, -2 - k).token for k in range(n)]
        return replace(solver, devices=jax.tree.map(lambda *ids: jnp.stack(ids), *each))

    @classmethod
    def _of(cls, sparsity: Sparsity, options: _Options, number: int) -> "Pardiso":
        primitive, kind = _load_pardiso(sparsity)
        # Inputs tell analyses apart: numbers of threads are above 0, of devices below.
        values = np.full(sparsity.nnz, 1.0 + number)
        token, report = primitive.analyze(
            *jax.device_put((sparsity.indptr, sparsity.indices, values)),
            matrix_type=kind,
            options=dict(options),
        )
        work, entries = np.asarray(report, float)[[_MFLOP, _ENTRIES]]
        return cls(sparsity, token, options, np.array(work), np.array(entries))

    @property
    def solves_per_factor(self):
        return 1e6 * self.work / (_PER_SOLVE * jnp.maximum(self.entries, 1.0))

    def _factor_solve(self, values, rhs):
        solved = self._factor_solve_once(values, rhs)
        spare = self.spare
        if spare is None:
            return solved
        again = lambda: spare._factor_solve_once(values, rhs)
        return jax.lax.cond(solved[2], lambda: solved, again)

    def _factor_solve_once(self, values, rhs):
        x, iparm, _ = self._call("factor_and_solve_stateful", values, rhs)
        perturbed_pivots, negative_eigenvalues = iparm[13], iparm[22]
        if not self.counts_negative:
            negative_eigenvalues = jnp.full_like(negative_eigenvalues, -1)
        return x, negative_eigenvalues, perturbed_pivots == 0

    def another(self, number):
        token = self._of(self.sparsity, self.options, number).token
        spare = None if self.spare is None else self.spare.another(number)
        return replace(self, token=token, spare=spare)

    def on_device(self, index):
        if self.devices is None:
            return self
        return replace(self, token=jax.tree.map(lambda ids: ids[index], self.devices))

    @contextmanager
    def side_by_side(self):
        if self.work > _BY_ALL_CORES:
            yield
            return
        # PARDISO plans for a number of threads, and fails if it differs later.
        mkl = _mkl()
        before = mkl.MKL_Domain_Get_Max_Threads(_MKL_DOMAIN_PARDISO)
        mkl.MKL_Domain_Set_Num_Threads(1, _MKL_DOMAIN_PARDISO)
        try:
            yield
        finally:
            mkl.MKL_Domain_Set_Num_Threads(before, _MKL_DOMAIN_PARDISO)

    def solve_again(self, values, rhs):
        return self._call("solve_stateful", values, rhs)[0]

    def _call(self, function: str, values, rhs):
        primitive, kind = _load_pardiso(self.sparsity)
        return getattr(primitive, function)(
            self.token,
            jnp.asarray(self.sparsity.indptr),
            jnp.asarray(self.sparsity.indices),
            values,
            rhs,
            matrix_type=kind,
            options=dict(self.options),
        )


_KLU_SHIFT = {True: 2.0**-46, False: 2.0**-43}
"""Smallest shift of KLU's diagonal, by symmetry, relative to the rows' entries [-].

It keeps pivots from zero: 64 times their rounding where all shifts have one sign, and
512 times where they may cancel.
"""

_KLU_CHANGE = 1e-3
"""Relative change of a solution by the shift above which a matrix is singular [-].

It is the shift times the condition of the matrix, usually less than 1e-8.
"""


class Klu(AbstractLinearSolver):
    """KLU through klujax, for platforms without PARDISO.

    It does not count negative eigenvalues. CHOLMOD would be faster, but its package
    aborts at the first indefinite tangent of a batch. The full matrix has the entries
    of the pattern, then the lower triangle of a symmetric one, with values from
    `source`.

    klujax raises at a pivot of zero, and all lanes of a batch with it. So the diagonal
    of the matrix, with rows of unit size, is moved by `shift`, everywhere in one
    direction: the last pivots of a singular matrix then have about this size, and the
    solutions for the `probes`, random right-hand sides, are huge.
    """

    sparsity: Sparsity
    full_rows: Int[Array, " n_full"]
    full_cols: Int[Array, " n_full"]
    source: Int[Array, " n_full"]
    shift: Float[Array, " n_dof"]
    probes: Float[Array, "n_probes n_dof"]
    name: ClassVar[str] = "KLU (klujax)"
    can_count: ClassVar[bool] = False

    @classmethod
    def analyse(cls, sparsity):
        rows, cols = sparsity.rows, sparsity.indices
        off = np.flatnonzero((rows != cols) & sparsity.symmetric)
        source = np.concatenate([np.arange(rows.size), off])
        random, n = np.random.default_rng(0), sparsity.n_dof
        shift = _KLU_SHIFT[sparsity.symmetric] * random.uniform(1.0, 2.0, n)
        return cls(
            sparsity=sparsity,
            full_rows=jnp.asarray(np.concatenate([rows, cols[off]])),
            full_cols=jnp.asarray(np.concatenate([cols, rows[off]])),
            source=jnp.asarray(source.astype(np.int32)),
            shift=jnp.asarray(shift),
            probes=jnp.asarray(random.normal(size=(2, n))),
        )

    def _factor_solve(self, values, rhs):
        import klujax

        rows, cols, full = self.full_rows, self.full_cols, values[self.source]
        size = jnp.zeros(rhs.shape[1]).at[rows].max(jnp.abs(full))
        filled = size > 0.0
        # A row of zeros becomes that of the identity.
        unit, shift = jnp.where(filled, size, 1.0), jnp.where(filled, self.shift, 1.0)
        shifted = (full / unit[rows]).at[self.sparsity.diagonal].add(shift)
        right = jnp.concatenate([self.probes, rhs / unit[None]])
        x = klujax.solve(rows, cols, shifted, right.T).T
        answers, x = jnp.split(x, [len(self.probes)])
        change = jnp.linalg.norm(shift[None] * answers, axis=1)
        regular = jnp.all(filled) & jnp.all(change <= _KLU_CHANGE)
        return x, jnp.full((), -1, jnp.int32), regular
