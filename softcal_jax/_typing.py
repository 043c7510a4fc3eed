"""Array annotations used across the package: named axes, no runtime cost."""

from jax import Array
from jaxtyping import Bool, Float, Int
from numpy import ndarray

HostArray = ndarray
"""An array that lives on the host: meshing, reading, plotting."""

__all__ = ["Array", "Bool", "Float", "HostArray", "Int"]
