"""The clamped silicone beam of `softcal demo`: real motion capture."""

from importlib.resources import files
from pathlib import Path


def silicone_beam_path() -> Path:
    """Return the project file of the silicone beam; its markers lie next to it.

    Example:
        Calibrate it::

            project = load_project(silicone_beam_path())
            result = project.calibrate()
    """
    return Path(str(files("softcal_jax.robots"))) / "silicone_beam" / "project.toml"
