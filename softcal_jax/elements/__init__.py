"""Reference elements and the 3x3 tensor algebra that the laws are written in."""

from softcal_jax.elements._simplex import (
    TET_EDGES,
    TET_FACES,
    QuadratureRule,
    shape_functions,
    shape_gradients,
    tet_rule,
    triangle_rule,
)
from softcal_jax.elements._tensors import (
    axial,
    cofactor,
    determinant,
    matmul,
    rotation,
    skew,
    sum_of,
    symmetric,
)

__all__ = [
    "TET_EDGES",
    "TET_FACES",
    "QuadratureRule",
    "axial",
    "cofactor",
    "determinant",
    "matmul",
    "rotation",
    "shape_functions",
    "shape_gradients",
    "skew",
    "sum_of",
    "symmetric",
    "tet_rule",
    "triangle_rule",
]
