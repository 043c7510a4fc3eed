"""What goes to other programs: does it arrive as it was?

One part so far: `icesl` writes random fields of moduli as graded foam, and reads the
textures back through a Lua interpreter with the functions of the slicer. `run exchange
--count icesl=1` does one field.
"""

from benchmarks import _icesl_fields
from benchmarks._problem import Figure, Goal, Options, Outcome

COUNTS = {"icesl": 6}
"""The parts, and how many of each are done if nothing else is asked for."""

_PARTS = {"icesl": _icesl_fields.run}

GOALS = {
    "icesl_roundtrip_steps": Goal("at most", 1),
    "icesl_unlisted_voxels": Goal("at most", 0),
}


def run(options: Options) -> Outcome:
    """Do the parts that are asked for, or all."""
    figures: dict[str, Figure] = {}
    for part, count in (options.counts or COUNTS).items():
        figures |= _PARTS[part](count, options.say)
    goals = {name: goal for name, goal in GOALS.items() if name in figures}
    return Outcome(figures, goals=goals)
