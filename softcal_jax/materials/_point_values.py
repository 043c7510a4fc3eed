"""A constant of a law that differs between the quadrature points of a tet."""

from typing import Any

import equinox as eqx
import jax

from softcal_jax._typing import Array, Float


class PointValues(eqx.Module):
    """One value per tet and quadrature point, in the place of a constant of a law.

    Attributes:
        values: The values; tets first, then the points of `Model.shape_gradients`.
    """

    values: Float[Array, "*tets n_qp"]


def is_point_values(leaf: Any) -> bool:
    """Whether a constant of a law is given per quadrature point."""
    return isinstance(leaf, PointValues)


def law_at_points(law: Any) -> tuple[Any, Any]:
    """A law with plain arrays, and the axes along which `vmap` runs over the points.

    Args:
        law: The law of one tet.

    Returns:
        The law, and a tree of its shape: 0 for what differs between points, else None.
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
