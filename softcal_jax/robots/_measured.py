"""Project files of measured robots, with their data beside them."""

from importlib.resources import files
from pathlib import Path


def silicone_beam_path() -> Path:
    """Return the project file of the clamped silicone beam of `softcal demo`.

    Example:
        Calibrate it::

            project = load_project(silicone_beam_path())
            result = project.calibrate()
    """
    return _project("silicone_beam")


def pneumatic_arm_path() -> Path:
    """Return the project file of the pneumatic arm of `softcal demo arm`.

    Its recordings are .c3d files, which need ezc3d: pip install 'softcal-jax[mocap]'.
    """
    return _project("pneumatic_arm")


def _project(name: str) -> Path:
    return Path(str(files("softcal_jax.robots"))) / name / "project.toml"
