"""Reference elements and the 3x3 tensor algebra that the laws are written in."""

from softcal_jax.elements._simplex import (
    TET_EDGES as TET_EDGES,
    TET_FACES as TET_FACES,
    QuadratureRule as QuadratureRule,
    shape_functions as shape_functions,
    shape_gradients as shape_gradients,
    tet_rule as tet_rule,
    triangle_rule as triangle_rule,
)
from softcal_jax.elements._tensors import (
    axial as axial,
    cofactor as cofactor,
    determinant as determinant,
    matmul as matmul,
    rotation as rotation,
    skew as skew,
    sum_of as sum_of,
    symmetric as symmetric,
)
