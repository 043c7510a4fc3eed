"""Results written and loaded: files, a page, and tables for the terminal."""

from softcal_jax.report._calibration import (
    held_out_sentences,
    model_words,
    summary_table,
)
from softcal_jax.report._inverse import inverse_table, write_inverse
from softcal_jax.report._load import (
    LoadedResult,
    ResultError,
    ResultWarning,
    load_result,
)
from softcal_jax.report._outline import (
    control_point_sets,
    mesh_lines,
    outline,
    roles_of,
)
from softcal_jax.report._pages import notebook_html
from softcal_jax.report._sweep_page import check_sweep_page, write_sweep
from softcal_jax.report._tables import simulation_table
from softcal_jax.report._write import (
    PictureWarning,
    write_comparison,
    write_identifiability,
    write_results,
    write_simulation,
)

__all__ = [
    "LoadedResult",
    "PictureWarning",
    "ResultError",
    "ResultWarning",
    "check_sweep_page",
    "control_point_sets",
    "held_out_sentences",
    "inverse_table",
    "load_result",
    "mesh_lines",
    "model_words",
    "notebook_html",
    "outline",
    "roles_of",
    "simulation_table",
    "summary_table",
    "write_comparison",
    "write_identifiability",
    "write_inverse",
    "write_results",
    "write_simulation",
    "write_sweep",
]
