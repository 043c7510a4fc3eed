"""The fields of a model by name: constants of its law, and its density."""

import operator
from collections.abc import Iterator
from dataclasses import dataclass, fields, is_dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike

from softcal_jax._typing import Float, HostArray, is_traced
from softcal_jax.materials import UNREMARKABLE, ConstantKind, fields_of_tets


def set_field(
    model: Any, field: str, value: Float[ArrayLike, "..."], region: str | None = None
) -> Any:
    """Change one field of a model; traceable and differentiable.

    Args:
        model: Anything with `law`, `density` and `mesh`.
        field: Name of a field of the law, like "E", or "density".
        value: New value in SI units: one for all, or one per tet of the region.
        region: Tet group that it applies to; the whole mesh by default.

    Raises:
        ValueError: If the field or the region does not exist, the field is not unique,
            or there are neither one value nor as many as tets.
    """
    where = find_field(model, field)
    old = where(model)
    new = jnp.asarray(value, float)
    mesh = model.mesh
    n_tets = mesh.n_tets if region is None else len(mesh.tets_of(region))
    if new.shape not in ((), (n_tets,)):
        of = "the mesh" if region is None else f"region {region!r}"
        raise ValueError(
            f"{field} has shape {new.shape}; expected one value, or one per tet: {of} "
            f"has {n_tets} tets."
        )
    if region is None:
        new = jnp.broadcast_to(new, jnp.broadcast_shapes(new.shape, jnp.shape(old)))
    elif is_traced(old) or is_traced(new):
        new = jnp.broadcast_to(old, (mesh.n_tets,)).at[mesh.tets_of(region)].set(new)
    else:
        # What is known is changed on the host, where nothing is compiled.
        values = np.broadcast_to(old, (mesh.n_tets,)).copy()
        values[np.asarray(mesh.tets_of(region))] = new
        new = jax.device_put(values)
    return eqx.tree_at(where, model, new)


def region_tets(mesh: Any, region: str | None) -> HostArray:
    """Return the indices of the tets of a region; of all tets without one."""
    if region is None:
        return np.arange(mesh.n_tets)
    return np.asarray(mesh.tets_of(region))


def find_field(model: Any, field: str):
    """Return the function from a model to a field of its law, or to its density.

    The name is like "E", or a dotted path if that is not unique.

    Raises:
        ValueError: If no field has that name, or more than one.
    """
    paths = [path for path, _ in constants_of(model)]
    named = [path for path in paths if ("." + path).endswith("." + field)]
    if len(named) != 1:
        problem = "is not unique" if named else "does not exist"
        if hasattr(model.law, field):
            problem = (
                "is shared by all tets as it is, so it is changed by eqx.tree_at and "
                "is no parameter"
            )
        raise ValueError(
            f"field {field!r} of the model {problem}; it has {', '.join(paths)}."
        )
    return _Accessor(named[0])


def constants_of(model: Any) -> Iterator[tuple[str, ConstantKind]]:
    """List paths and kinds of the constants of a model: of its law, and its density."""
    of_law = ["law" + path for path, _ in fields_of_tets(model.law)]
    for path in [*of_law, "density"]:
        if "[" in path:  # of a tuple, like the local axes of a fibre
            continue
        owner, _, name = ("." + path).rpartition(".")
        owner = operator.attrgetter(owner[1:])(model) if owner else model
        declared = fields(owner) if is_dataclass(owner) else ()
        kinds = {f.name: f.metadata.get("kind") for f in declared}
        yield path, kinds.get(name) or UNREMARKABLE


def kind_of(model: Any, field: str) -> ConstantKind:
    """Return the kind of a field that `find_field` finds."""
    return dict(constants_of(model))[find_field(model, field).path]


@dataclass(frozen=True)
class _Accessor:
    """Accessor by dotted path; hashable, so equal ones share compiled programs."""

    path: str

    def __call__(self, model: Any) -> Any:
        return operator.attrgetter(self.path)(model)
