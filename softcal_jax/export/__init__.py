"""Results as files that other programs read: JSON, CSV and VTK."""

from softcal_jax.export._folder import (
    check_results_folder as check_results_folder,
    complete_results as complete_results,
    file_stems as file_stems,
    results_folder as results_folder,
)
from softcal_jax.export._headlines import (
    headline as headline,
    missed_words as missed_words,
    off_words as off_words,
)
from softcal_jax.export._json import (
    RESULT_FORMAT as RESULT_FORMAT,
    bodies_of as bodies_of,
    result_dict as result_dict,
    solver_dict as solver_dict,
)
from softcal_jax.export._made import (
    KEYS as KEYS,
    OTHER as OTHER,
    POINT as POINT,
    Made as Made,
    file_dict as file_dict,
    latex as latex,
    made_dict as made_dict,
    plain as plain,
    write_csv as write_csv,
    write_json as write_json,
    write_rows as write_rows,
)
from softcal_jax.export._vtu import (
    STANDARD_ERROR as STANDARD_ERROR,
    fibre_directions as fibre_directions,
    field_units as field_units,
    principal_stretches as principal_stretches,
    read_displacement as read_displacement,
    tet_fields as tet_fields,
    von_mises_stress as von_mises_stress,
    write_pvd as write_pvd,
    write_robot_vtu as write_robot_vtu,
    write_vtu as write_vtu,
)
