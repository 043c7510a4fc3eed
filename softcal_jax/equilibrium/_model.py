"""The finite-element model of a robot: mesh, law, density, ready for assembly."""

from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike

from softcal_jax._typing import Array, Float, Int
from softcal_jax.elements import shape_functions, shape_gradients, tet_rule
from softcal_jax.equilibrium._element import Formulation
from softcal_jax.equilibrium._linear_solver import (
    AbstractLinearSolver,
    analyse,
    require_float64,
)
from softcal_jax.equilibrium._sparsity import build_sparsity
from softcal_jax.materials import AbstractLaw
from softcal_jax.mesh import TetMesh, check_mesh

# Tets are computed in blocks that stay in the first cache, the tet index last so that
# it vectorises: the corotational law takes twice as long with 32 as with 16.
BLOCK = 16


class Model(eqx.Module):
    """A meshed body with its material; every array is a traced argument of the solver.

    Attributes:
        mesh: The mesh [m].
        law: Constitutive law; its arrays hold one value, or one per tet.
        density: Mass density, one value or one per tet [kg/m3].
        active: 1 for each tet, 0 for the copies that fill up the last block.
        formulation: "displacement" or "mean-dilatation"; see `build_model`.
    """

    mesh: TetMesh
    law: AbstractLaw
    density: Float[Array, "..."]
    shape_gradients: Float[Array, "n_blocks n_qp n_en 3 block"]
    weights: Float[Array, "n_blocks n_qp block"]
    active: Float[Array, "n_blocks block"]
    nodes: Int[Array, "n_blocks n_en block"]
    destination: Int[Array, "n_blocks n_entries block"]
    node_volumes: Float[Array, "n_tets n_en"]
    solver: AbstractLinearSolver
    formulation: Formulation = eqx.field(static=True)

    @property
    def n_dof(self) -> int:
        """Unknowns, three per node."""
        return 3 * self.mesh.points.shape[0]

    @property
    def n_tets(self) -> int:
        """Number of tets."""
        return self.mesh.tets.shape[0]

    def with_law(self, law: AbstractLaw) -> "Model":
        """The same body with another law of the same or another class."""
        _check_fields(law, self.n_tets)
        return eqx.tree_at(lambda m: m.law, self, law)

    def law_blocks(self) -> AbstractLaw:
        """The law with per-tet arrays cut into blocks, as `assembly` maps over it."""
        n_blocks, _, block = self.weights.shape
        return jax.tree.map(
            lambda leaf: to_blocks(leaf, self.n_tets, n_blocks, block), self.law
        )


def to_blocks(
    leaf: Float[Array, "..."], n_tets: int, n_blocks: int, block: int
) -> Float[Array, "n_blocks block ..."]:
    """One value per tet, in blocks; one value for all is repeated."""
    if leaf.ndim == 0:
        return jnp.broadcast_to(leaf, (n_blocks, block))
    pad = n_blocks * block - n_tets
    filled = jnp.concatenate([leaf, jnp.broadcast_to(leaf[:1], (pad, *leaf.shape[1:]))])
    return filled.reshape(n_blocks, block, *leaf.shape[1:])


def _check_fields(law: AbstractLaw, n_tets: int) -> None:
    for path, leaf in jax.tree_util.tree_leaves_with_path(law):
        if jnp.ndim(leaf) > 0 and jnp.shape(leaf)[0] != n_tets:
            raise ValueError(
                f"law{jax.tree_util.keystr(path)} has shape {jnp.shape(leaf)}; "
                f"expected one value, or one per tet: the mesh has {n_tets} tets."
            )


