"""A project folder for a robot, ready-made or one's own, and the text of its file."""

import shutil
import textwrap
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from softcal_jax._text import check_unique, listed
from softcal_jax._typing import Float, HostArray
from softcal_jax._units import readable_values
from softcal_jax.configurations import STANDARD_GRAVITY
from softcal_jax.exchange.proposal._body import (
    Body,
    far_end,
    find_actuated,
    in_mm,
    propose_held,
    read_body,
)
from softcal_jax.exchange.proposal._recorded import (
    Findings,
    MarkerPlace,
    Recorded,
    RecordedPose,
    Stated,
    read_recorded,
)
from softcal_jax.materials import LAWS
from softcal_jax.mesh import (
    MeshWarning,
    TetMesh,
    locate,
    mesh_files,
    volumes,
)
from softcal_jax.project import ProjectWarning, load_project, toml_key, toml_value
from softcal_jax.results import results_folder, sections, text
from softcal_jax.robots import ready_made_path

DENSITY = 1070.0
"""Density of silicone [kg/m3]."""

_MOST_GROUPS = 40  # most groups of the mesh that are listed


def project_text(name: str, findings: Findings) -> str:
    """Write a project file of a name, with a remark at each value that is a guess."""
    sections = {
        "the body": _mesh(findings),
        "the material": _material(),
        "the actuators": _actuators(findings),
        "the markers": _marker_lines(findings),
        "the configurations": (*_shared(findings), "", *_configurations(findings)),
        "the settings": (
            "[settings]",
            'noise = "estimated" # from the residuals; '
            '"stated" takes the `std` as it is',
        ),
    }
    text = "\n".join(_title(name, findings))
    for title, lines in sections.items():
        text += "\n".join(("\n", f"# {'-' * (86 - len(title))} {title}", *lines))
    return f"{text}\n"


def _title(name: str, findings: Findings) -> Iterator[str]:
    files = {pose.file.name: None for pose in findings.poses}
    source = f"and {', '.join(files)}." if files else "alone, before any measurement."
    head = "# A calibration with softcal, written by `softcal new` from"
    yield f"{head} {findings.model}\n# {source}"
    yield """#
# What no file tells is a guess: such a line ends in a remark CHANGE. Correct it, or
# confirm it, and delete the remark. `softcal check` lists those that are left.
#
#   softcal check     project.toml                 what this file says, and a picture
#   softcal mesh      project.toml -o groups.msh   draws the groups of the mesh
#   softcal identify  project.toml                 would these poses tell?
#   softcal calibrate project.toml -o results      fit, predict, write results/
#
# Quantities are texts with their unit, three of them share one: "(0, 15, 36) mm".
# Plain numbers have no unit. Paths are relative to this file. Unknown keys are errors.
"""
    yield f"name = {toml_value(name)}"


def _mesh(findings: Findings) -> Iterator[str]:
    """Write [mesh] and [groups], with all groups of the file as comments."""
    body, held = findings.body, findings.held
    sides = readable_values(np.ptp(body.mesh.points, axis=0).tolist(), "m")
    yield "[mesh]"
    yield f"file = {toml_value(findings.model)}"
    if body.unit is not None:
        guess = f" # CHANGE: a guess, by which it is {sides}"
        yield f'length_unit = "{body.unit}"' + guess * body.unit_guessed
    if body.size is not None:
        yield f'size = "{body.size}" # edges of the tets; {body.why}'
    if body.drop_unused:
        yield 'unused_nodes = "drop" # the file has nodes that no cell uses'
    yield """element = "quadratic" # does not lock in bending; "linear" does
"""
    yield f"# {sides}. The mesh and its groups:"
    lines = text(sections(body.mesh)).splitlines()
    yield from (f"#   {line}" for line in lines[: _MOST_GROUPS + 1])
    if len(lines) > _MOST_GROUPS + 1:
        yield f"#   ... and {len(lines) - _MOST_GROUPS - 1} more: `softcal mesh`"
    if held.definition:
        moved = findings.recorded is not None and not findings.own_frame
        why = ", farther from the markers that move" * moved
        guess = f"# CHANGE: what is held, here an end of the body{why}"
        yield from ("", f"[groups.{held.group}] {guess}", *held.definition)
    for one in findings.actuated:
        yield from ("",) * bool(one.definition) + one.definition
    yield """
# Other parts, by where they are: box (lower, upper), sphere (centre, radius), points:
#   [groups.tip]
#   face = { points = ["(100, 5, 5) mm"] }                  # faces of a CAD model
#   [groups.wall]
#   inside = { point = "(30, 8, 6) mm", stop_at = "held" }  # the wall of a cavity"""


