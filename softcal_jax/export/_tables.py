"""Files for people with a text editor or a spreadsheet."""

import csv
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any


def write_json(path: Path, data: Mapping[str, Any]) -> None:
    """Write a dictionary as JSON that every parser reads.

    Args:
        path: The file.
        data: What `result_dict` and its like return.

    Raises:
        ValueError: If it holds a NaN or an infinity, which JSON does not know.
    """
    text = json.dumps(data, indent=2, ensure_ascii=False, allow_nan=False)
    path.write_text(text + "\n", encoding="utf-8")


def write_markers_csv(path: Path, data: Mapping[str, Any]) -> None:
    """Write one line per marker and configuration; what was not measured is empty.

    Args:
        path: The file.
        data: What `result_dict` returns.
    """
    columns = ("measured", "simulated_before", "simulated", "residual")
    header = ["configuration", "role", "marker"]
    header += [f"{column}_{axis}_mm" for column in columns for axis in "xyz"]
    header += ["distance_mm"]
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(header)
        for fit in data["configurations"]:
            for marker in fit["markers"]:
                seen = [r for r in marker["residual_mm"] if r is not None]
                row = [fit["name"], fit["role"], marker["name"]]
                for column in columns:
                    row += [_number(v) for v in marker[f"{column}_mm"]]
                row += [_number(sum(r * r for r in seen) ** 0.5 if seen else None)]
                writer.writerow(row)


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.6f}"


def write_effectors_csv(path: Path, data: Mapping[str, Any]) -> None:
    """Write one line per coordinate of effectors that are no points, in SI.

    Args:
        path: The file.
        data: What `result_dict` returns.
    """
    columns = ("measured", "simulated_before", "simulated", "residual")
    header = ["configuration", "role", "effector", "coordinate", "unit", *columns]
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(header)
        for fit in data["configurations"]:
            for effector in fit["effectors"]:
                n = len(effector["simulated"])
                what = "turn" if effector["is_turn"] else "value"
                for i in range(n):
                    coordinate = f"{what}_{'xyz'[i]}" if n > 1 else what
                    row = [fit["name"], fit["role"], effector["name"], coordinate]
                    row += [effector["unit"]]
                    row += [_significant(effector[column][i]) for column in columns]
                    writer.writerow(row)


def write_robot_csv(path: Path, data: Mapping[str, Any]) -> None:
    """Write one line per number of rigid bodies, actuators and reactions, in SI.

    Args:
        path: The file.
        data: What `result_dict` or `simulation_dict` returns.
    """
    header = ["configuration", "part", "name", "what", "quantity", "value", "unit"]
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(header)
        for entry in data["configurations"]:
            for row in _robot_rows(entry["robot"] or {}):
                *words, value, unit = row
                writer.writerow([entry["name"], *words, _significant(value), unit])


def _robot_rows(robot: Mapping[str, Any]):
    """Part, name, what it is, quantity, value and unit of each number."""
    for body in robot.get("rigid_bodies", ()):
        head = ("rigid body", body["name"], body["state"])
        for key, factor, unit in (
            ("position_mm", 1e-3, "m"),
            ("translation_mm", 1e-3, "m"),
            ("rotation_vector", 1.0, "rad"),
        ):
            for axis, value in zip("xyz", body[key], strict=True):
                quantity = f"{key.removesuffix('_mm')}_{axis}"
                yield *head, quantity, factor * value, unit
    for own in robot.get("actuators", ()):
        head = ("actuator", own["name"], own["kind"])
        for key in ("force", "displacement"):
            if own[key] is not None:
                imposed = " (imposed)" if own["imposed"] == key else ""
                yield *head, f"{key}{imposed}", own[key], own[f"{key}_unit"]
    for reaction in robot.get("reactions", ()):
        for axis, value in zip("xyz", reaction["force"], strict=True):
            head = ("reaction", reaction["name"], "force of the ground")
            yield *head, f"force_{axis}", value, "N"


def _significant(value: float | None) -> str:
    return "" if value is None else f"{value:.9g}"
