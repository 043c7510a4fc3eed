"""Whether parameters fit the model they are to calibrate."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._typing import HostArray
from softcal_jax.fields._model_fields import find_field
from softcal_jax.fields._parameters import Parameter
from softcal_jax.fields._setup import SetupParameter
from softcal_jax.fields._space import Entry, ParameterSpace
from softcal_jax.fields._spread import ControlPointParameters
from softcal_jax.materials import is_point_values


def check_parameters(model: Any, space: ParameterSpace) -> None:
    """Raise unless every parameter sets something of its own, within sound bounds.

    Args:
        model: Anything with `law`, `density` and `mesh`, on the host.
        space: The parameters.

    Raises:
        ValueError: If a field or region does not exist, two parameters set the same
            tets, a parameter without region would flatten constants that differ over
            the body, a control point lies far from what it acts on or acts on no tet,
            the start breaks the order, or a bound is outside the range of the material.
    """
    owners: dict[str, HostArray] = {}
    for number, entry in enumerate(space.entries):
        if isinstance(entry, SetupParameter):
            entry.check(model)
            continue
        if isinstance(entry, ControlPointParameters):
            _check_control_points(model, entry)
        else:
            _check_not_flattened(model, entry)
        find_field(model, entry.field)
        owner = owners.setdefault(entry.field, np.full(model.mesh.n_tets, -1))
        tets = _tets(model, entry)
        taken = tets[owner[tets] >= 0]
        if taken.size:
            other = space.entries[owner[taken[0]]]
            raise ValueError(
                f"parameters {_label(other)!r} and {_label(entry)!r} both set "
                f"{entry.field} of tet {taken[0]}: give them regions that do not "
                "overlap."
            )
        owner[tets] = number
    _check_order(space)
    for side, z in (("lower", space.lower()), ("upper", space.upper())):
        applied = space.apply(model, z)
        try:
            for law in _laws(applied.law):
                _check_constants(law)
            if not bool(jnp.all(applied.density >= 0.0)):
                raise ValueError("density must not be negative [kg/m3].")
        except ValueError as error:
            raise ValueError(
                f"with all parameters at their {side} bound: {error}"
            ) from (error)


def _label(entry: Entry) -> str:
    if isinstance(entry, Parameter):
        return entry.name
    if isinstance(entry, SetupParameter):
        return entry.parameter.name
    return f"{entry.field} of {', '.join(entry.control_points.names)}"


def _tets(model: Any, entry: Parameter | ControlPointParameters) -> HostArray:
    if entry.region is None:
        return np.arange(model.mesh.n_tets)
    return np.asarray(model.mesh.tets_of(entry.region))


def _check_not_flattened(model: Any, parameter: Parameter) -> None:
    value = find_field(model, parameter.field)(model)
    values = np.asarray(value.values if is_point_values(value) else value)
    if parameter.region is None and values.ndim and np.ptp(values) > 0:
        raise ValueError(
            f"parameter {parameter.name!r} would give the whole body one value of "
            f"{parameter.field}, which now lies between {values.min():g} and "
            f"{values.max():g}. Name the tet group it is for in `region`."
        )


def _check_control_points(model: Any, entry: ControlPointParameters) -> None:
    """Raise unless every control point lies near the body and acts on it."""
    points, mesh = entry.control_points, model.mesh
    if entry.sampling == "quadrature" and entry.field == "density":
        raise ValueError(
            'density is one number per tet: give sampling="centroids" for it.'
        )
    nodes = mesh.points[np.unique(mesh.tets[_tets(model, entry)])][:, points.columns]
    diagonal = float(np.linalg.norm(np.ptp(nodes, axis=0)))
    reach = 0.1 * diagonal if points.max_distance is None else points.max_distance
    # Nodes stand for the body: inside a coarse tet none is near.
    edges = mesh.points[mesh.tets[:, :4]][:, :, points.columns]
    coarse = float(np.max(np.linalg.norm(np.ptp(edges, axis=1), axis=1)))
    positions = np.asarray(points.positions)[:, points.columns]
    for name, x in zip(points.names, positions, strict=True):
        distance = float(np.min(np.linalg.norm(nodes - x, axis=1)))
        if distance > max(reach, 0.5 * coarse):
            where = "the body" if entry.region is None else f"{entry.region!r}"
            raise ValueError(
                f"control point {name!r} of {entry.field} lies {distance:.3g} m from "
                f"{where}, more than max_distance, {reach:.3g} m. Check its unit and "
                "frame, or raise max_distance."
            )
    sampled = np.asarray(entry.points(mesh)).reshape(-1, 3)
    strongest = np.asarray(points.weights(sampled)).max(axis=0)
    for name, weight in zip(points.names, strongest, strict=True):
        if weight == 0.0 and name not in entry.fixed:
            why = f"has others nearer, and nearest is {points.nearest}"
            remedy = "Raise `nearest`"
            if points.nearest is None:
                why = f"is nearer to others, with power {points.power:g}"
                remedy = "Lower `power`"
            raise ValueError(
                f"control point {name!r} of {entry.field} acts on no tet: every tet "
                f"{why}. {remedy}, or move it."
            )


def _check_order(space: ParameterSpace) -> None:
    """Raise unless the start keeps the order and the bounds leave room for it."""
    A, b = space.order_rows()
    excess = np.asarray(A @ space.start() - b)
    best = np.asarray(
        jnp.minimum(A * space.lower()[None], A * space.upper()[None]).sum(axis=1) - b
    )
    order = "order asks for {0} <= {1}: start with equal or ordered values"
    axes = (
        "axes names the smaller modulus first: swap the two there, or start with equal "
        "or ordered values"
    )
    given = zip(space.order_names(), excess, best, strict=True)
    pairs = [(*pair, order) for pair in given]
    if space.chart is not None:
        names, z = space.names, np.asarray(space.start())
        low, high = np.asarray(space.lower()), np.asarray(space.upper())
        for s, l in zip(space.chart.small, space.chart.large, strict=True):
            # The two moduli must be able to differ.
            least = np.inf if low[s] >= high[l] else 0.0
            pairs.append(((names[s], names[l]), z[s] - z[l], least, axes))
    for (small, large), over, least, rule in pairs:
        if least > 1e-12:
            raise ValueError(
                f"the bounds leave no room for {small} <= {large}: lower the bounds of "
                "the first, or raise those of the second."
            )
        if over > 1e-12:
            raise ValueError(
                f"the start has {small} above {large}, but {rule.format(small, large)}."
            )


def _laws(law: Any) -> list[Any]:
    """The law as it is; at each quadrature point where it differs between them."""
    leaves = jax.tree.leaves(law, is_leaf=is_point_values)
    n_qp = max([v.values.shape[1] for v in leaves if is_point_values(v)], default=1)
    return [
        jax.tree.map(
            lambda v, q=q: v.values[:, q] if is_point_values(v) else v,
            law,
            is_leaf=is_point_values,
        )
        for q in range(n_qp)
    ]


def _check_constants(module: eqx.Module) -> None:
    """Run the checks of a law, and of the modules in it, as at construction."""
    check = getattr(module, "__check_init__", None)
    if check is not None:
        check()
    for value in vars(module).values():
        if isinstance(value, eqx.Module):
            _check_constants(value)
