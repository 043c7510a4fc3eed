"""Project files: a calibration as one text file of mesh, material, data, settings."""

from softcal_jax.project._goals import inverse_as_typed
from softcal_jax.project._load import load_mesh, load_project
from softcal_jax.project._plausibility import (
    CHANGE,
    Guess,
    ProjectWarning,
    guesses_left,
)
from softcal_jax.project._problems import ProjectError, at, one_by_one, suggestion
from softcal_jax.project._project import Project, compare_projects, projects_by_name
from softcal_jax.project._quantities import parse_in_si
from softcal_jax.project._reading import (
    QuantityAsRead,
    quantities_as_read,
    read_schema,
    read_toml,
)
from softcal_jax.project._table import Integer, Table

__all__ = [
    "CHANGE",
    "Guess",
    "Integer",
    "Project",
    "ProjectError",
    "ProjectWarning",
    "QuantityAsRead",
    "Table",
    "at",
    "compare_projects",
    "guesses_left",
    "inverse_as_typed",
    "load_mesh",
    "load_project",
    "one_by_one",
    "parse_in_si",
    "projects_by_name",
    "quantities_as_read",
    "read_schema",
    "read_toml",
    "suggestion",
]
