"""Constants of a law that differ between the quadrature points of a tet."""

from typing import Any

import equinox as eqx
import jax

from softcal_jax._typing import Array, Float


class PointValues(eqx.Module):
    """One value per tet and quadrature point, in place of a constant of a law.

    Attributes:
        values: The values by tet, then by the points of `Model.shape_gradients`.
    """

    values: Float[Array, "*tets n_qp"]


def is_point_values(leaf: Any) -> bool:
    """Say whether a constant of a law is given per quadrature point."""
    return isinstance(leaf, PointValues)


def law_at_points(law: Any) -> tuple[Any, Any]:
    """Replace `PointValues` by arrays, and return the axes for `vmap` over the points.

    Args:
        law: The law of one tet.

    Returns:
        The law, and a tree of its structure: 0 for values per point, else None.
    """
    plain = jax.tree.map(
        lambda leaf: leaf.values if is_point_values(leaf) else leaf,
        law,
        is_leaf=is_point_values,
    )
    axes = jax.tree.map(
        lambda leaf: 0 if is_point_values(leaf) else None, law, is_leaf=is_point_values
    )
    return plain, axes