def build_model(
    mesh: TetMesh,
    law: AbstractLaw,
    *,
    density: Float[ArrayLike, "..."],
    formulation: Literal["auto"] | Formulation = "auto",
    solver: str | None = None,
) -> Model:
    """Prepare a body for equilibrium: shape gradients, sparsity, symbolic analysis.

    Which element: quadratic tets (`to_quadratic`) for anything that bends; linear tets
    lock and their moduli are effective, mesh-dependent numbers. Which formulation, for
    quadratic tets: "displacement" is a little too stiff, and the more accurate one up
    to nu = 0.45; "mean-dilatation" is a little too soft, and the more accurate one from
    nu = 0.49 on (`python -m benchmarks run locking`).

    Args:
        mesh: The mesh [m], linear or quadratic.
        law: Constitutive law; arrays of it hold one value, or one per tet.
        density: Mass density, one value or one per tet [kg/m3].
        formulation: How the volume change enters. "auto" takes "mean-dilatation" for
            quadratic tets whose law has a Poisson's ratio `nu` of 0.49 or more, and
            "displacement" otherwise; `Model.formulation` says which.
        solver: Sparse solver; by default the one of the platform.

    Returns:
        The model.

    Raises:
        ValueError: If JAX is not in float64, the mesh is not sound, the density is
            negative, a per-tet array has the wrong length, or the formulation is
            unknown.
    """
    require_float64()
    check_mesh(mesh)
    _check_fields(law, mesh.n_tets)
    density = jnp.asarray(density, float)
    if density.ndim > 0 and density.shape != (mesh.n_tets,):
        raise ValueError(
            f"density must be one value or one per tet, shape ({mesh.n_tets},), "
            f"got shape {density.shape}."
        )
    bad = np.atleast_1d(density)[~(np.atleast_1d(density) >= 0) | np.isinf(density)]
    if bad.size:
        raise ValueError(
            f"density must be finite and not negative [kg/m3], got {bad[0]:g}."
        )
    n_tets, n_en = mesh.tets.shape
    block = BLOCK
    n_blocks = -(-n_tets // block)

    def blocked(per_tet):
        pad = np.broadcast_to(
            per_tet[:1], (n_blocks * block - n_tets, *per_tet.shape[1:])
        )
        cut = np.concatenate([per_tet, pad]).reshape(
            n_blocks, block, *per_tet.shape[1:]
        )
        return np.moveaxis(cut, 1, -1)

    dN, w = _shape_gradients_at(mesh, degree=1 if n_en == 4 else 2)
    active = np.arange(n_blocks * block) < n_tets
    sparsity, destination = build_sparsity(mesh.tets, mesh.n_nodes)
    rule = tet_rule(2 if n_en == 4 else 4)
    _, w_load = _shape_gradients_at(mesh, degree=2 if n_en == 4 else 4)
    node_volumes = w_load @ shape_functions(rule.barycentric, n_en)
    return Model(
        mesh,
        law,
        density,
        jnp.asarray(blocked(dN)),
        jnp.asarray(blocked(w)),
        jnp.asarray(active.reshape(n_blocks, block), float),
        jnp.asarray(blocked(mesh.tets.astype(np.int32))),
        jnp.asarray(blocked(destination.T)),
        jnp.asarray(node_volumes),
        analyse(sparsity, solver),
        _formulation(formulation, law, n_en),
    )


def _formulation(choice: str, law: AbstractLaw, n_en: int) -> Formulation:
    if choice == "auto":
        nu = [
            np.max(leaf)
            for path, leaf in jax.tree_util.tree_leaves_with_path(law)
            if jax.tree_util.keystr(path).endswith(".nu")
        ]
        stiff = n_en == 10 and any(value >= 0.49 for value in nu)
        return "mean-dilatation" if stiff else "displacement"
    if choice == "displacement":
        return "displacement"
    if choice == "mean-dilatation":
        return "mean-dilatation"
    raise ValueError(
        'formulation must be "auto", "displacement" or "mean-dilatation", '
        f"got {choice!r}."
    )


def _shape_gradients_at(mesh: TetMesh, degree: int) -> tuple[np.ndarray, np.ndarray]:
    """Shape gradients dN_a/dX_J and weights (volume included) at quadrature points."""
    rule = tet_rule(degree)
    reference = shape_gradients(rule.barycentric, mesh.tets.shape[1])
    jacobian = np.einsum("eai,qaj->eqij", mesh.points[mesh.tets], reference)
    dN = np.einsum("qaj,eqji->eqai", reference, np.linalg.inv(jacobian))
    return dN, np.linalg.det(jacobian) / 6.0 * rule.weights
