"""Array annotations used across the package: named axes, no runtime cost."""

from jax import Array
from jax.core import Tracer
from jaxtyping import Bool, Float, Int
from numpy import ndarray

HostArray = ndarray
"""An array that lives on the host: meshing, reading, plotting."""


def is_traced(value: object) -> bool:
    """Whether a value is inside a trace and cannot be looked at."""
    return isinstance(value, Tracer)


__all__ = ["Array", "Bool", "Float", "HostArray", "Int", "is_traced"]
