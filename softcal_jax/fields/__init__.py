"""Parameters: names, bounds, scaling S, and their place in the model (Sec. IV.A)."""

from softcal_jax.fields._parameters import (
    Parameter,
    ParameterSpace,
    as_space,
    find_field,
)

__all__ = ["Parameter", "ParameterSpace", "as_space", "find_field"]
