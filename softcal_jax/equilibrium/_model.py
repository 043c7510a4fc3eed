"""The finite-element model of a robot: mesh, law, density, ready for assembly."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike, Shaped

from softcal_jax._module import Module
from softcal_jax._process import check_process
from softcal_jax._typing import Array, Float, HostArray, Int
from softcal_jax.actuators import AbstractActuator, clique_nodes
from softcal_jax.bodies import RigidBody
from softcal_jax.configurations import Mechanism, build_mechanism
from softcal_jax.elements import shape_functions, shape_gradients, tet_rule
from softcal_jax.equilibrium._element import Formulation
from softcal_jax.equilibrium._linear_solver import AbstractLinearSolver
from softcal_jax.equilibrium._no_solver import NO_SOLVER
from softcal_jax.equilibrium._solver_choice import (
    check_solver,
    choose_solver,
    same_solver,
)
from softcal_jax.equilibrium._sparsity import (
    Reduction,
    Sparsity,
    build_reduction,
    build_sparsity,
    destinations,
)
from softcal_jax.materials import AbstractLaw, PointValues, is_point_values
from softcal_jax.mesh import Refinement, TetMesh, check_mesh, finer, volumes

# Blocks of tets fit the L1 cache, with the tet index last for vectorisation: the
# corotational law takes twice as long with blocks of 32 as with 16.
BLOCK = 16


class Model(Module):
    """A mesh with its law and mechanism; its arrays are traced arguments of the solver.

    Attributes:
        mesh: The mesh [m].
        law: Constitutive law; its arrays hold one value, or one per tet.
        density: Mass density, one value or one per tet [kg/m3].
        mechanism: Rigid bodies and actuators.
        active: 1 for each tet; 0 for copies that pad the last block, and for tets
            whose nodes all belong to one rigid body.
        pattern: Sparsity of the tangent over all nodes.
        curvature_at: Positions in the pattern of the actuators' tangents.
        reduction: How the tangent is reduced to the unknowns; None without bodies.
        solver: Sparse solver for the unknowns.
        formulation: "displacement" or "mean-dilatation"; see `build_model`.
    """

    mesh: TetMesh
    law: AbstractLaw
    density: Float[Array, "..."]
    mechanism: Mechanism
    shape_gradients: Float[Array, "n_blocks n_qp n_en 3 block"]
    weights: Float[Array, "n_blocks n_qp block"]
    active: Float[Array, "n_blocks block"]
    nodes: Int[Array, "n_blocks n_en block"]
    destination: Int[Array, "n_blocks n_entries block"]
    node_volumes: Float[Array, "n_tets n_en"]
    pattern: Sparsity
    curvature_at: tuple[Int[HostArray, "_ _"], ...]
    reduction: Reduction | None
    solver: AbstractLinearSolver
    formulation: Formulation = eqx.field(static=True)

    def _words(self) -> str:
        bodies, actuators = self.mechanism.bodies, self.mechanism.actuators
        parts = [f"rigid body {name}" for name in bodies.names]
        named = zip(actuators.kinds, actuators.names, strict=True)
        parts += [f"{kind.noun} {name}" for kind, name in named]
        return ", ".join([self.mesh.words, type(self.law).__name__, *parts])

    @property
    def n_points(self) -> int:
        """Number of nodes, those of the rigid bodies' frames included."""
        return self.mechanism.points.shape[0]

    @property
    def n_dof(self) -> int:
        """Number of unknowns: three per node, held or free, and six per rigid body."""
        return self.solver.sparsity.n_dof

    @property
    def with_multiplier(self) -> Int[HostArray, " n_m"]:
        """Indices of the actuators whose force may be unknown: their motion is imposed.

        Motors are left out: an imposed angle holds the body itself.
        """
        actuators = self.mechanism.actuators
        motor = np.array(actuators.motor_body) >= 0
        return np.flatnonzero(actuators.has_displacement & ~motor)

    def among_all(self, values: Float[Array, "*b n_m"]) -> Float[Array, "*b n_a"]:
        """Expand values of the actuators `with_multiplier` to all, 0 elsewhere."""
        none = jnp.zeros((*values.shape[:-1], self.mechanism.n_actuators), values.dtype)
        return none.at[..., self.with_multiplier].set(values, unique_indices=True)

    def positions(self, u: Float[Array, "n_points 3"]) -> Float[Array, "n_points 3"]:
        """Return the positions of all nodes [m]."""
        return jnp.asarray(self.mechanism.points) + u

    def displacements(self, u: Float[Array, "n_points 3"]) -> Float[Array, " n_a"]:
        """Return the displacements delta_a of the actuators."""
        return self.mechanism.displacements(self.positions(u))

    @property
    def n_tets(self) -> int:
        """Number of tets."""
        return self.mesh.tets.shape[0]

    @property
    def mass(self) -> float:
        """Mass of all tets and rigid bodies [kg]."""
        tets = np.asarray(self.density) * volumes(self.mesh)
        return float(np.sum(tets) + np.sum(np.asarray(self.mechanism.bodies.mass)))

    @property
    def conservative(self) -> bool:
        """Whether a potential exists, so that the tangent is symmetric.

        Without one, the solver takes the full tangent, Newton reduces the residual, and
        negative eigenvalues do not tell whether a state is stable.
        """
        return self.solver.sparsity.symmetric

    def with_law(self, law: AbstractLaw) -> "Model":
        """Return the model with another law, of the same or another class.

        Raises:
            ValueError: If a per-tet array has the wrong length, or the law has no
                potential and the model was built for one that has.
        """
        _check_fields(law, self.n_tets)
        check_law(law, self.conservative, self.formulation)
        return eqx.tree_at(lambda m: m.law, self, law)

    def tabulated(self) -> "Model":
        """Return the model with all that does not depend on its shape precomputed."""
        law = jax.lax.optimization_barrier(self.law.tabulated())
        return eqx.tree_at(lambda m: m.law, self, law)

    def law_blocks(self) -> AbstractLaw:
        """Return the law with per-tet arrays cut into blocks for the assembly."""
        n_blocks, _, block = self.weights.shape
        cut = lambda leaf: to_blocks(leaf, self.n_tets, n_blocks, block)
        return jax.tree.map(cut, self.law)


