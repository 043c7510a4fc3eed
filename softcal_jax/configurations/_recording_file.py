"""Files of recordings: C3D, and the wide tables that motion capture exports."""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from softcal_jax._files import check_file
from softcal_jax._text import escaped
from softcal_jax.configurations._recording import Recording
from softcal_jax.configurations._wide_table import (
    check_rate,
    is_wide_table,
    metres_of,
    read_wide_table,
)

C3D = ".c3d"


def read_recording(
    path: str | os.PathLike[str],
    *,
    length_unit: str | None = None,
    delimiter: str | None = None,
    decimal: str | None = None,
) -> Recording:
    """Read a recording: by `read_c3d` if it ends with .c3d, or by `read_wide_table`.

    Options are for tables only.

    Raises:
        ValueError: As these functions, or if an option is given for a .c3d file.
    """
    dialect = {"length_unit": length_unit, "delimiter": delimiter, "decimal": decimal}
    if Path(path).suffix.lower() != C3D:
        return read_wide_table(path, **dialect)
    for key, value in dialect.items():
        if value is not None:
            raise ValueError(f"{key} is for tables; leave it out for {path}.")
    return read_c3d(path)


def is_recording(path: Path) -> bool:
    """Whether a file is a recording over time; it may be any text."""
    return path.suffix.lower() == C3D or is_wide_table(path)


def read_c3d(path: str | os.PathLike[str]) -> Recording:
    """Read a recording of motion capture, with the units that the file states.

    The format is that of www.c3d.org. A frame in which a marker has a negative residual
    did not see it.

    Raises:
        FileNotFoundError: If there is no such file.
        ImportError: If ezc3d is not installed.
        ValueError: If it cannot be read, holds no frames, no markers or two of one
            label, or states no positive rate or no known unit of length.
    """
    try:
        import ezc3d
    except ImportError as error:
        raise ImportError(
            "reading .c3d files needs ezc3d: pip install 'softcal-jax[mocap]'."
        ) from error
    path = Path(path)
    check_file(path, "recording")
    try:
        content = ezc3d.c3d(str(path))
    except (OSError, RuntimeError, ValueError) as error:
        raise ValueError(f"recording {path} cannot be read: {error}.") from error
    point = content["parameters"]["POINT"]
    names = tuple(map(escaped, point["LABELS"]["value"]))
    units = point["UNITS"]["value"] if "UNITS" in point else []
    metres = metres_of(path, units[0] if units else "")
    positions = np.moveaxis(np.asarray(content["data"]["points"], float), 2, 0)
    positions = np.swapaxes(positions, 1, 2)[:, : len(names), :3] * metres
    residuals = np.asarray(content["data"]["meta_points"]["residuals"])[0].T
    positions[residuals[:, : len(names)] < 0.0] = np.nan
    rate = float(point["RATE"]["value"][0])
    check_rate(path, rate)
    # Events count from the first frame of the trial, of which this may be a part.
    trimmed = int(content["header"]["points"]["first_frame"]) / rate
    return Recording(
        names=names,
        times=np.arange(len(positions)) / rate,
        positions=positions,
        source=str(path),
        events=_events(content["parameters"], trimmed),
    )


def _events(
    parameters: Mapping[str, Any], trimmed: float
) -> tuple[tuple[str, float], ...]:
    event = parameters.get("EVENT", {})
    if "LABELS" not in event or "TIMES" not in event:
        return ()
    # Each time is a number of minutes and one of seconds.
    minutes, seconds = np.reshape(event["TIMES"]["value"], (2, -1))
    times = 60.0 * minutes + seconds - trimmed
    labels = map(escaped, event["LABELS"]["value"])
    return tuple((label, float(t)) for label, t in zip(labels, times, strict=False))
