"""Colours of all pictures; markers differ in shape too, for colour-blind readers."""

MEASURED = "#e3001b"
SIMULATED = "#000000"
OUTLINE = "#8a8a8a"
TEXT = "#1a1a1a"
FAINT = "#6b6b6b"
GOOD = "#1b7837"
DOUBTFUL = "#9a5b00"
BAD = "#c00000"
COLOUR_OF = {"good": GOOD, "doubtful": DOUBTFUL, "bad": BAD}
"""Colours of the tones of a verdict, see `RunVerdict`."""

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
    "gravity": GRAVITY,
    "rigid": RIGID,
    "frame": GRAVITY,
    "fibre": FIBRE,
}
"""Colours by what they mark, for a page that draws by itself."""
