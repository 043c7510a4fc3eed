"""Array annotations used across the package: named axes, no runtime cost."""

from jax import Array
from jax.core import Tracer
from jaxtyping import Bool, Float, Int
from numpy import ndarray

HostArray = ndarray  # A NumPy array on the host: meshing, reading, plotting


def is_traced(value: object) -> bool:
    """Check whether a value is traced, so that its content is unknown."""
    return isinstance(value, Tracer)


__all__ = ["Array", "Bool", "Float", "HostArray", "Int", "is_traced"]
