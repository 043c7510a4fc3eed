"""Sensitivities of effectors to parameters (paper Eqs. 7 to 9)."""

from softcal_jax.sensitivity._compliance import (
    EnergyCompliance,
    Response,
    energy_compliance,
    equilibrium_response,
    parameter_compliance,
)
from softcal_jax.sensitivity._error_rows import clamp_row, stiffness_row
from softcal_jax.sensitivity._rows import (
    DerivativeCheck,
    adjoint_of_tets,
    check_parameter_derivatives,
    parameter_forces,
    parameter_rows,
)

__all__ = [
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
    "stiffness_row",
]
