"""Colours and symbols of pictures; shapes differ too, for colour-blind readers."""

from typing import Any

MEASURED = "#e3001b"
SIMULATED = "#000000"
OUTLINE = "#8a8a8a"
TEXT = "#1a1a1a"
FAINT = "#6b6b6b"
GOOD = "#1b7837"
BAD = "#c00000"

SERIES = ("#0b5fa5", "#d95f02", "#1b9e77", "#7570b3", "#a6761d", "#e7298a", "#444444")
"""Colours of the lines of a diagram, in order."""

DISPLACEMENT_MAP = "viridis"
"""Colour map that is perceptually uniform and avoids the markers' black and red."""

# What is drawn beside the soft body.
CABLE, WALL, MOTOR = "#d95f02", "#0b5fa5", "#7b3294"
FORCE, RIGID = "#1b7837", "#b4b4b4"

# How the body is held, and its weight.
SUPPORT, GRAVITY = "#8c510a", "#4d4d4d"
FIBRE = "#5e3c99"

MARKS = {
    "measured": MEASURED,
    "simulated": SIMULATED,
    "at rest": OUTLINE,
    "cable": CABLE,
    "wall": WALL,
    "motor": MOTOR,
    "force": FORCE,
    "load": FORCE,
    "gravity": GRAVITY,
    "rigid": RIGID,
    "frame": GRAVITY,
    "fibre": FIBRE,
}
"""Colours by what they mark, for a page that draws by itself."""

_POINT = {"ls": "none", "ms": 13, "mew": 2.5}

SYMBOLS: dict[str, dict[str, Any]] = {
    "measured": _POINT | {"marker": "o", "mec": MEASURED, "mfc": "none"},
    "simulated": _POINT | {"marker": "+", "mec": SIMULATED},
    "distance": {"color": MEASURED, "lw": 2.5},
    "at rest": {"color": OUTLINE, "lw": 2.5},
    "point at rest": _POINT | {"marker": "+", "mec": SIMULATED},
    "control point": _POINT | {"marker": "o", "ms": 16, "mec": TEXT, "mfc": "white"},
    "fibre": {"color": FIBRE, "lw": 1.6},
    "support": {"marker": "s", "ms": 9, "ls": "none", "color": SUPPORT, "alpha": 0.7},
    "load": {"color": FORCE, "lw": 3.0, "marker": "v", "ms": 8},
    "gravity": {"color": GRAVITY, "lw": 3.0, "marker": "v", "ms": 8},
    "sensor's axes": {"color": SIMULATED, "lw": 2.2},
    "rigid body": {"color": RIGID, "lw": 9.0},
    "cable": {"color": CABLE, "lw": 3.0},
    "wall under pressure": {"color": WALL, "lw": 9.0, "alpha": 0.5},
    "motor": {"color": MOTOR, "lw": 2.5, "ls": "-.", "marker": "o"},
    "force": {"color": FORCE, "lw": 3.0, "marker": ">"},
}
"""Styles of lines and points by what they mark, in the order of the legend."""
