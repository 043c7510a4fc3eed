"""A calibration as one text file: mesh, material, measurements, settings."""

from softcal_jax.project._problems import ProjectError
from softcal_jax.project._project import Project, load_project

__all__ = ["Project", "ProjectError", "load_project"]
