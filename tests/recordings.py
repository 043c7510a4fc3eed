"""Recordings of motion capture as ezc3d writes them, which it must be there for."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

RATE = 100.0
NAMES = ("base", "tip")


def motion(n_frames: int = 40) -> np.ndarray:
    """The tip rests for 20 frames, and moves by 3 mm in each one after that."""
    positions = np.zeros((n_frames, 2, 3))
    positions[:, 0] = (1.0, 2.0, 3.0)
    positions[20:, 1, 2] = 3.0 * np.arange(1, n_frames - 19)
    return positions


def write_recording(
    path: Path,
    positions: np.ndarray,
    *,
    unit: str = "mm",
    labels: Sequence[str] = NAMES,
    residuals: np.ndarray | None = None,
) -> Path:
    """Writes positions (frames, markers, axes), by a library that is not ours."""
    import ezc3d

    c3d = ezc3d.c3d()
    c3d["parameters"]["POINT"]["RATE"]["value"] = [RATE]
    c3d["parameters"]["POINT"]["LABELS"]["value"] = list(labels)
    c3d.add_parameter("POINT", "UNITS", unit)
    points = np.ones((4, positions.shape[1], len(positions)))
    points[:3] = positions.transpose(2, 1, 0)
    c3d["data"]["points"] = points
    if residuals is not None:
        c3d["data"]["meta_points"] = {
            "residuals": residuals.T[None],
            "camera_masks": np.zeros((7, *residuals.T.shape), bool),
        }
    c3d.write(str(path))
    return path