def to_blocks(
    leaf: Shaped[Array | HostArray, "..."], n_tets: int, n_blocks: int, block: int
) -> Shaped[Array | HostArray, "n_blocks block ..."]:
    """Cut per-tet values into blocks; a single value is repeated for all tets.

    An array of the host stays there, where each shape need not be compiled.
    """
    xp: Any = np if isinstance(leaf, np.ndarray) else jnp
    if leaf.ndim == 0:
        return xp.broadcast_to(leaf, (n_blocks, block))
    pad = n_blocks * block - n_tets
    filled = xp.concatenate([leaf, xp.broadcast_to(leaf[:1], (pad, *leaf.shape[1:]))])
    return filled.reshape(n_blocks, block, *leaf.shape[1:])


def _check_fields(law: AbstractLaw, n_tets: int) -> None:
    for path, leaf in jax.tree_util.tree_leaves_with_path(law):
        if jnp.ndim(leaf) > 0 and jnp.shape(leaf)[0] != n_tets:
            raise ValueError(
                f"law{jax.tree_util.keystr(path)} has shape {jnp.shape(leaf)}; "
                f"expected one value, or one per tet: the mesh has {n_tets} tets."
            )


def check_law(law: AbstractLaw, conservative: bool, formulation: Formulation) -> None:
    """Raise unless the law has the potential that tangent or formulation requires."""
    name = type(law).__name__
    if conservative and not law.conservative:
        raise ValueError(
            f"{name} has no potential, so its tangent is not symmetric, but the model "
            "was built for a law that has one; call build_model with this law."
        )
    if formulation == "mean-dilatation" and not law.conservative:
        raise ValueError(
            f'formulation "mean-dilatation" needs a potential, and {name} has none; '
            'take formulation="displacement", or a law with a potential.'
        )


