"""Conjugate gradients with algebraic multigrid, above the reach of a direct solver.

A direct factorization of a bulky body takes time with the square of its nodes and
memory with their power 4/3; one multigrid cycle takes both in proportion to them. The
hierarchy is one of smoothed aggregation (Vanek, Mandel and Brezina, Computing 56, 1996)
with the rigid motions of the body at rest as its near-null space, by pyamg on the host.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from threading import Lock
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from scipy import sparse
from scipy.sparse.linalg import LinearOperator, cg

from softcal_jax._typing import Float, HostArray, Int
from softcal_jax.configurations import Mechanism
from softcal_jax.equilibrium._linear_solver import AbstractLinearSolver
from softcal_jax.equilibrium._sparsity import Sparsity

_RTOL = 1e-10
"""Residual at which the iterations end, relative to the right-hand side [-]."""

_MAX_ITERATIONS = 500

_SIMILAR = 0.03
"""Change of a matrix, by its Frobenius norm, with which a hierarchy still serves [-].

That of the last steps of Newton's method: the iterations then are some more, and take
less time than a new hierarchy.
"""

_SMOOTHER = ("chebyshev", {"degree": 2})
"""A polynomial of the matrix: a product with it takes half of a Gauss-Seidel sweep."""


class Blocks(eqx.Module):
    """The full matrix in compressed rows of 3 x 3 blocks, and where values go in it.

    Attributes:
        indptr: Start of each row of blocks.
        indices: Column of each block.
        at: Place of each value of the pattern among the entries of all blocks.
        mirrored_at: Place of its mirror image.
    """

    indptr: Int[HostArray, " n_rows_plus_1"]
    indices: Int[HostArray, " n_blocks"]
    at: Int[HostArray, " nnz"]
    mirrored_at: Int[HostArray, " nnz"]

    @classmethod
    def of(cls, sparsity: Sparsity) -> "Blocks":
        """Blocks of a symmetric matrix that is kept as its upper triangle."""
        n = sparsity.n_dof // 3
        row, i = np.divmod(sparsity.rows.astype(np.int64), 3)
        column, j = np.divmod(sparsity.indices.astype(np.int64), 3)
        upper = np.unique(row * n + column)
        lower = (upper % n) * n + upper // n
        keys = np.unique(np.concatenate([upper, lower]))
        place = lambda r, c, i, j: 9 * np.searchsorted(keys, r * n + c) + 3 * i + j
        return cls(
            np.searchsorted(keys // n, np.arange(n + 1)).astype(np.int32),
            (keys % n).astype(np.int32),
            place(row, column, i, j).astype(np.int32),
            place(column, row, j, i).astype(np.int32),
        )


class Multigrid(AbstractLinearSolver):
    """Conjugate gradients, preconditioned by smoothed aggregation, through pyamg.

    For symmetric positive definite matrices. The iterations start from a random guess,
    so that no eigenvector is left out, and end where they meet a negative curvature:
    that counts as one negative eigenvalue, and there is no solution. One that is
    found is checked by its own residual.

    Attributes:
        blocks: The matrix in blocks.
        rigid_motions: The six rigid motions of the robot at rest, by columns.
    """

    sparsity: Sparsity
    blocks: Blocks
    rigid_motions: Float[HostArray, "n_dof 6"]
    name: str = eqx.field(static=True, default="CG with multigrid (pyamg)")
    counts_negative: bool = eqx.field(static=True, default=True)

    @classmethod
    def analyse(
        cls, sparsity: Sparsity, rigid_motions: Float[HostArray, "n_dof 6"]
    ) -> "Multigrid":
        """Plan the blocks of a pattern.

        Raises:
            ImportError: If pyamg is not installed.
            ValueError: If the matrix is not symmetric.
        """
        if find_spec("pyamg") is None:
            raise ImportError(
                'solver="multigrid" needs pyamg: '
                "`pip install 'softcal-jax[multigrid]'`."
            )
        if not sparsity.symmetric:
            raise ValueError(
                'solver="multigrid" is for models with a potential, and this one has '
                "none (its law, or a SurfacePressure): leave solver out."
            )
        return cls(
            sparsity=sparsity,
            blocks=Blocks.of(sparsity),
            rigid_motions=rigid_motions,
        )

    def _factor_solve(self, values, rhs):
        results = (
            jax.ShapeDtypeStruct(rhs.shape, rhs.dtype),
            jax.ShapeDtypeStruct((), np.int32),
            jax.ShapeDtypeStruct((), bool),
        )
        matrix = (self.blocks, jnp.asarray(self.rigid_motions), values)
        return jax.pure_callback(_on_host, results, matrix, rhs)

    @property
    def runs_in_threads(self):
        """No, see `_host_pardiso`."""
        return False

    def solve_again(self, values, rhs):
        """Solve with the hierarchy of the last matrix, if that was this one."""
        return self._factor_solve(values, rhs)[0]


class _NegativeCurvature(Exception):
    """A direction d with d . A d < 0."""


class _Positive(LinearOperator):
    """A matrix that says so where it is not positive definite."""

    def __init__(self, matrix: sparse.bsr_array):
        super().__init__(matrix.dtype, matrix.shape)
        self._matrix = matrix

    def _matvec(self, x):
        product = self._matrix @ x
        if x @ product < 0.0:
            raise _NegativeCurvature
        return product


class _Hierarchy(NamedTuple):
    """One multigrid cycle, and the matrix that it was made of."""

    indices: HostArray
    entries: HostArray
    held: HostArray
    cycle: LinearOperator


_kept: _Hierarchy | None = None
"""The last one: right-hand sides of one matrix, and similar matrices, need only one."""

_LOCK = Lock()


def _on_host(matrix, rhs):
    """The solve outside JAX."""
    blocks, rigid_motions, values, rhs = jax.tree.map(np.asarray, (*matrix, rhs))
    A, nothing = _assemble(blocks, values), np.zeros_like(rhs)
    try:
        hierarchy, fresh = _hierarchy(A, rigid_motions)
        x, ok = _solve_all(A, hierarchy, rhs)
        if not ok and not fresh:
            _forget()
            x, ok = _solve_all(A, _hierarchy(A, rigid_motions)[0], rhs)
    except _NegativeCurvature:
        _forget()
        return nothing, np.int32(1), np.bool_(False)
    except np.linalg.LinAlgError:  # of the blocks on the diagonal or the coarsest
        return nothing, np.int32(0), np.bool_(False)
    return x, np.int32(0), np.bool_(ok)


def _assemble(blocks: Blocks, values) -> sparse.bsr_array:
    """The full matrix."""
    entries = np.zeros(9 * blocks.indices.size)
    entries[blocks.at] = values
    entries[blocks.mirrored_at] = values
    n = 3 * (blocks.indptr.size - 1)
    # A copy: what is kept outlives the buffers that JAX lends.
    pattern = (np.array(blocks.indices), np.array(blocks.indptr))
    return sparse.bsr_array((entries.reshape(-1, 3, 3), *pattern), shape=(n, n))


def _hierarchy(A: sparse.bsr_array, rigid_motions) -> tuple[_Hierarchy, bool]:
    """The last hierarchy, or one of this matrix; whether it is that."""
    global _kept
    with _LOCK:
        if _kept is not None and _similar(_kept, A):
            return _kept, False
        _kept = None  # its memory is free before that of the next is taken
        _kept = _make_hierarchy(A, rigid_motions)
        return _kept, True


def _forget() -> None:
    """Make a new hierarchy for the next matrix.

    That of an indefinite one would hide whether others are positive definite.
    """
    global _kept
    with _LOCK:
        _kept = None


def _similar(hierarchy: _Hierarchy, A: sparse.bsr_array) -> bool:
    """Whether a hierarchy is as good as one of this matrix would be."""
    if not np.array_equal(hierarchy.indices, A.indices):
        return False
    changed = np.linalg.norm(A.data - hierarchy.entries)
    small = changed <= _SIMILAR * np.linalg.norm(hierarchy.entries)
    return bool(small) and np.array_equal(hierarchy.held, _held(A))


def _held(A: sparse.bsr_array) -> HostArray:
    """Which unknowns are held: their rows have the diagonal alone."""
    return np.asarray(abs(A).sum(axis=1)).ravel() <= np.abs(A.diagonal())


def _make_hierarchy(A: sparse.bsr_array, rigid_motions) -> _Hierarchy:
    """Smoothed aggregation; what is held moves with nothing."""
    from pyamg import smoothed_aggregation_solver

    held = _held(A)
    with _global_random_numbers():
        levels = smoothed_aggregation_solver(
            A,
            B=np.where(held[:, None], 0.0, rigid_motions),
            symmetry="symmetric",
            smooth="jacobi",
            presmoother=_SMOOTHER,
            postsmoother=_SMOOTHER,
            improve_candidates=None,
            max_coarse=500,
        )
    return _Hierarchy(A.indices, A.data, held, levels.aspreconditioner())


@contextmanager
def _global_random_numbers() -> Iterator[None]:
    """For pyamg to estimate spectral radii by; the same, and the user's untouched."""
    before = np.random.get_state()  # noqa: NPY002
    np.random.seed(0)  # noqa: NPY002
    try:
        yield
    finally:
        np.random.set_state(before)  # noqa: NPY002


