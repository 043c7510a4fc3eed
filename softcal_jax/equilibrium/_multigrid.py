"""Conjugate gradients with algebraic multigrid, above the reach of a direct solver.

A direct factorization of a bulky body takes time with the square of its nodes and
memory with their power 4/3; one multigrid cycle takes both in proportion to them. The
hierarchy is one of smoothed aggregation (Vanek, Mandel and Brezina, Computing 56, 1996)
with the rigid motions of the body at rest as its near-null space, by pyamg on the host.
"""

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


class _Kept(NamedTuple):
    """The last matrix of a solver, and its hierarchy."""

    indices: HostArray
    values: HostArray
    matrix: sparse.bsr_array
    cycle: LinearOperator


_kept: _Kept | None = None
"""The last one: several right-hand sides of one matrix need one hierarchy."""

_LOCK = Lock()


def _on_host(matrix, rhs):
    """The solve outside JAX."""
    # Copies: what is kept outlives the buffers that JAX lends.
    blocks, rigid_motions, values, rhs = jax.tree.map(np.array, (*matrix, rhs))
    nothing = np.zeros_like(rhs)
    try:
        kept = _prepare(blocks, rigid_motions, values)
        x = np.stack([_solve(kept, b) if np.any(b) else b for b in rhs])
    except _NegativeCurvature:
        return nothing, np.int32(1), np.bool_(False)
    except np.linalg.LinAlgError:  # of the blocks on the diagonal or the coarsest
        return nothing, np.int32(0), np.bool_(False)
    exact = np.linalg.norm(rhs, axis=1)
    left = np.linalg.norm(rhs - (kept.matrix @ x.T).T, axis=1)
    # Recomputed, the residual has the rounding that the iterations do not see.
    return x, np.int32(0), np.bool_(np.all(left <= 10.0 * _RTOL * exact))


def _prepare(blocks: Blocks, rigid_motions, values) -> _Kept:
    """The hierarchy of a matrix, the last one if it is that of the same."""
    global _kept
    with _LOCK:
        if (
            _kept is not None
            and np.array_equal(_kept.values, values)
            and np.array_equal(_kept.indices, blocks.indices)
        ):
            return _kept
        entries = np.zeros(9 * blocks.indices.size)
        entries[blocks.at] = values
        entries[blocks.mirrored_at] = values
        n = rigid_motions.shape[0]
        matrix = sparse.bsr_array(
            (entries.reshape(-1, 3, 3), blocks.indices, blocks.indptr), shape=(n, n)
        )
        _kept = None  # its memory is free before that of the next is taken
        _kept = _Kept(blocks.indices, values, matrix, _cycle(matrix, rigid_motions))
        return _kept


def _cycle(matrix: sparse.bsr_array, rigid_motions) -> LinearOperator:
    """One multigrid cycle as a preconditioner."""
    from pyamg import smoothed_aggregation_solver

    # What is held moves with nothing: its row has its diagonal alone.
    diagonal = np.abs(matrix.diagonal())
    held = np.asarray(abs(matrix).sum(axis=1)).ravel() <= diagonal
    hierarchy = smoothed_aggregation_solver(
        matrix,
        B=np.where(held[:, None], 0.0, rigid_motions),
        symmetry="symmetric",
        smooth=("energy", {"maxiter": 2}),
        improve_candidates=None,
    )
    return hierarchy.aspreconditioner()


def _solve(kept: _Kept, b: Float[HostArray, " n_dof"]) -> Float[HostArray, " n_dof"]:
    """Conjugate gradients from a random guess whose residual is of the size of b."""
    noise = np.random.default_rng(0).standard_normal(b.size)
    guess = kept.cycle @ (noise * (np.linalg.norm(b) / np.linalg.norm(noise)))
    A, settings = _Positive(kept.matrix), {"rtol": _RTOL, "maxiter": _MAX_ITERATIONS}
    x, _ = cg(A, b, guess, atol=0.0, M=kept.cycle, **settings)
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
