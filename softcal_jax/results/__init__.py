"""Results: what they say as a tree, as text, pages and files, and loading them."""

from softcal_jax.results._folder import (
    check_results_folder as check_results_folder,
    complete_results as complete_results,
    file_stems as file_stems,
    results_folder as results_folder,
)
from softcal_jax.results._json import (
    KEYS as KEYS,
    plain as plain,
    result_dict as result_dict,
    write_json as write_json,
)
from softcal_jax.results._load import (
    LoadedResult as LoadedResult,
    ResultError as ResultError,
    ResultWarning as ResultWarning,
    load_result as load_result,
    load_values as load_values,
    result_path as result_path,
)
from softcal_jax.results._made import Made as Made
from softcal_jax.results._outline import (
    control_point_sets as control_point_sets,
    roles_of as roles_of,
)
from softcal_jax.results._poses import (
    held_out_sentences as held_out_sentences,
    model_words as model_words,
)
from softcal_jax.results._sections import (
    RESULT_KINDS as RESULT_KINDS,
    Transfer as Transfer,
    headline as headline,
    sections as sections,
    transfer as transfer,
)
from softcal_jax.results._tree import (
    Column as Column,
    Section as Section,
    Table as Table,
    Value as Value,
    console as console,
    latex as latex,
    text as text,
    write_csv as write_csv,
)
from softcal_jax.results._vtu import (
    read_displacement as read_displacement,
    write_pvd as write_pvd,
    write_robot_vtu as write_robot_vtu,
    write_vtu as write_vtu,
)
from softcal_jax.results._write import (
    PictureWarning as PictureWarning,
    check_sweep_page as check_sweep_page,
    notebook_html as notebook_html,
    write_results as write_results,
    write_sweep as write_sweep,
)
