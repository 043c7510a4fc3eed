"""Results as files that other programs read: JSON, CSV and VTK."""

from softcal_jax._units import readable_estimate, readable_unit, readable_values
from softcal_jax.export._csv import (
    write_effectors_csv,
    write_markers_csv,
    write_robot_csv,
)
from softcal_jax.export._folder import (
    check_results_folder,
    file_stems,
    results_folder,
)
from softcal_jax.export._json import (
    RESULT_FORMAT,
    comparison_dict,
    inverse_dict,
    outlook_dict,
    result_dict,
    simulation_dict,
)
from softcal_jax.export._made import (
    Made,
    file_dict,
    made_dict,
    plain,
    write_json,
)
from softcal_jax.export._vtu import (
    STANDARD_ERROR,
    fibre_directions,
    field_units,
    principal_stretches,
    tet_fields,
    von_mises_stress,
    write_pvd,
    write_robot_vtu,
    write_vtu,
)

__all__ = [
    "RESULT_FORMAT",
    "STANDARD_ERROR",
    "Made",
    "check_results_folder",
    "comparison_dict",
    "fibre_directions",
    "field_units",
    "file_dict",
    "file_stems",
    "inverse_dict",
    "made_dict",
    "outlook_dict",
    "plain",
    "principal_stretches",
    "readable_estimate",
    "readable_unit",
    "readable_values",
    "result_dict",
    "results_folder",
    "simulation_dict",
    "tet_fields",
    "von_mises_stress",
    "write_effectors_csv",
    "write_json",
    "write_markers_csv",
    "write_pvd",
    "write_robot_csv",
    "write_robot_vtu",
    "write_vtu",
]