def build_model(
    mesh: TetMesh,
    law: AbstractLaw,
    *,
    density: Float[ArrayLike, "..."],
    bodies: Sequence[RigidBody] = (),
    actuators: Sequence[AbstractActuator] = (),
    formulation: Literal["auto"] | Formulation = "auto",
    solver: str | None = None,
) -> Model:
    """Prepare a model for equilibrium: shape gradients, sparsity, symbolic analysis.

    Element: use quadratic tets (`to_quadratic`) for anything that bends; linear tets
    lock, and their calibrated moduli depend on the mesh. Formulation of quadratic tets:
    "displacement" is slightly too stiff but more accurate up to nu = 0.45;
    "mean-dilatation" is slightly too soft but more accurate from nu = 0.49 on
    (`python -m benchmarks run locking`).

    A law without a potential (`ClassicalCorotational`) or a `SurfacePressure` makes the
    model not `conservative`: solving costs more, and stability remains unknown.

    Args:
        mesh: The mesh [m], linear or quadratic.
        law: Constitutive law; its arrays hold one value, or one per tet.
        density: Mass density, one value or one per tet [kg/m3].
        bodies: The rigid bodies.
        actuators: Cables, chambers, motors and other actuators.
        formulation: How the volume change enters. "auto" takes "mean-dilatation" for
            quadratic tets whose law has a Poisson's ratio `nu` of 0.49 or more, and
            "displacement" otherwise; `Model.formulation` says which.
        solver: Sparse direct solver: "pardiso" or "klu" on the CPU, by default that of
            the platform; or "pardiso-host", the default where JAX computes on a GPU
            (extra `gpu`). "none" prepares none: such a model can be looked at, not
            solved.

    Raises:
        ValueError: If JAX is not in float64, the mesh is not sound, the density is
            negative, a per-tet array has the wrong length, a body or an actuator does
            not fit the mesh, the formulation is unknown or needs a potential that the
            law lacks, or the solver is unknown or cannot run where JAX computes.
        ImportError: If the package of the solver is not installed.
        RuntimeError: If this process was forked from one that had computed.
    """
    check_process()
    check_solver(solver)
    _check_fields(law, mesh.n_tets)
    density = _checked_density(density, mesh.n_tets)
    solved = solver != NO_SOLVER
    mechanism = build_mechanism(mesh, bodies, actuators, at_rest=solved)
    check_mesh(mesh, linked=_linked(mechanism))
    return _prepared(
        mesh,
        law,
        density=density,
        mechanism=mechanism,
        formulation=_formulation(formulation, law, mesh.order),
        solver=partial(choose_solver, solver),
    )


def refined_model(model: Model) -> tuple[Model, Refinement]:
    """Prepare the same robot on a finer mesh, see `Refinement`.

    Linear tets become quadratic, in the formulation that `build_model` chooses for
    them; quadratic ones keep theirs. A tet has the constants of the one it is part of.
    """
    refinement = finer(model.mesh)
    parent = refinement.parent

    def spread(leaf: Any) -> Any:
        if isinstance(leaf, PointValues):
            nearest = np.asarray(leaf.values)[parent[:, None], refinement.nearest_point]
            return PointValues(jax.device_put(nearest))
        if jnp.ndim(leaf) == 0:
            return leaf
        return jax.device_put(np.asarray(leaf)[parent])

    law = jax.tree.map(spread, model.law, is_leaf=is_point_values)
    raised = model.mesh.order == 1 and law.conservative
    fine = _prepared(
        refinement.mesh,
        law,
        density=spread(model.density),
        mechanism=model.mechanism.refined(refinement),
        formulation=_formulation("auto", law, 2) if raised else model.formulation,
        solver=partial(same_solver, model.solver),
    )
    return fine, refinement


def model_for_law(model: Model, law: AbstractLaw) -> Model:
    """Prepare the same robot for another law, with or without a potential.

    Where only constants change, or the law has a potential as before,
    `Model.with_law` does the same at no cost. A law without a potential takes the
    displacement formulation.

    Raises:
        ValueError: If a per-tet array has the wrong length.
    """
    _check_fields(law, model.n_tets)
    return _prepared(
        model.mesh,
        law,
        density=model.density,
        mechanism=model.mechanism,
        formulation=model.formulation if law.conservative else "displacement",
        solver=partial(same_solver, model.solver),
    )


