"""Building a model: shape gradients, sparsity, symbolic analysis."""

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike

from softcal_jax._process import check_process
from softcal_jax._typing import Array, Float, check_untraced, is_traced
from softcal_jax.actuators import AbstractActuator
from softcal_jax.bodies import RigidBody
from softcal_jax.configurations import Mechanism, build_mechanism
from softcal_jax.elements import shape_functions, shape_gradients, tet_rule
from softcal_jax.equilibrium._assembly import shear_moduli
from softcal_jax.equilibrium._element import Formulation
from softcal_jax.equilibrium._linear_solver import AbstractLinearSolver
from softcal_jax.equilibrium._model import (
    Model,
    Shapes,
    check_fields,
    check_law,
    to_blocks,
)
from softcal_jax.equilibrium._solver_choice import NoSolver, solver_kind
from softcal_jax.equilibrium._sparsity import (
    build_reduction,
    build_sparsity,
    destinations,
)
from softcal_jax.equilibrium._without_derivative import refuse_if
from softcal_jax.materials import (
    UNREMARKABLE,
    AbstractLaw,
    SofaCorotational,
    fields_of_tets,
    with_arrays,
)
from softcal_jax.mesh import MeshWarning, TetMesh, check_mesh

# Blocks of tets fit the L1 cache, with the tet index last for vectorisation: the
# corotational law takes twice as long with blocks of 32 as with 16.
BLOCK = 16

LONGEST = 5.0
"""Extent of a mesh above which it is probably in mm: few robots are so long [m]."""