def _material() -> Iterator[str]:
    yield from textwrap.wrap(
        f"Laws: {', '.join(LAWS)}.", 88, initial_indent="# ", subsequent_indent="# "
    )
    yield f"""[material]
law = "neo-hookean"
E = "200 kPa" # CHANGE: the start; silicone has 50 to 500 kPa, printed TPU 5 to 50 MPa
nu = 0.49 # CHANGE: rubber hardly changes its volume; foam has 0.1 to 0.3
density = "{DENSITY:g} kg/m^3" # CHANGE: that of silicone; weigh the robot

# What is calibrated, between which bounds. Further ones: "nu", "density", constants of
# a region; and [[setup]] for what is not of the material, like recording_offset = true.
[[parameters]]
field = "E"
lower = "10 kPa"
upper = "100 MPa" # both far from what is likely"""


def _actuators(findings: Findings) -> Iterator[str]:
    """Write a chamber or a cable for each cavity."""
    for k, one in enumerate(findings.actuated):
        yield "\n" * (k > 0) + f"[actuators.{toml_key(one.name)}]"
        if one.group:
            yield 'type = "chamber"'
            what = f"# CHANGE: what is inflated, here {one.why}"
            yield f"surface = {toml_value(one.group)} {what}"
        else:
            yield 'type = "cable"'
            yield f"guides = [ # CHANGE: where it runs, here on the axis of {one.why}"
            yield from (f"  {in_mm(point)}," for point in one.guides)
            yield "]"
        if one.is_open:
            yield "seal = true # it has a rim: a lid without material closes it"
    if not findings.actuated:
        yield """# Actuators, a table each, driven by `actuation` of a pose:
#   [actuators.air]
#   type = "chamber"     # or "cable" (guides), "motor" (body), "point-force"
#   surface = "wall"
#   seal = true"""


def _marker_lines(findings: Findings) -> Iterator[str]:
    """Write where markers are glued: a guess, since gravity acts in every pose."""
    recorded = findings.recorded
    yield "# Where they are glued: on the body without load, in the frame of the mesh."
    if findings.own_frame:
        yield """# The recording has a frame of its own, off the mesh: measure where
# these are on the robot. Here they are only somewhere on it."""
    elif recorded is not None:
        rest = toml_value(recorded.rest.name)
        yield f"""# Readings do not tell, since gravity acts in all of them. These are
# the points of the mesh nearest to {rest}: measure them on the robot."""
    yield "[markers]"
    yield 'std = "0.5 mm" # CHANGE: how well a pose repeats'
    yield "\n[markers.positions]"
    for marker in findings.markers:
        remark = "where you glue it, and what it is called"
        if recorded is not None:
            off = readable_values([marker.distance], "m", digits=3)
            where = f"{off} from" if marker.distance else "inside"
            remark = f"where it is glued; recorded {where} the mesh"
        yield f"{toml_key(marker.name)} = {in_mm(marker.place)} # CHANGE: {remark}"


def _shared(findings: Findings) -> Iterator[str]:
    """Write what all configurations share."""
    held, recorded = findings.held, findings.recorded
    yield "# What all of them share; each may add to it or state its own."
    yield "[shared]"
    yield 'gravity = "(0, 0, -9.81) m/s^2" # CHANGE: down, in the frame of the mesh'
    known = " # CHANGE: what is held, here by its name" * (not held.definition)
    yield f"supports = [{{ group = {toml_value(held.group)} }}]{known}"
    off = "# " * findings.own_frame
    if recorded is None:
        return
    if findings.own_frame:
        yield """
# CHANGE: the recording is not used yet: its frame is not that of the mesh
# Write where its markers are, above, take the first `#` away here and below, and name
# three or more markers that do not move, here the three that move least: the rigid
# motion onto their positions takes one frame to the other."""
    files = {pose.file for pose in findings.poses}
    yield f"\n{off}[shared.measured]"
    if len(files) == 1:
        yield f"{off}file = {toml_value(recorded.rest.file.name)}"
    if recorded.unit is not None:
        guess = "# CHANGE: a guess, by the size of the mesh"
        yield f'{off}length_unit = "{recorded.unit}" {guess}'
    if recorded.others:
        yield """# Compared are motions from this pose: for them rough places of markers
# do. Once you measured these, delete the next line: then its sag counts too."""
        yield f"{off}displacement_from = {toml_value(recorded.rest.name)}"
    if findings.own_frame:
        listed = ", ".join(map(toml_value, recorded.stillest(3)))
        which = f"select = {recorded.rest.select}"
        yield f"{off}registration = {{ markers = [{listed}], {which} }}"
    elif recorded.over_time:
        yield "# Where cameras move in between: registration = { markers = [...] }"


