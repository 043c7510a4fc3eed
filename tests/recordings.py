"""Recordings of motion capture: C3D by ezc3d, and tables as their makers describe them.

The headers are those of files that Motive 3, Nexus 2 and QTM 2024 wrote.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

RATE = 100.0
NAMES = ("base", "tip")


def motion(n_frames: int = 40) -> np.ndarray:
    """The tip rests for 20 frames, and moves by 3 mm in each one after that."""
    positions = np.zeros((n_frames, 2, 3))
    positions[:, 0], positions[:, 1, 0] = (1.0, 2.0, 3.0), 4.0
    positions[20:, 1, 2] = 3.0 * np.arange(1, n_frames - 19)
    return positions


def write_recording(
    path: Path,
    positions: np.ndarray,
    *,
    unit: str = "mm",
    labels: Sequence[str] = NAMES,
    residuals: np.ndarray | None = None,
    events: Sequence[tuple[str, float]] = (),
    first_frame: int = 0,
    rate: float = RATE,
    per_key: int = 255,
) -> Path:
    """Writes positions (frames, markers, axes), by a library that is not ours.

    They may be a part of a trial, of which `first_frame` were cut off.
    """
    import ezc3d

    c3d = ezc3d.c3d()
    c3d["parameters"]["POINT"]["RATE"]["value"] = [rate]
    c3d["parameters"]["POINT"]["LABELS"]["value"] = list(labels)
    c3d.add_parameter("POINT", "UNITS", unit)
    points = np.ones((4, positions.shape[1], len(positions)))
    points[:3] = positions.transpose(2, 1, 0)
    c3d["data"]["points"] = points
    c3d["header"]["points"]["first_frame"] = first_frame
    if residuals is not None:
        c3d["data"]["meta_points"] = {
            "residuals": residuals.T[None],
            "camera_masks": np.zeros((7, *residuals.T.shape), bool),
        }
    if events:
        c3d.add_parameter("EVENT", "USED", [len(events)])
        for k in range(0, len(events), per_key):
            number = str(k // per_key + 1).removeprefix("1")
            names, times = zip(*events[k : k + per_key], strict=True)
            c3d.add_parameter("EVENT", f"LABELS{number}", names)
            # Minutes, then seconds.
            both = np.array([divmod(time, 60.0) for time in times]).T
            c3d.add_parameter("EVENT", f"TIMES{number}", both)
    c3d.write(str(path))
    return path


def _cells(values: np.ndarray, digits: int) -> list[str]:
    """Coordinates of a frame; those of a marker that was not seen are blank."""
    return ["" if np.isnan(v) else f"{v:.{digits}f}" for v in values.ravel()]


def write_motive(
    path: Path,
    positions: np.ndarray,
    *,
    unit: str = "Millimeters",
    labels: Sequence[str] = NAMES,
) -> Path:
    """Writes positions as Motive 3 does: with solved markers and sizes beside them."""
    solved = np.nan_to_num(positions) + 7.0
    about = ["Export Frame Rate", "100.000000", "Rotation Type", "Quaternion"]
    about += ["Length Units", unit, "Coordinate Space", "Global"]
    kinds, names, whats, axes = [""], ["Name"], [""], ["Time (Seconds)"]
    for kind in ("Rigid Body Marker", "Marker"):
        for label in labels:
            kinds += [kind] * 4
            names += [label] * 4
            whats += ["Position"] * 3 + ["Size"]
            axes += ["X", "Y", "Z", ""]
    rows = [
        ["Format Version", "1.25", "Take Name", "Take 1", "Take Notes", "", *about],
        [],
        ["", "Type", *kinds[1:]],
        ["", *names],
        ["", "ID", *["4C:F0B3"] * (len(names) - 1)],
        ["", *whats],
        ["Frame", *axes],
    ]
    for i, (of_body, seen) in enumerate(zip(solved, positions, strict=True)):
        row = [str(i + 500), f"{5.0 + i / RATE:.6f}"]
        for part in (of_body, seen):
            for marker in part:
                row += [*_cells(marker, 6), "14.0"]
        rows.append(row)
    path.write_text("\n".join(map(",".join, rows)) + "\n")
    return path


def write_vicon(
    path: Path,
    positions: np.ndarray,
    *,
    unit: str = "mm",
    labels: Sequence[str] = NAMES,
    delimiter: str = ",",
) -> Path:
    """Writes positions as Nexus does: one section among others, labels over x only."""
    n = len(labels)
    rows = [
        ["Devices"],
        ["1000"],
        ["", "", "Force"],
        ["Frame", "Sub Frame", "Fx"],
        ["", "", "N"],
        ["1", "0", "0.5"],
        [],
        ["Trajectories"],
        ["100"],
        ["", "", *[cell for label in labels for cell in (f"arm:{label}", "", "")]],
        ["Frame", "Sub Frame", *["X", "Y", "Z"] * n],
        ["", "", *[unit] * (3 * n)],
    ]
    for i, seen in enumerate(positions):
        rows.append([str(i + 101), "0", *_cells(seen, 6)])
    rows += [[], ["Events"], ["100"]]
    path.write_text("\n".join(map(delimiter.join, rows)) + "\n")
    return path


def write_qualisys(
    path: Path,
    positions: np.ndarray,
    *,
    labels: Sequence[str] = NAMES,
    timed: bool = True,
    titles: bool = True,
    decimal: str = ".",
    events: Sequence[tuple[str, float]] = (),
    start: float = 0.0,
) -> Path:
    """Writes positions as QTM does: zeros for what was not seen, a tab at the end."""
    names = ["Frame", "Time"] * timed
    names += [f"{label} {axis}" for label in labels for axis in "XYZ"]
    rows = [
        ["NO_OF_FRAMES", str(len(positions))],
        ["NO_OF_MARKERS", str(len(labels))],
        ["FREQUENCY", f"{RATE:g}"],
        ["DESCRIPTION", "--"],
        ["TIME_STAMP", "2026-01-19, 10:19:43.755", "2063631.96175450"],
        ["DATA_INCLUDED", "3D"],
        *(
            ["EVENT", name, f"{1 + RATE * time:.0f}", f"{time:.5f}"]
            for name, time in events
        ),
        ["MARKER_NAMES", *labels],
        ["TRAJECTORY_TYPES", *["Measured"] * len(labels)],
        *([[*names, ""]] * titles),
    ]
    for i, seen in enumerate(np.nan_to_num(positions)):
        row = [str(i + 1), f"{start + i / RATE:.5f}"] if timed else []
        rows.append([*row, *_cells(seen, 6)])
    text = "\n".join(map("\t".join, rows)) + "\n"
    path.write_text(text if decimal == "." else text.replace(".", decimal))
    return path
