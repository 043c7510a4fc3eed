"""Sensitivities of effectors to parameters (paper Eqs. 7 to 9)."""

from softcal_jax.sensitivity._clamp_row import clamp_row
from softcal_jax.sensitivity._compliance import (
    EnergyCompliance,
    Response,
    energy_compliance,
    equilibrium_response,
    parameter_compliance,
)
from softcal_jax.sensitivity._rows import (
    DerivativeCheck,
    adjoint_of_tets,
    check_parameter_derivatives,
    parameter_forces,
    parameter_rows,
    readings_of_forces,
)
from softcal_jax.sensitivity._stiffness_row import stiffness_row

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
    "readings_of_forces",
    "stiffness_row",
]
