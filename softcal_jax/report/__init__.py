"""Results written and loaded: files, a page, and tables for the terminal."""

from softcal_jax.report._goals import (
    design_tables as design_tables,
    inverse_tables as inverse_tables,
)
from softcal_jax.report._load import (
    LoadedResult as LoadedResult,
    ResultError as ResultError,
    ResultWarning as ResultWarning,
    load_result as load_result,
    load_values as load_values,
    result_path as result_path,
)
from softcal_jax.report._outline import (
    control_point_sets as control_point_sets,
    mesh_lines as mesh_lines,
    outline as outline,
    roles_of as roles_of,
)
from softcal_jax.report._pages import notebook_html as notebook_html
from softcal_jax.report._sweep_page import (
    check_sweep_page as check_sweep_page,
    write_sweep as write_sweep,
)
from softcal_jax.report._tables import (
    model_words as model_words,
    simulation_tables as simulation_tables,
    summary_table as summary_table,
)
from softcal_jax.report._transfer import Transfer as Transfer, transfer as transfer
from softcal_jax.report._verdict import (
    answer_of as answer_of,
    held_out_sentences as held_out_sentences,
)
from softcal_jax.report._write import (
    PictureWarning as PictureWarning,
    write_comparison as write_comparison,
    write_design as write_design,
    write_identifiability as write_identifiability,
    write_inverse as write_inverse,
    write_results as write_results,
    write_simulation as write_simulation,
)
