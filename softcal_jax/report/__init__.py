"""Results written and loaded: files, a page, and tables for the terminal."""

from softcal_jax._tree import (
    Chart as Chart,
    Column as Column,
    Section as Section,
    Table as Table,
    Value as Value,
)
from softcal_jax.report._console import console as console, text as text
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
    mesh_section as mesh_section,
    outline as outline,
    roles_of as roles_of,
)
from softcal_jax.report._poses import (
    held_out_sentences as held_out_sentences,
    model_words as model_words,
)
from softcal_jax.report._sections import (
    Transfer as Transfer,
    sections as sections,
    transfer as transfer,
)
from softcal_jax.report._sweep import (
    check_sweep_page as check_sweep_page,
    sweep_sections as sweep_sections,
    write_sweep as write_sweep,
)
from softcal_jax.report._write import (
    PictureWarning as PictureWarning,
    notebook_html as notebook_html,
    write_results as write_results,
)
