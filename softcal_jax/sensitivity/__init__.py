"""Sensitivities of effectors to parameters (paper Eqs. 7 to 9)."""

from softcal_jax.sensitivity._compliance import (
    EnergyCompliance as EnergyCompliance,
    Response as Response,
    energy_compliance as energy_compliance,
    equilibrium_response as equilibrium_response,
    parameter_compliance as parameter_compliance,
)
from softcal_jax.sensitivity._rows import (
    DerivativeCheck as DerivativeCheck,
    adjoint_of_tets as adjoint_of_tets,
    check_parameter_derivatives as check_parameter_derivatives,
    clamp_row as clamp_row,
    following_rows as following_rows,
    mesh_row as mesh_row,
    parameter_forces as parameter_forces,
    parameter_rows as parameter_rows,
    stress_patches as stress_patches,
)