def build_model(
    mesh: TetMesh,
    law: AbstractLaw,
    *,
    density: Float[ArrayLike, "..."],
    bodies: Sequence[RigidBody] = (),
    actuators: Sequence[AbstractActuator] = (),
    formulation: Literal["auto"] | Formulation = "auto",
    solver: str | None = None,
    contact_scale: float | None = None,
    touching: Sequence[tuple[str, str]] = (),
    touching_reach: float | None = None,
    shapes: Mapping[str, Float[ArrayLike, "n_nodes 3"]] | None = None,
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
        actuators: The actuators.
        formulation: How the volume change enters. "auto" takes "mean-dilatation" for
            quadratic tets whose law declares a Poisson's ratio (`POISSON`), of 0.49 or
            more, and "displacement" otherwise; `Model.formulation` says which.
        solver: Sparse direct solver: "pardiso" or "klu" on the CPU, by default that of
            the platform; or "pardiso-host", the default where JAX computes on a GPU
            (extra `gpu`). "none" prepares none: such a model can be looked at, not
            solved.
        contact_scale: Thickness of the cushion between surfaces that touch, see
            `softcal_jax.contact`; the error of contact is in proportion to it. By
            default a two-hundredth of the mean size of the surface's faces [m].
        touching: Pairs of surface groups that may touch each other, without friction,
            like [["upper", "lower"]]; a group twice where it may touch itself.
            Elsewhere contact of the body with itself is only detected.
        touching_reach: How far beside its mirror image on the other surface, as they
            lie at rest, a face may meet it; the tangent couples all that can meet. By
            default twice the mean size of the faces, and a quarter of their distance
            [m].
        shapes: Ways in which the shape may be off, by name: motions of all nodes per
            metre of an offset, as of `surface_motion` [-]. See `fields.shape_offset`.

    Warns:
        MeshWarning: If the mesh is so large that its coordinates may be in mm.

    Raises:
        ValueError: If JAX is not in float64, mesh or density are not sound, a per-tet
            array has the wrong length, a body, an actuator or a shape does not fit the
            mesh, or formulation or solver are unknown or do not suit the law or the
            machine.
        ImportError: If the package of the solver is not installed.
        RuntimeError: If this process was forked from one that had computed.
    """
    check_process()
    kind = solver_kind(solver)
    given = law, density, contact_scale, touching_reach
    check_untraced("a number of the model", given, "law and density", "set_field")
    law = with_arrays(law)
    check_fields(law, mesh.n_tets, density)
    density = _checked_density(density)
    solved = kind is not NoSolver
    _check_length("contact_scale", contact_scale)
    _check_length("touching_reach", touching_reach)
    mechanism = build_mechanism(
        mesh,
        bodies,
        actuators,
        at_rest=solved,
        contact_scale=contact_scale,
        touching=touching,
        touching_reach=touching_reach,
    )
    check_mesh(mesh, linked=_linked(mechanism))
    across = float(np.ptp(mesh.points, axis=0).max())
    if across > LONGEST:
        warnings.warn(
            f"the mesh is {across:.4g} m across. If its coordinates are in mm, say so "
            'where it is read (length_unit = "mm"), or make it of 1e-3 * points.',
            MeshWarning,
            stacklevel=2,
        )
    return _prepared(
        mesh,
        law,
        density=density,
        mechanism=mechanism,
        formulation=_formulation(formulation, law, mesh.order),
        solver=kind,
        shapes=_checked_shapes(shapes or {}, mesh),
    )


def model_for_law(model: Model, law: AbstractLaw) -> Model:
    """Prepare the same robot for another law, with or without a potential.

    `Model.with_law` is cheaper, if the new law has a potential like the old one. A law
    without a potential takes the displacement formulation.

    Raises:
        ValueError: If a per-tet array has the wrong length.
    """
    law = with_arrays(law)
    check_fields(law, model.n_tets)
    return _prepared(
        model.mesh,
        law,
        density=model.density,
        mechanism=model.mechanism,
        formulation=model.formulation if law.conservative else "displacement",
        solver=type(model.solver),
        shapes=model.shapes,
    )


def with_points(model: Model, points: Float[ArrayLike, "n_nodes 3"]) -> Model:
    """Return the same robot with its nodes at other places at rest, differentiably.

    What the mesh carries follows, as if the model were built of it: markers, guides and
    point forces keep their nodes and weights, frames of rigid bodies move with the mean
    of the nodes and carry what is fixed on them; weight, chambers, contact faces, areas
    under actuators and weights of control points are those of the new shape. Tets,
    groups, values of single tets, guides on the ground, obstacles without nodes and the
    scale of contact stay.

    Lanes of the model before serve: they hold weights. Only measured values, weights of
    markers with a `base_radius`, loads by area or length and elastic supports are of
    the points on which lanes were made; the last two raise where points are traced.

    Args:
        model: The model.
        points: Positions of the nodes of the mesh at rest [m].

    Raises:
        ValueError: If the shape is not that of the mesh, a tet is inverted, or the law
            holds edges of the mesh (`SofaCorotational`).
    """
    if np.shape(points) != np.shape(model.mesh.points):
        raise ValueError(
            f"points have the shape {np.shape(points)}; expected that of the nodes of "
            f"the mesh, {np.shape(model.mesh.points)} [m]."
        )
    new = _placed(model, jnp.asarray(points, float))
    inverted = jnp.any(new.weights <= 0.0)
    why = "the new points turn a tet inside out."
    return replace(new, weights=refuse_if(new.weights, inverted, why))


def with_offset(model: Model, shape: int, offset: Float[Array, ""]) -> Model:
    """Return the model with one of its shapes off by so much [m], see `with_points`.

    Where a tet is inside out, weights are nan, so that there is no equilibrium; if
    nothing is traced, that is a ValueError.
    """
    step = offset - model.shapes.offset[shape]
    points = jnp.asarray(model.mesh.points) + step * model.shapes.motion[shape]
    new = _placed(model, points)
    inverted = jnp.any(new.weights <= 0.0)
    if not is_traced(inverted) and inverted:
        raise ValueError(
            f"an offset of {model.shapes.names[shape]!r} by {float(offset):g} m turns "
            "a tet inside out: allow less, or mesh it with longer tets there."
        )
    w = jnp.where(inverted, jnp.nan, new.weights)
    offsets = model.shapes.offset.at[shape].set(offset)
    return eqx.tree_at(lambda m: (m.weights, m.shapes.offset), new, (w, offsets))


def _placed(model: Model, points: Array) -> Model:
    if isinstance(model.law, SofaCorotational):
        raise ValueError(
            "SofaCorotational holds matrices of the edges of its mesh, which do not "
            "follow: build the model anew, with SofaCorotational.of_mesh."
        )
    mesh, mechanism, dN, w, node_volumes = _following(model, points)
    new = replace(
        model,
        mesh=mesh,
        mechanism=mechanism,
        shape_gradients=dN,
        weights=w,
        node_volumes=node_volumes,
    )
    known = lambda old, leaf: isinstance(old, np.ndarray) and not is_traced(leaf)
    on_host = lambda old, leaf: np.asarray(leaf) if known(old, leaf) else leaf
    new = jax.tree.map(on_host, model, new)
    return replace(new, moved=model.moved or is_traced(w))


@eqx.filter_jit
def _following(model: Model, points: Array) -> tuple[Any, ...]:
    """Compute what depends on the points of the mesh."""
    set_points = partial(eqx.tree_at, lambda mesh: mesh.points, model.mesh)
    mechanism = model.mechanism.following(set_points(points))
    # Of one array, so that `check_on` finds both traced or neither.
    mesh = set_points(mechanism.points[: len(points)])
    return mesh, mechanism, *_of_points(mesh)


def _prepared(
    mesh: TetMesh,
    law: AbstractLaw,
    *,
    density: Float[Array, "..."],
    mechanism: Mechanism,
    formulation: Formulation,
    solver: type[AbstractLinearSolver],
    shapes: Shapes,
) -> Model:
    n_tets = mesh.n_tets
    check_law(law, law.conservative, formulation)
    n_blocks = -(-n_tets // BLOCK)
    conservative = law.conservative and mechanism.conservative
    rigid = _within_one_body(mesh, mechanism)
    active = np.arange(n_blocks * BLOCK) < n_tets
    active[:n_tets] &= ~rigid
    curved, touching = mechanism.actuators.clique_nodes(), mechanism.contacts.cliques()
    cliques = (mesh.tets, *curved, *touching)
    pattern = build_sparsity(cliques, len(mechanism.points), symmetric=conservative)
    reduction, unknowns = None, pattern
    if mechanism.bodies.n_bodies > 0:
        deforming = (mesh.tets[~rigid], *curved, *touching)
        reduction = build_reduction(pattern, deforming, mechanism.bodies)
        unknowns = reduction.reduced
    dN, w, node_volumes = _of_points(mesh)
    model = Model(
        mesh=mesh,
        law=law,
        density=density,
        mechanism=mechanism,
        shape_gradients=dN,
        weights=w,
        active=jax.device_put(active.reshape(n_blocks, BLOCK).astype(float)),
        nodes=_blocked(mesh.tets.astype(np.int32)),
        destination=_blocked(destinations(pattern, mesh.tets).T),
        node_volumes=node_volumes,
        pattern=pattern,
        curvature_at=tuple(destinations(pattern, nodes) for nodes in curved),
        contact_at=tuple(destinations(pattern, nodes) for nodes in touching),
        reduction=reduction,
        solver=solver.analyse(unknowns),
        shapes=shapes,
        formulation=formulation,
    )
    if not touching:
        return model
    E = 3.0 * jnp.mean(shear_moduli(model))  # of a body that keeps its volume
    return eqx.tree_at(lambda m: m.mechanism.contacts.stiffness, model, E)


def _checked_shapes(shapes: Mapping[str, Any], mesh: TetMesh) -> Shapes:
    of_mesh, n = mesh.points.shape, len(shapes)
    for name, motion in shapes.items():
        fits = np.shape(motion) == of_mesh and np.isfinite(motion).all()
        if not (fits and np.any(motion)):
            raise ValueError(
                f"shape {name!r} must be a finite motion, not zero, with the shape "
                f"{of_mesh} of the nodes of the mesh; got {np.shape(motion)}."
            )
    motions = np.reshape([*shapes.values()], (n, *of_mesh)).astype(float)
    of_arrays = jax.device_put((motions, np.zeros(n)))
    return Shapes(of_arrays[0], of_arrays[1], names=tuple(shapes))


def _check_length(name: str, length: float | None) -> None:
    if length is not None and not 0.0 < length < np.inf:
        raise ValueError(f"{name} must be positive and finite [m], got {length:g}.")


def _linked(mechanism: Mechanism) -> list[np.ndarray]:
    """Return sets of nodes that something links.

    That is each body, motors on the ground, or surfaces that may touch each other.
    """
    bodies = mechanism.bodies
    owner = bodies.owner[bodies.body]
    driven = np.isin(owner, mechanism.actuators.motor_body)
    sets = [bodies.attached[(owner == k) & ~driven] for k in range(bodies.n_bodies)]
    touching = mechanism.contacts.touching
    if touching is not None:
        names = range(len(touching.names))
        sets += [touching.cliques()[touching.of == k].ravel() for k in names]
    return [nodes for nodes in (bodies.attached[driven], *sets) if nodes.size]


def _within_one_body(mesh: TetMesh, mechanism: Mechanism) -> np.ndarray:
    """Flag the tets whose nodes all belong to one rigid body."""
    body = np.full(mesh.n_nodes, -1)
    body[mechanism.bodies.attached] = mechanism.bodies.body
    of_tet = body[mesh.tets]
    return (of_tet[:, 0] >= 0) & np.all(of_tet == of_tet[:, :1], axis=1)


def _checked_density(density: Float[ArrayLike, "..."]) -> Float[Array, "..."]:
    density = jnp.asarray(density, float)
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
        locking = (
            np.max(np.asarray(leaf)) >= kind.locks
            for _, leaf, declared in fields_of_tets(law)
            if (kind := declared.get("kind", UNREMARKABLE)).locks < np.inf
        )
        return "mean-dilatation" if order == 2 and any(locking) else "displacement"
    if choice in ("displacement", "mean-dilatation"):
        return choice
    raise ValueError(
        'formulation must be "auto", "displacement" or "mean-dilatation", '
        f"got {choice!r}."
    )


def _blocked(per_tet: Any) -> Array:
    xp: Any = np if isinstance(per_tet, np.ndarray) else jnp
    n_blocks = -(-len(per_tet) // BLOCK)
    cut = to_blocks(per_tet, len(per_tet), n_blocks, BLOCK)
    # Put on the device rather than converted there, which compiles for each shape.
    return jax.device_put(xp.moveaxis(cut, 1, -1))


def _of_points(mesh: TetMesh) -> tuple[Array, Array, Array]:
    """Compute shape gradients and weights, in blocks, and the volumes of nodes."""
    linear, n_en = mesh.order == 1, mesh.tets.shape[1]
    dN, w = _shape_gradients_at(mesh, degree=1 if linear else 2)
    degree = 2 if linear else 4
    N = shape_functions(tet_rule(degree).barycentric, n_en)
    _, w_load = _shape_gradients_at(mesh, degree)
    return _blocked(dN), _blocked(w), jax.device_put(w_load @ N)


def _shape_gradients_at(mesh: TetMesh, degree: int) -> tuple[Any, Any]:
    """Compute shape gradients dN_a/dX_J and weights, volume included."""
    xp: Any = np if isinstance(mesh.points, np.ndarray) else jnp
    rule = tet_rule(degree)
    reference = shape_gradients(rule.barycentric, mesh.tets.shape[1])
    jacobian = xp.einsum("eai,qaj->eqij", mesh.points[mesh.tets], reference)
    dN = xp.einsum("qaj,eqji->eqai", reference, xp.linalg.inv(jacobian))
    return dN, xp.linalg.det(jacobian) / 6.0 * rule.weights[None]
