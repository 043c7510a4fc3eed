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

_MAX_ITERATIONS = 2000

_MAX_CORRECTIONS = 20
"""Iterations at most that take out what rounding has left."""

_LARGEST_RESIDUAL = 1e-4
"""Rounding of a solution beyond which the matrix counts as singular [-]."""

_ROUNDING = 1e-12
"""Eigenvalue of the coarsest matrix that may be a zero, by the largest one [-]."""

_SIMILAR = 0.03
"""Change of a matrix, by its Frobenius norm, with which a hierarchy still serves [-].

That of the tangents in the last steps of Newton's method; the iterations may be more.
"""

_SMOOTHER = ("chebyshev", {"degree": 2})
"""A polynomial of the matrix, by products with it alone."""


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
                'The solver "multigrid" needs pyamg: '
                "`pip install 'softcal-jax[multigrid]'`; or leave solver out."
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
        """Solve, with the hierarchy that was kept where that serves."""
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


class _Rescaled(LinearOperator):
    """A cycle for a scaled matrix, for the matrix as it was."""

    def __init__(self, cycle: LinearOperator, scale: Float[HostArray, " n_dof"]):
        super().__init__(cycle.dtype, cycle.shape)
        self._cycle, self._scale = cycle, scale

    def _matvec(self, x):
        return self._scale * (self._cycle @ (self._scale * x))


class _Hierarchy(NamedTuple):
    """A multigrid cycle, and the matrix that it was made of.

    Attributes:
        scale: What the matrix was scaled by, from both sides, to a diagonal of ones.
        scaled: The scaled matrix.
        held: Which unknowns are held.
        cycle: One cycle for the matrix as it was.
    """

    scale: HostArray
    scaled: sparse.bsr_array
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
        x, ok = _solve_all(A, rigid_motions, rhs)
    except _NegativeCurvature:
        return nothing, np.int32(1), np.bool_(False)
    except np.linalg.LinAlgError:  # of the diagonal or the coarsest matrix
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


def _solve_all(
    A: sparse.bsr_array, rigid_motions, rhs: Float[HostArray, "n_rhs n_dof"]
) -> tuple[Float[HostArray, "n_rhs n_dof"], bool]:
    """Solutions by rows, and whether all are accurate.

    A hierarchy is kept once its matrix was found to be positive definite: another one
    would hide whether similar matrices are.
    """
    global _kept
    if np.all(_held(A)):
        return rhs / A.diagonal(), True
    with _LOCK:
        hierarchy, _kept = _kept, None
        x, ok = rhs, False
        if hierarchy is not None and _similar(hierarchy, A):
            x, ok = _solve_with(hierarchy, A, rhs)
        if not ok:
            hierarchy = None  # its memory is free before that of the next is taken
            hierarchy = _make_hierarchy(A, rigid_motions)
            x, ok = _solve_with(hierarchy, A, rhs)
        if ok:
            _kept = hierarchy
    return x, ok


def _similar(hierarchy: _Hierarchy, A: sparse.bsr_array) -> bool:
    """Whether a hierarchy is as good as one of this matrix would be."""
    before, norm = hierarchy.scaled, np.linalg.norm
    if not np.array_equal(before.indices, A.indices):
        return False
    changed = norm(_scaled(A, hierarchy.scale).data - before.data)
    small = changed <= _SIMILAR * norm(before.data)
    return bool(small) and np.array_equal(hierarchy.held, _held(A))


def _scaled(A: sparse.bsr_array, scale: Float[HostArray, " n_dof"]) -> sparse.bsr_array:
    """A matrix times a diagonal one from both sides."""
    of_block = scale.reshape(-1, 3)
    rows = np.repeat(of_block, np.diff(A.indptr), axis=0)
    entries = rows[:, :, None] * A.data * of_block[A.indices][:, None, :]
    return sparse.bsr_array((entries, A.indices, A.indptr), shape=A.shape)


