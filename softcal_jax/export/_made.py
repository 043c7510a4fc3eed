"""What a result was computed from and with, as a dictionary for JSON."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from softcal_jax._module import Module
from softcal_jax.calibration import ProjectSource
from softcal_jax.equilibrium import Model
from softcal_jax.export._plain import plain, versions
from softcal_jax.export._source import source_dict


class Made(Module):
    """What a result was computed from and with.

    Attributes:
        model: The model, whose solver names its package.
        settings: Settings by name; those of settings may nest.
        source: The project file, and what it names; None for a model made in Python.
    """

    model: Model
    settings: Mapping[str, Any]
    source: ProjectSource | None = None


def made_dict(made: Made | None, directory: str | Path = ".") -> dict[str, Any]:
    """Convert what a result was computed from and with to a dictionary.

    Keys: `source` (see `source_dict`), `settings`, `versions`.

    Args:
        made: What it was; None if that is not known.
        directory: Folder of the results.
    """
    if made is None:
        return {"source": None, "settings": {}, "versions": {}}
    return {
        "source": source_dict(made.source, directory),
        "settings": plain(made.settings),
        "versions": versions(made.model),
    }