def _prepared(
    mesh: TetMesh,
    law: AbstractLaw,
    *,
    density: Float[Array, "..."],
    mechanism: Mechanism,
    formulation: Formulation,
    solver: Callable[[Sparsity], AbstractLinearSolver],
) -> Model:
    """Assemble a model of parts that fit each other, see `build_model`."""
    n_tets, n_en = mesh.tets.shape
    check_law(law, law.conservative, formulation)
    n_blocks = -(-n_tets // BLOCK)
    # Put on the device rather than converted there, which compiles for each shape.
    cut = lambda per_tet: np.asarray(to_blocks(per_tet, n_tets, n_blocks, BLOCK))
    blocked = lambda per_tet: jax.device_put(np.moveaxis(cut(per_tet), 1, -1))
    dN, w = _shape_gradients_at(mesh, degree=1 if n_en == 4 else 2)
    conservative = law.conservative and mechanism.actuators.symmetric
    rigid = _within_one_body(mesh, mechanism)
    active = np.arange(n_blocks * BLOCK) < n_tets
    active[:n_tets] &= ~rigid
    curved = clique_nodes(mechanism.actuators)
    cliques = (mesh.tets, *curved)
    pattern = build_sparsity(cliques, len(mechanism.points), symmetric=conservative)
    reduction, unknowns = None, pattern
    if mechanism.bodies.n_bodies > 0:
        deforming = (mesh.tets[~rigid], *curved)
        reduction = build_reduction(pattern, deforming, mechanism.bodies)
        unknowns = reduction.reduced
    rule = tet_rule(2 if n_en == 4 else 4)
    _, w_load = _shape_gradients_at(mesh, degree=2 if n_en == 4 else 4)
    node_volumes = w_load @ shape_functions(rule.barycentric, n_en)
    return Model(
        mesh=mesh,
        law=law,
        density=density,
        mechanism=mechanism,
        shape_gradients=blocked(dN),
        weights=blocked(w),
        active=jax.device_put(active.reshape(n_blocks, BLOCK).astype(float)),
        nodes=blocked(mesh.tets.astype(np.int32)),
        destination=blocked(destinations(pattern, mesh.tets).T),
        node_volumes=jax.device_put(node_volumes),
        pattern=pattern,
        curvature_at=tuple(destinations(pattern, nodes) for nodes in curved),
        reduction=reduction,
        solver=solver(unknowns),
        formulation=formulation,
    )


def _linked(mechanism: Mechanism) -> list[np.ndarray]:
    """Return the nodes that each body, or the ground by motors, holds together."""
    bodies = mechanism.bodies
    owner = bodies.owner[bodies.body]
    driven = np.isin(owner, mechanism.actuators.motor_body)
    sets = [bodies.attached[(owner == k) & ~driven] for k in range(bodies.n_bodies)]
    return [nodes for nodes in (bodies.attached[driven], *sets) if nodes.size]


def _within_one_body(mesh: TetMesh, mechanism: Mechanism) -> np.ndarray:
    """Flag the tets whose nodes all belong to one rigid body."""
    body = np.full(mesh.n_nodes, -1)
    body[mechanism.bodies.attached] = mechanism.bodies.body
    of_tet = body[mesh.tets]
    return (of_tet[:, 0] >= 0) & np.all(of_tet == of_tet[:, :1], axis=1)


def _checked_density(
    density: Float[ArrayLike, "..."], n_tets: int
) -> Float[Array, "..."]:
    density = jnp.asarray(density, float)
    if density.ndim > 0 and density.shape != (n_tets,):
        raise ValueError(
            f"density must be one value or one per tet, shape ({n_tets},), "
            f"got shape {density.shape}."
        )
    bad = np.atleast_1d(density)[~(np.atleast_1d(density) >= 0) | np.isinf(density)]
    if bad.size:
        raise ValueError(
            f"density must be finite and not negative [kg/m3], got {bad[0]:g}."
        )
    return density


def _formulation(
    choice: Literal["auto"] | Formulation, law: AbstractLaw, order: int
) -> Formulation:
    if choice == "auto":
        nu = [
            np.max(np.asarray(leaf))
            for path, leaf in jax.tree_util.tree_leaves_with_path(law)
            if jax.tree_util.keystr(path).endswith(".nu")
        ]
        stiff = order == 2 and any(value >= 0.49 for value in nu)
        return "mean-dilatation" if stiff else "displacement"
    if choice in ("displacement", "mean-dilatation"):
        return choice
    raise ValueError(
        'formulation must be "auto", "displacement" or "mean-dilatation", '
        f"got {choice!r}."
    )


def _shape_gradients_at(mesh: TetMesh, degree: int) -> tuple[np.ndarray, np.ndarray]:
    """Compute shape gradients dN_a/dX_J and weights, volume included."""
    rule = tet_rule(degree)
    reference = shape_gradients(rule.barycentric, mesh.tets.shape[1])
    jacobian = np.einsum("eai,qaj->eqij", mesh.points[mesh.tets], reference)
    dN = np.einsum("qaj,eqji->eqai", reference, np.linalg.inv(jacobian))
    return dN, np.linalg.det(jacobian) / 6.0 * rule.weights