def _configurations(findings: Findings) -> Iterator[str]:
    """Write the poses that were recorded, or two that might be."""
    weight = float(volumes(findings.body.mesh).sum()) * DENSITY * STANDARD_GRAVITY
    if findings.recorded is None:
        yield """# Once poses are recorded, as columns pose, marker, x_mm, y_mm, z_mm:
#   [shared.measured]
#   file = "markers.csv"
#   displacement_from = "hanging"
# and in each configuration: measured.select = { pose = "hanging" }
[[configurations]]
name = "hanging"

[[configurations]]"""
        yield 'name = "loaded"'
        yield from _driven(findings, (), weight)
        return
    last = len(findings.poses) - 1
    for k, pose in enumerate(findings.poses):
        unloaded = k == 0 < last and not any(s.value for s in pose.stated)
        yield "\n" * (k > 0) + "[[configurations]]"
        remark = " # CHANGE: here nothing acts but gravity" * unloaded
        yield f"name = {toml_value(pose.name)}{remark}"
        if 1 < k == last:
            yield 'role = "validation" # predicted after the fit, never used in it'
        if not unloaded:
            yield from _driven(findings, pose.stated, weight)
        yield from _measured(findings, pose)


def _driven(
    findings: Findings, stated: Sequence[Stated], weight: float
) -> Iterator[str]:
    """Write what acts in a pose: what is stated of it, else a guess.

    Pressures and volumes are of chambers, forces and lengths of cables, in their order.
    Other forces and masses hang on the tip, and where nothing is stated a weight [N].
    """
    actuation, sources, left = {}, [], [*stated]
    for one in findings.actuated:
        units = ("Pa", "m3") if one.group else ("N", "m")
        for acting in [s for s in left if s.unit in units][:1]:
            left.remove(acting)
            actuation[one.name] = acting.text
            sources.append(acting.source)
    hung = [s for s in left if s.unit in ("N", "kg") and s.value]
    for s in hung:
        weight = s.value * (STANDARD_GRAVITY if s.unit == "kg" else 1.0)
        sources.append(s.source)
    if not sources and findings.actuated:
        first = findings.actuated[0]
        actuation = {first.name: "10 kPa" if first.group else f"{weight:.1g} N"}
    remark = f"# CHANGE: by {listed([*dict.fromkeys(sources)])}"
    if not sources:
        remark = "# CHANGE: what acts in this pose"
    if actuation:
        yield f"actuation = {toml_value(actuation)} {remark}"
    if hung or not actuation:
        down = f'force = "(0, 0, -{weight:.{4 if hung else 1}g}) N"'
        yield f"loads = [{{ point = {in_mm(findings.tip)}, {down} }}] {remark}"


def _measured(findings: Findings, pose: RecordedPose) -> Iterator[str]:
    """Write where a pose is measured, and its markers where some were not seen."""
    recorded = findings.recorded
    assert recorded is not None
    off = "# " * findings.own_frame
    seen = [name for name in recorded.labels if name in pose.seen]
    if len(seen) < len(recorded.labels):
        listed = ", ".join(map(toml_value, seen))
        yield f"markers = [{listed}] # those that were seen"
    if len({any_pose.file for any_pose in findings.poses}) > 1:
        yield f"{off}measured.file = {toml_value(pose.file.name)}"
    if pose.select != "{}":
        check = " # CHANGE: when the robot stands still" * recorded.over_time
        yield f"{off}measured.select = {pose.select}{check}"


PROJECT = "project.toml"

_SAME_FRAME = 0.3
"""Distance from the mesh, as a share of its size, up to which markers share its frame.

Posts that carry markers are shorter; cameras stand farther away from the robot.
"""

_SAME_PLACE = 1e-6
"""Difference of distances, as a share of the size, that may be rounding."""


def write_ready_made(name: str, folder: Path) -> tuple[str, ...]:
    """Write the project file and the data of a ready-made robot into a new folder.

    Robots are named in `softcal_jax.robots.READY_MADE`. Returns the names of the files.

    Raises:
        ValueError: If there is no such robot, or the folder exists.
        OSError: If it cannot be written.
    """
    source = ready_made_path(name).parent
    files = sorted(path for path in source.iterdir() if path.is_file())
    _check_absent(folder)
    with results_folder(folder, replaceable=False) as made:
        for file in files:
            shutil.copyfile(file, made / file.name)
    return tuple(file.name for file in files)


