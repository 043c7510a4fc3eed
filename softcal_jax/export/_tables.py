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
