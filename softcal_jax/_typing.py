"""Array annotations of the whole package, and what is known of a value."""

from collections.abc import Sequence
from types import ModuleType

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.core import Tracer
from jaxtyping import ArrayLike, Bool, Float, Int
from numpy import ndarray

HostArray = ndarray  # A NumPy array on the host: meshing, reading, plotting
Vector = Sequence[float] | Float[ArrayLike, "3"]  # Three numbers, as a user types them


def is_traced(value: object) -> bool:
    """Check whether a value is traced, so that its content is unknown."""
    return isinstance(value, Tracer)


def check_untraced(what: str, value: object, leaf: str, by: str = "eqx.tree_at"):
    """Raise ValueError, with what to set instead, if a value is traced."""
    if any(map(is_traced, jax.tree.leaves(value))):
        inside = f" Inside, set {leaf} by {by}." if leaf else ""
        raise ValueError(
            f"{what} is traced, expected plain numbers: make it outside of jit and "
            f"autodiff.{inside}"
        )


def numpy_of(*values: object) -> ModuleType:
    """Return `jax.numpy` if a value is traced, and NumPy if all are known.

    Outside a program, JAX would compile one for each operation.
    """
    return jnp if any(map(is_traced, jax.tree.leaves(values))) else np


__all__ = ["Array", "Bool", "Float", "HostArray", "Int", "Vector"]
__all__ += ["check_untraced", "is_traced", "numpy_of"]
