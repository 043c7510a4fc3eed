"""Sensitivities of effectors to parameters (paper Eqs. 4 to 9)."""

from softcal_jax.sensitivity._compliance import (
    Compliance,
    effector_compliance,
    effector_rows,
    parameter_compliance,
    parameter_forces,
)
from softcal_jax.sensitivity._derivative_check import (
    DerivativeCheck,
    check_parameter_derivatives,
)
from softcal_jax.sensitivity._response import Response, equilibrium_response
from softcal_jax.sensitivity._setup import setup_columns, setup_displacements

__all__ = [
    "Compliance",
    "DerivativeCheck",
    "Response",
    "check_parameter_derivatives",
    "effector_compliance",
    "effector_rows",
    "equilibrium_response",
    "parameter_compliance",
    "parameter_forces",
    "setup_columns",
    "setup_displacements",
]
