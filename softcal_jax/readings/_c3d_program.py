"""Reads a C3D file in a process of its own, since damaged ones crash ezc3d."""

from typing import Any


def main(path: str) -> dict[str, Any]:
    """Read the groups of parameters that are used, the first frame, and the points."""
    import ezc3d

    content: Any = ezc3d.c3d(path)
    groups, data = content["parameters"], content["data"]
    values = lambda group: {
        key: of["value"] for key, of in group.items() if "value" in of
    }
    return {
        "POINT": values(groups["POINT"]),
        "EVENT": values(groups.get("EVENT", {})),
        "first_frame": int(content["header"]["points"]["first_frame"]),
        "points": data["points"],
        "residuals": data["meta_points"]["residuals"],
    }