def _held(A: sparse.bsr_array) -> HostArray:
    """Which unknowns are held: their rows have the diagonal alone."""
    return np.asarray(abs(A).sum(axis=1)).ravel() <= np.abs(A.diagonal())


def _make_hierarchy(A: sparse.bsr_array, rigid_motions) -> _Hierarchy:
    """Smoothed aggregation; what is held moves with nothing.

    Of the scaled matrix: a polynomial smooths what is soft beside stiff parts, or moves
    with a large rigid body, no better than the largest eigenvalue allows.
    """
    from pyamg import smoothed_aggregation_solver

    diagonal, held = A.diagonal(), _held(A)
    if np.any(diagonal < 0.0):
        raise _NegativeCurvature
    if np.any(diagonal == 0.0):
        raise np.linalg.LinAlgError
    scale = 1.0 / np.sqrt(diagonal)
    scaled = _scaled(A, scale)
    with _global_random_numbers():
        levels = smoothed_aggregation_solver(
            scaled,
            B=np.where(held[:, None], 0.0, rigid_motions) / scale[:, None],
            symmetry="symmetric",
            smooth="jacobi",
            presmoother=_SMOOTHER,
            postsmoother=_SMOOTHER,
            improve_candidates=None,
            max_coarse=100,
        )
    # Where the coarsest matrix has a negative eigenvalue, so has this one; and where it
    # has none, the cycle is positive definite.
    coarse = np.linalg.eigvalsh(levels.levels[-1].A.toarray())
    if coarse[0] < -_ROUNDING * coarse[-1]:
        raise _NegativeCurvature
    return _Hierarchy(scale, scaled, held, _Rescaled(levels.aspreconditioner(), scale))


@contextmanager
def _global_random_numbers() -> Iterator[None]:
    """The same ones for pyamg's spectral radii each time; then the user's go on."""
    before = np.random.get_state()  # noqa: NPY002
    np.random.seed(0)  # noqa: NPY002
    try:
        yield
    finally:
        np.random.set_state(before)  # noqa: NPY002


def _solve_with(
    hierarchy: _Hierarchy, A: sparse.bsr_array, rhs: Float[HostArray, "n_rhs n_dof"]
) -> tuple[Float[HostArray, "n_rhs n_dof"], bool]:
    """Solutions by rows, and whether all are accurate.

    The residual of a slender body is never below its rounding, |A| |x| eps, which can
    be a multiple of what the iterations aim at; a direct solver leaves as much. Where
    it is a notable part of the right-hand side, the matrix is singular.
    """
    cycle = hierarchy.cycle
    if not np.any(rhs):
        _solve(A, cycle, np.ones_like(rhs[0]))  # may meet a negative curvature
        return rhs, True
    x = np.stack([_solve(A, cycle, b) if np.any(b) else b for b in rhs])
    norm = lambda rows: np.linalg.norm(rows, axis=1)
    rounding = np.finfo(x.dtype).eps * norm(np.abs(x) @ abs(A))
    aim = np.clip(rounding, _RTOL * norm(rhs), _LARGEST_RESIDUAL * norm(rhs))
    return x, bool(np.all(norm(rhs - (A @ x.T).T) <= 10.0 * aim))


def _solve(
    A: sparse.bsr_array, cycle: LinearOperator, b: Float[HostArray, " n_dof"]
) -> Float[HostArray, " n_dof"]:
    """Conjugate gradients from a random guess whose residual is of the size of b."""
    noise = np.random.default_rng(0).standard_normal(b.size)
    size = np.linalg.norm(b)
    guess = cycle @ (noise * (size / np.linalg.norm(noise)))
    settings = {"M": cycle, "rtol": 0.0, "atol": _RTOL * size}
    x, _ = cg(_Positive(A), b, guess, maxiter=_MAX_ITERATIONS, **settings)
    left = b - A @ x
    if np.linalg.norm(left) > 10.0 * _RTOL * size:
        # The rounding of the guess is still in it.
        x += cg(_Positive(A), left, maxiter=_MAX_CORRECTIONS, **settings)[0]
    return x


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
