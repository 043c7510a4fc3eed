"""Project files of ready-made robots, with their data beside them."""

from importlib.resources import files
from pathlib import Path

from softcal_jax._names import unknown_name

READY_MADE = {
    "beam": "silicone_beam",
    "cable-beam": "cable_beam",
    "pneumatic-finger": "pneumatic_finger",
    "pneumatic-arm": "pneumatic_arm",
    "parallel-robot": "parallel_robot",
    "tentacle": "soft_tentacle",
    "emio": "emio",
}
"""Folders of this package, by the names of the robots that users type."""


def ready_made_path(name: str) -> Path:
    """Return the project file of a ready-made robot, by its name in `READY_MADE`.

    The readings of "beam", "pneumatic-arm", "tentacle" and "emio" were measured, those
    of the others computed; README.md beside each says how.

    Raises:
        ValueError: If there is no such robot; the text suggests the closest name.
    """
    if name not in READY_MADE:
        raise unknown_name("robot", name, READY_MADE)
    return Path(str(files("softcal_jax.robots"))) / READY_MADE[name] / "project.toml"


def silicone_beam_path() -> Path:
    """Return the project file of the clamped silicone beam of `softcal demo`."""
    return ready_made_path("beam")


def pneumatic_arm_path() -> Path:
    """Return the project file of the pneumatic arm of `softcal demo arm`.

    Its recordings are .c3d files, which need ezc3d: pip install 'softcal-jax[mocap]'.
    """
    return ready_made_path("pneumatic-arm")
