"""Project files: a calibration as one text file of mesh, material, data, settings."""

from softcal_jax.project._design import DesignTask as DesignTask
from softcal_jax.project._goals import (
    inverse_as_typed as inverse_as_typed,
    printed_project as printed_project,
    toml_key as toml_key,
    toml_value as toml_value,
)
from softcal_jax.project._load import (
    CHANGE as CHANGE,
    Guess as Guess,
    guesses_left as guesses_left,
    load_mesh as load_mesh,
    load_project as load_project,
)
from softcal_jax.project._plausible import (
    ProjectWarning as ProjectWarning,
    implausible as implausible,
)
from softcal_jax.project._project import (
    Project as Project,
    compare_projects as compare_projects,
    projects_by_name as projects_by_name,
)
from softcal_jax.project._quantities import (
    parse_in_si as parse_in_si,
    recognised as recognised,
)
from softcal_jax.project._reading import (
    QuantityAsRead as QuantityAsRead,
    quantities_as_read as quantities_as_read,
    read_schema as read_schema,
    read_toml as read_toml,
)
from softcal_jax.project._table import (
    ProjectError as ProjectError,
    Table as Table,
    at as at,
    suggestion as suggestion,
)
