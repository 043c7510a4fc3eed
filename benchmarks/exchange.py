"""What goes to other programs: does it arrive as it was?

Seven parts, each with a count:

- `sofa_tip` hangs a beam of SOFA's tets, whose tip is known, with so many rotations.
- `sofa_scenes` runs scenes of so many kinds by a strict stand-in for SOFA, which knows
  the components, plugins and data of two releases.
- `calculix` solves so many bodies by CalculiX, too (Debian package calculix-ccx).
- `icesl` writes so many random fields of moduli as graded foam, and reads the textures
  back through a Lua interpreter with the functions of the slicer.
- `tags` finds so many poses of a tag on rendered photographs.
- `mujoco` runs so many ready-made robots to rest by MuJoCo, calibrated for it.
- `cad_to_result` takes a finger from a STEP file to other programs, by commands alone.

`run exchange --count icesl=1` does one part, and one of it.
"""

from benchmarks import (
    _cad_to_result,
    _calculix,
    _icesl_fields,
    _mujoco,
    _sofa_scenes,
    _sofa_tip,
    _tags,
)
from benchmarks._problem import Figure, Goal, Options, Outcome

COUNTS = {
    "sofa_tip": 3,
    "sofa_scenes": 7,
    "calculix": 11,
    "icesl": 6,
    "tags": 30,
    "mujoco": 2,
    "cad_to_result": 1,
}
"""The parts, and how many of each are done if nothing else is asked for."""

_PARTS = {
    "sofa_tip": _sofa_tip.run,
    "sofa_scenes": _sofa_scenes.run,
    "calculix": _calculix.run,
    "icesl": _icesl_fields.run,
    "tags": _tags.run,
    "mujoco": _mujoco.run,
    "cad_to_result": _cad_to_result.run,
}

GOALS = {
    "sofa_tip_error_mm": Goal("at most", 1e-4),
    "sofa_scene_names_unknown": Goal("at most", 0),
    "calculix_difference_percent": Goal("at most", 1),
    "icesl_roundtrip_steps": Goal("at most", 1),
    "icesl_unlisted_voxels": Goal("at most", 0),
    "tag_position_error_mm": Goal("at most", 0.3),
    "tag_orientation_error_deg": Goal("at most", 0.3),
    "tag_coverage_95": Goal("at least", 0.9),
    "mujoco_tip_percent": Goal("at most", 1),
    "cad_modulus_error_percent": Goal("at most", 1),
}


def run(options: Options) -> Outcome:
    """Do the parts that are asked for, or all."""
    figures: dict[str, Figure] = {}
    for part, count in (options.counts or COUNTS).items():
        figures |= _PARTS[part](count, options.say)
    goals = {name: goal for name, goal in GOALS.items() if name in figures}
    return Outcome(figures, goals=goals)
