"""What goes to other programs: does it arrive as it was?

`icesl` writes random fields of moduli as graded foam, and reads the textures back
through a Lua interpreter with the functions of the slicer. `sofa_tip` hangs a beam of
SOFA's tets, whose tip is known. `sofa_scenes` runs scenes of all kinds by a strict
stand-in for SOFA, which knows the names of two releases. `calculix` solves
bodies by CalculiX, too. `run exchange --count icesl=1` does one field.
"""

from benchmarks import _calculix, _icesl_fields, _sofa_scenes, _sofa_tip
from benchmarks._problem import Figure, Goal, Options, Outcome

COUNTS = {"sofa_tip": 3, "sofa_scenes": 7, "calculix": 11, "icesl": 6}
"""The parts, and how many of each are done if nothing else is asked for."""

_PARTS = {
    "sofa_tip": _sofa_tip.run,
    "sofa_scenes": _sofa_scenes.run,
    "calculix": _calculix.run,
    "icesl": _icesl_fields.run,
}

GOALS = {
    "sofa_tip_error_mm": Goal("at most", 1e-4),
    "sofa_scene_names_unknown": Goal("at most", 0),
    "calculix_difference_percent": Goal("at most", 1),
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
