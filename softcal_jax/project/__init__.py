"""A calibration as one text file: mesh, material, measurements, settings."""

from softcal_jax.project._load import load_project
from softcal_jax.project._problems import ProjectError
from softcal_jax.project._project import Project

__all__ = ["Project", "ProjectError", "load_project"]
