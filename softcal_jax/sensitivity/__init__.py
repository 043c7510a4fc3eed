"""Sensitivities of effectors to parameters (paper Eqs. 7 to 9)."""

from softcal_jax.sensitivity._clamp_row import clamp_row
from softcal_jax.sensitivity._compliance import (
    Compliance,
    EnergyCompliance,
    energy_compliance,
    parameter_compliance,
)
from softcal_jax.sensitivity._derivative_check import (
    DerivativeCheck,
    check_parameter_derivatives,
)
from softcal_jax.sensitivity._response import Response, equilibrium_response
from softcal_jax.sensitivity._rows import (
    adjoint_of_tets,
    parameter_forces,
    parameter_rows,
    readings_of_forces,
)

__all__ = [
    "Compliance",
    "DerivativeCheck",
    "EnergyCompliance",
    "Response",
    "adjoint_of_tets",
    "check_parameter_derivatives",
    "clamp_row",
    "energy_compliance",
    "equilibrium_response",
    "parameter_compliance",
    "parameter_forces",
    "parameter_rows",
    "readings_of_forces",
]
