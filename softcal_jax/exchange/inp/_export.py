"""`export_inp`: a calibrated model for CalculiX or Abaqus."""

import os
from pathlib import Path

from softcal_jax.exchange.inp._write import write_inp
from softcal_jax.report import LoadedResult, load_result


def export_inp(
    result: LoadedResult | str | os.PathLike[str],
    path: str | os.PathLike[str],
    *,
    configuration: str | None = None,
) -> tuple[str, ...]:
    """Write a calibrated model in a configuration for CalculiX or Abaqus.

    The file has the law with its calibrated values where it has a counterpart, the
    supports, loads and pressures of the configuration, and one static step; in SI. See
    `write_inp` for its content.

    Args:
        result: The results folder, its `result.json`, or what `load_result` returned.
        path: The file, ending in .inp.
        configuration: Name of the configuration; may be left out where there is one.

    Returns:
        What the programs do otherwise than the model, in sentences.

    Raises:
        ResultError: If the result cannot be loaded, see `load_result`.
        ValueError: If there is no such configuration, the name does not end in .inp,
            or something has no counterpart; the text gives the reason.
    """
    loaded = result if isinstance(result, LoadedResult) else load_result(result)
    posed, arrays = loaded.posed(configuration)
    title = f"{loaded.project.name}: {posed.name}"
    return write_inp(Path(path), loaded.model, arrays, title=title)