def propose_project(
    model: Path,
    folder: Path,
    *,
    recordings: Sequence[Path] = (),
    size: float | None = None,
    length_unit: str | None = None,
) -> Findings:
    """Write a project for a mesh or CAD model, and guess what the files do not state.

    Each guess has a remark "# CHANGE: ..."; `load_project` warns of those that stay.

    Args:
        model: A mesh file, or a STEP or STL file.
        folder: The folder, which must not be there. Model and recordings are copied.
        recordings: A table of markers, or recordings over time, a pose in each.
        size: Edges of the tets of a CAD model; a twentieth of it by default [m].
        length_unit: Unit of the model; guessed where it states none.

    Raises:
        FileNotFoundError: If a file is not there.
        ValueError: If the folder is there, a file cannot be read, or no project can be
            made of what they hold.
        ImportError: If a file needs a package that is not installed.
        OSError: If the folder cannot be written.
    """
    _check_absent(folder)
    check_unique("file", [file.name for file in (model, *recordings)])
    body = read_body(model, size=size, length_unit=length_unit)
    recorded = None
    if recordings:
        recorded = read_recorded(recordings, float(np.ptp(body.mesh.points, 0).max()))
    findings = _find(model, body, recorded)
    with results_folder(folder, replaceable=False) as made:
        for file in (model, *recordings):
            if file is not model or findings.model == model.name:
                shutil.copyfile(file, made / file.name)
        text = project_text(folder.name, findings)
        (made / PROJECT).write_text(text, encoding="utf-8")
        with warnings.catch_warnings():  # `softcal check` shows them, with final paths
            warnings.simplefilter("ignore", MeshWarning)
            warnings.simplefilter("ignore", ProjectWarning)
            load_project(made / PROJECT, solve=False)
    return findings


def _find(model: Path, body: Body, recorded: Recorded | None) -> Findings:
    """Collect what the files state, and guess the rest."""
    mesh, located, own_frame = body.mesh, None, False
    if recorded is not None:
        located = locate(mesh, recorded.positions, max_distance=np.inf)
        own_frame = bool(located.distance.max() > _SAME_FRAME * mesh.size)
    moving = None if recorded is None or own_frame else recorded.moving
    held = propose_held(mesh, moving)
    tip = far_end(mesh, held)
    if recorded is None or located is None:
        middle = _on_top(mesh, 0.5 * (tip + held.centre))
        markers = MarkerPlace("tip", tip, 0.0), MarkerPlace("middle", middle, 0.0)
    else:
        # At the points of the mesh that are nearest to their readings.
        places = located.foot
        if own_frame:
            box = lambda points: 0.5 * (points.min(axis=0) + points.max(axis=0))
            shifted = recorded.positions + box(mesh.points) - box(recorded.positions)
            places = locate(mesh, shifted, max_distance=np.inf).foot
        placed = zip(recorded.labels, places, located.distance.tolist(), strict=True)
        markers = tuple(MarkerPlace(*each) for each in placed)
    # A file that includes others would have to be copied with all of them.
    alone = len(mesh_files(model)) == 1
    return Findings(
        model=model.name if alone else str(model.resolve()),
        body=body,
        held=held,
        tip=_within(mesh, tip),
        actuated=find_actuated(mesh),
        recorded=recorded,
        own_frame=own_frame,
        markers=markers,
    )


def _within(mesh: TetMesh, place: Float[HostArray, "3"]) -> Float[HostArray, "3"]:
    """Return the middle of a tet beside a place [m].

    A finer or coarser mesh has its skin elsewhere. Of tets that are as near, up to
    rounding, the first one counts, so that the place is the same on every machine.
    """
    away = np.linalg.norm(mesh.centroids - place, axis=1)
    return mesh.centroids[np.argmax(away <= away.min() + _SAME_PLACE * mesh.size)]


def _on_top(mesh: TetMesh, place: Float[HostArray, "3"]) -> Float[HostArray, "3"]:
    """Return a point of the skin above a place within, or at a larger x [m]."""
    # From the box around the mesh, since the nearest point may be in a cavity.
    low, high = mesh.points.min(axis=0), mesh.points.max(axis=0)
    side = 0 if np.argmax(high - low) == 2 else 2
    above = np.where(np.arange(3) == side, high, place)
    return locate(mesh, above[None], max_distance=np.inf).foot[0]


def _check_absent(folder: Path) -> None:
    """Raise ValueError if there is something where the folder is to be."""
    if folder.exists() or folder.is_symlink():
        raise ValueError(
            f"{folder} is there already, and nothing of it is overwritten. Choose "
            "another name."
        )
