"""Parameters: names, bounds, scaling S, and their place in the model (Sec. IV.A)."""

from softcal_jax.fields._parameters import (
    Parameter,
    ParameterSpace,
    as_space,
    find_field,
    set_field,
)
from softcal_jax.fields._validation import check_parameters

__all__ = [
    "Parameter",
    "ParameterSpace",
    "as_space",
    "check_parameters",
    "find_field",
    "set_field",
]
