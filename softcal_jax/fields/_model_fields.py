"""The fields of a model by name: constants of its law, and its density."""

import operator
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike

from softcal_jax._typing import Float, HostArray
from softcal_jax.materials import PointValues, is_point_values


def set_field(
    model: Any,
    field: str,
    value: Float[ArrayLike, "..."] | PointValues,
    region: str | None = None,
) -> Any:
    """Change one field of a model; traceable and differentiable.

    Args:
        model: Anything with `law`, `density` and `mesh`.
        field: Name of a field of the law, like "E", or "density".
        value: New value in SI units: one for all, one per tet of the region, or
            `PointValues` for these tets.
        region: Tet group that it applies to; the whole mesh by default.

    Returns:
        The changed model.

    Raises:
        ValueError: If the field or the region does not exist, or the field is not
            unique.
    """
    where = find_field(model, field)
    old = where(model)
    if isinstance(value, PointValues):
        return eqx.tree_at(where, model, _in_region(model, old, value, region))
    new = jnp.asarray(value, float)
    if region is not None:
        tets = model.mesh.tets_of(region)
        if is_point_values(old):
            points = jnp.broadcast_to(
                new.reshape(-1, 1), (len(tets), old.values.shape[1])
            )
            new = PointValues(old.values.at[tets].set(points))
        else:
            per_tet = jnp.broadcast_to(old, (model.mesh.n_tets,))
            new = per_tet.at[tets].set(new)
    elif not is_point_values(old):
        new = jnp.broadcast_to(new, jnp.broadcast_shapes(new.shape, jnp.shape(old)))
    return eqx.tree_at(where, model, new)


def _in_region(model: Any, old: Any, value: PointValues, region: str | None):
    if region is None:
        return value
    if is_point_values(old):
        everywhere = old.values
    else:
        per_tet = jnp.broadcast_to(old, (model.mesh.n_tets,))
        shape = (model.mesh.n_tets, value.values.shape[1])
        everywhere = jnp.broadcast_to(per_tet[:, None], shape)
    tets = model.mesh.tets_of(region)
    return PointValues(everywhere.at[tets].set(value.values))


def region_tets(mesh: Any, region: str | None) -> HostArray:
    """Return the indices of the tets of a region; of all tets without one."""
    if region is None:
        return np.arange(mesh.n_tets)
    return np.asarray(mesh.tets_of(region))


def find_field(model: Any, field: str):
    """Find a field of a model's law, or its density, by name.

    Args:
        model: Anything with `law` and `density`.
        field: Name of the field, like "E"; a dotted path if the name is not unique.

    Returns:
        A function from a model to that array, as `eqx.tree_at` expects it.

    Raises:
        ValueError: If no field has that name, or more than one.
    """
    paths = ["density"] + [
        "law" + jax.tree_util.keystr(path)
        for path, _ in jax.tree_util.tree_leaves_with_path(
            model.law, is_leaf=is_point_values
        )
    ]
    found = [path for path in paths if ("." + path).endswith("." + field)]
    if len(found) != 1:
        problem = "is not unique" if found else "does not exist"
        raise ValueError(
            f"field {field!r} of the model {problem}; it has {', '.join(paths)}."
        )

    return _Accessor(found[0])


@dataclass(frozen=True)
class _Accessor:
    """Accessor by dotted path; hashable, so equal ones share compiled programs."""

    path: str

    def __call__(self, model: Any) -> Any:
        return operator.attrgetter(self.path)(model)