def _solve_all(
    A: sparse.bsr_array, hierarchy: _Hierarchy, rhs: Float[HostArray, "n_rhs n_dof"]
) -> tuple[Float[HostArray, "n_rhs n_dof"], bool]:
    """Solutions by rows, and whether all are accurate.

    The residual of a slender body is never below its rounding, |A| |x| eps, which can
    be a multiple of what the iterations aim at; a direct solver leaves as much.
    """
    cycle = hierarchy.cycle
    x = np.stack([_solve(A, cycle, b) if np.any(b) else b for b in rhs])
    norm = lambda rows: np.linalg.norm(rows, axis=1)
    rounding = np.finfo(x.dtype).eps * norm((abs(A) @ np.abs(x).T).T)
    aim = np.maximum(_RTOL * norm(rhs), rounding)
    return x, bool(np.all(norm(rhs - (A @ x.T).T) <= 10.0 * aim))


def _solve(
    A: sparse.bsr_array, cycle: LinearOperator, b: Float[HostArray, " n_dof"]
) -> Float[HostArray, " n_dof"]:
    """Conjugate gradients from a random guess whose residual is of the size of b."""
    noise = np.random.default_rng(0).standard_normal(b.size)
    guess = cycle @ (noise * (np.linalg.norm(b) / np.linalg.norm(noise)))
    settings = {"rtol": _RTOL, "atol": 0.0, "maxiter": _MAX_ITERATIONS}
    return cg(_Positive(A), b, guess, M=cycle, **settings)[0]


def rigid_motions(mechanism: Mechanism) -> Float[HostArray, "n_dof 6"]:
    """The six rigid motions of a robot at rest in its unknowns, by columns.

    Three translations and three turns about the middle, in metres at its far end; three
    unknowns per node, then the twists of the bodies along the axes of their frames.
    """
    bodies, points = mechanism.bodies, mechanism.points
    middle = points.mean(axis=0)
    size = np.max(np.abs(points - middle))
    turns = np.eye(3) / size

    def of_points(x):
        moved = np.cross(turns[None], (x - middle)[:, None])  # (n, turn, direction)
        straight = np.broadcast_to(np.eye(3), (len(x), 3, 3))
        return np.concatenate([straight, np.swapaxes(moved, 1, 2)], axis=2)

    axes = bodies.axes
    origins = np.einsum("bij,bjk->bik", axes, of_points(bodies.origin))
    angles = np.zeros_like(origins)
    angles[:, :, 3:] = bodies.length * np.einsum("bij,jk->bik", axes, turns)
    twists = np.concatenate([origins, angles], axis=1)
    return np.concatenate([of_points(points).reshape(-1, 6), twists.reshape(-1, 6)])
