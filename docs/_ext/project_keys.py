"""The pages of the keys of project files and of the commands, written to disk.

`python docs/_ext/project_keys.py` writes `docs/reference/project-file.md` from the
tables of the program: what a key expects is what an error says of it, and what it means
is in the docstring of what the table makes. In `docs/reference/commands.md` it writes
what each command prints with `--help`. A test fails where a page is out of date.
"""

import inspect
import re
from collections.abc import Iterator
from pathlib import Path
from types import NoneType
from typing import Any, Literal, NamedTuple, get_args, get_origin

from from_code import help_text
from pydantic import ValidationError

from softcal_jax import fields, mesh
from softcal_jax._units import readable
from softcal_jax.actuators import ACTUATORS, Guide
from softcal_jax.bodies import BodyState, Pose
from softcal_jax.configurations import (
    EFFECTORS,
    LOADS,
    Configuration,
    Support,
)
from softcal_jax.contact import SHAPES
from softcal_jax.equilibrium import build_model
from softcal_jax.exchange.camera import tag_pose
from softcal_jax.fields import (
    ControlPointParameters,
    Parameter,
    ParameterSpace,
)
from softcal_jax.materials import ELASTICITIES, LAWS
from softcal_jax.project import (
    Project,
    Table,
    _design,
    _reading,
    _robot,
    _sensors,
    _setup,
    toml_value,
)
from softcal_jax.project._laws import Material, material_table
from softcal_jax.project._markers import (
    MarkerEntry,
    MarkersTable,
    MeasuredTable,
    RegistrationTable,
    WindowTable,
)
from softcal_jax.project._quantities import _OF_UNIT
from softcal_jax.project._sensors import AnyEffector
from softcal_jax.project._table import Context, Maker, _in_words, table_of
from softcal_jax.readings import read_markers

PAGE = Path(__file__).parents[1] / "reference" / "project-file.md"
COMMANDS = PAGE.with_name("commands.md")

HEAD = """\
# Keys of a project file

Every key of every table. A quantity is a text with a unit, like `"200 kPa"`, in any
unit of its kind; "-" stands for no value. `[shared]` takes the keys of a configuration,
for all that do not give them themselves.

<!-- Written by `python docs/_ext/project_keys.py`. -->
"""

_FILE = "The file, relative to the project file."

MEANT = {
    "actuators": "Actuators, by name.",
    "after_event": "The event of the file from which times count.",
    "after_step_of": "The marker from whose step times count.",
    "angle": "Angle of the surface at an edge that the walk does not cross.",
    "angle_change": "Change of an angle that costs as much as a tolerance.",
    "angle_error": "Standard deviation of printed angles.",
    "angle_unit": "Unit of the angles of the tracker.",
    "at": "The time in the middle of the window.",
    "azimuth": "Angle of a tracker about z: R = Rz(azimuth) Ry(elevation) Rx(roll).",
    "base": "Frame of the tracker's base, or of the base tag.",
    "beam": "A box of tets with its size and cells.",
    "between": "The two times of the window.",
    "bodies": "Rigid bodies, by name; in a configuration their states.",
    "candidates": "Configurations that might be measured, with the same keys.",
    "configurations": "Poses that are fitted, predicted or have goals.",
    "control_points": "Sets of control points, by name.",
    "design": "What may be designed beside the parameters.",
    "directions": "Where fibres point in each tet; by default along axes of the mesh.",
    "each": "What has an error of its own: all share one by default.",
    "effectors": "What is measured beside markers, by name.",
    "elasticity": "The linear law of the corotational ones.",
    "element": "Kind of the tets.",
    "elevation": "Angle of a tracker about y.",
    "face": "The face of the body around each of some points.",
    "file": _FILE,
    "foam": "What is printed; without one, moduli are free within their bounds.",
    "format": "How the file is written.",
    "goal": "Goals of markers and effectors, in place of `measured`.",
    "groups": "Further groups of the mesh, by name.",
    "hinge": "Axis of a hinge, in place of `axes`.",
    "inside": "The wall of the cavity around a point.",
    "labels": "Names of markers in the file, by their names here.",
    "largest_stress": "Limit of the von Mises stress anywhere in the body.",
    "largest_stretch": "Limit of the stretch anywhere in the body.",
    "limit": "Largest error looked for; of a factor its largest value.",
    "limits": 'Limits of the actuators that are commanded: `"0 N to 5 N"`.',
    "markers": "The markers of the project.",
    "modulus_change": "Change of a modulus that costs as much as a tolerance.",
    "modulus_error": "Standard deviation of printed moduli, relative.",
    "newton": "Settings of the equilibrium.",
    "of": "What is selected in the region.",
    "orientation": "How the sensor or tag is mounted at rest.",
    "parameter_space": "What parameters have to do with one another.",
    "parameters": "What is calibrated.",
    "plateau": "Least length of a rest of the markers, which is searched for.",
    "position": "Position of the frame.",
    "print_plane": "The print plane of the fibre.",
    "prior_std": "Standard deviation of the prior about no error.",
    "quaternion": "Orientation as w, x, y, z.",
    "reachable": "Faces that a walk over the surface reaches from a point.",
    "recording": "Values of columns that all rows of this pose have.",
    "regions": "Constants of tet groups that differ, by name.",
    "registration": "How the frame of the cameras is brought onto that of the mesh.",
    "robust": "Whether the error as printed is to be least.",
    "role": "Whether the pose is fitted or only predicted.",
    "roll": "Angle of a tracker about x.",
    "rotation_vector": "Orientation as an axis times an angle.",
    "scatter": "Whether the scatter of a recording adds to the deviations.",
    "select": "Values of columns, or a window of time.",
    "sensor": "Name of the sensor, where the file has several.",
    "settings": "Settings of the calibration.",
    "setup": "Errors of the setup that are calibrated beside the material.",
    "shapes": "Ways in which the shape of the body may be off, by name.",
    "shared": "Keys that all configurations have.",
    "solid_modulus": "Young's modulus of the solid of the published foam.",
    "state": "How the body is held.",
    "station": "Number of the sensor, where the file has several.",
    "MarkerEntry.std": "Standard deviation of this marker.",
    "MarkersTable.positions": "Positions at rest, by name.",
    "MarkersTable.std": "Standard deviation of a marker; 1 mm only weighs them.",
    "read_mesh.file": _FILE,
    "mesh_cad.file": _FILE,
    "mesh_cad.size": "Longest edges of the tets that gmsh aims at.",
    "stop_at": "Surface groups at which the surface ends.",
    "table": "A table of moduli of your foam.",
    "tolerance": "Distance that still counts; by default a millionth of the mesh.",
    "turn_limit": "Largest rotation looked for; three more parameters.",
    "turn_prior_std": "Standard deviation of the prior of the rotation.",
    "uncertain": "How well everything is known that is not calibrated.",
    "width": "Length of the window around `at`.",
    "name": "Loads of a name share a factor, see `load_factor`.",
    "ConfigurationTable.measured": "What was measured: markers of a file, effectors.",
    "MarkerEntry.position": "Position at rest.",
    "ProjectTable.material": "The law and its constants.",
    "ProjectTable.mesh": "The mesh.",
    "ProjectTable.name": "Name of the project.",
    "MeasuredTable.displacement_from": "Where motion counts from: a configuration, or "
    "a window or rows of the same file.",
    "MeasuredTable.effectors": "Measured values of effectors, by name.",
    "PhotosTable.displacement_from": "Photographs of the pose that motion counts from.",
    "PoseFileTable.displacement_from": "Rows of the pose that motion counts from.",
    "RegistrationTable.axes": "Axes of the cameras along x, y and z of the mesh, where "
    "they are known.",
}
"""What a key means of which no docstring says it; alone, or after its table."""


class Section(NamedTuple):
    """A table of a project file.

    Attributes:
        title: Its place in the file, and what distinguishes it there.
        table: How it is read.
        sources: What its keys mean stands in the docstrings of these, and of what it
            makes.
    """

    title: str
    table: type[Table]
    sources: tuple[Any, ...] = ()


def sections() -> Iterator[Section]:
    """List the tables, in the order in which a file has them."""
    yield Section("The file", _reading.ProjectTable)
    yield Section("[mesh], a mesh file", _robot.MESH_FILE)
    yield Section("[mesh], a CAD model", _robot.CAD_MODEL)
    yield Section("[mesh], a box", _robot.BOX)
    yield Section("beam in [mesh]", _robot.BeamTable, (mesh.beam,))
    yield Section("[groups.NAME]", _robot.GroupTable)
    for key, field in _robot.GroupTable.model_fields.items():
        for table in get_args(field.annotation):
            if isinstance(table, type) and issubclass(table, Table):
                yield Section(f"{key} in [groups.NAME]", table)
    yield Section("[shapes.NAME]", table_of(mesh.surface_motion))
    yield Section("[material]", Material, (build_model,))
    yield from _laws()
    for name in _robot.DIRECTIONS:
        table = _of_type(_robot.AnyDirections, name)
        yield Section(f'directions in [material], type = "{name}"', table)
    yield Section("[bodies.NAME]", _robot.BodyTable)
    yield Section("mounting in [bodies.NAME]", table_of(Pose))
    for name in (*SHAPES, "surface"):
        table = _of_type(_robot.AnyShape, name)
        yield Section(f'shape in [bodies.NAME], type = "{name}"', table)
    for name in ACTUATORS:
        table = _of_type(_robot.AnyActuator, name)
        yield Section(f'[actuators.NAME], type = "{name}"', table)
    yield Section("An entry of guides", table_of(Guide))
    for name in EFFECTORS:
        table = _of_type(AnyEffector, name)
        yield Section(f'[effectors.NAME], type = "{name}"', table)
    yield Section("[markers]", MarkersTable)
    yield Section("A marker with its own std", MarkerEntry)
    yield Section("[control_points.NAME]", _of_type(_setup.AnyControlPoints))
    several = Parameter, ControlPointParameters
    yield Section("[[parameters]]", _setup.ParameterTable, several)
    yield Section("[parameter_space]", _setup.ParameterSpaceTable, (ParameterSpace,))
    for table in _setup._TABLES:
        yield Section(f"[[setup]], {_own_key(table)}", table)
    yield Section("[[configurations]]", _design.ConfigurationTable, (Configuration,))
    yield Section("gravity by size", table_of(_design.acceleration))
    yield Section("An entry of supports", table_of(Support))
    for load in LOADS:
        yield Section(f"An entry of loads, {load.__name__}", table_of(load))
    yield Section("A state in bodies", _robot.BodyStateTable, (BodyState,))
    yield Section("measured in [[configurations]]", MeasuredTable, (read_markers,))
    yield Section("A window of time, for select", WindowTable)
    yield Section("registration in measured", RegistrationTable)
    yield Section("A pose of an effector, written", _sensors.WrittenPoseTable)
    yield Section("A pose, from a table", _sensors.PoseFileTable, (read_markers,))
    yield Section("A pose, from a Polhemus tracker", _sensors.PolhemusFileTable)
    yield Section("A pose, from photographs", _sensors.PhotosTable, (tag_pose,))
    yield Section("displacement_from of photographs", _sensors.EarlierPhotosTable)
    yield Section("base of a frame", _sensors.FrameTable)
    yield Section("[design]", _design.DesignTable)
    yield Section("[uncertain]", _of_type(_setup.AnyUncertain))
    yield Section("[settings]", _reading.SettingsTable, (Project,))
    yield Section("[newton]", _reading.NewtonTable, (build_model,))


def _of_type(annotation: Any, name: str = "") -> type[Table]:
    (choice,) = annotation.__metadata__
    return choice.choose({"type": name}, ())


def _own_key(table: type[Table]) -> str:
    """Return the key by which a table of [[setup]] is known."""
    return next(key for key in table.model_fields if hasattr(fields, key))


def _laws() -> Iterator[Section]:
    for name, law in LAWS.items():
        table = material_table({"law": name})
        yield Section(f'[material], law = "{name}"', table, (law,))
    for name, kind in ELASTICITIES.items():
        table = material_table({"law": "corotational", "elasticity": name})
        yield Section(f'[material], elasticity = "{name}"', table, (kind,))


class Row(NamedTuple):
    """A key: what it expects, its default, and what it means."""

    key: str
    expected: str
    default: str
    meaning: str


def rows(section: Section) -> list[Row]:
    """List the keys of a table; those of all laws stand under [material]."""
    table = section.table
    law = issubclass(table, Material) and table is not Material
    hidden = {"type", "law"} | (set(Material.model_fields) if law else set())
    return [
        Row(key, _value(table, key), _default(table, key), _meaning(section, key))
        for key in table.model_fields
        if key not in hidden
    ]


def _value(table: type[Table], key: str) -> str:
    """Return what a key expects, with an example of its own if there is one."""
    expected, example = _expected(table, key), _example(table, key)
    if not example or example in expected or issubclass(table, _setup.SetupTable):
        return expected
    # Three numbers have no name of their own, but a unit like that of their example.
    kind = re.sub(r', like ".*\) (.*)"', r" like \1", expected).partition(", like")[0]
    return f"{kind}: {example}"


def _example(table: type[Table], key: str) -> str:
    return (table.model_fields[key].description or "").partition(": ")[2]


def _expected(table: type[Table], key: str) -> str:
    """Return the choices of a key, or else what an error says that it expects."""
    kind = table.model_fields[key].annotation
    if get_args(kind)[1:] == (NoneType,):
        kind = get_args(kind)[0]
    if get_origin(kind) is Literal:
        return " or ".join(map(toml_value, get_args(kind)))
    said = (_refused(table, key, value) for value in (True, 2.5, "?"))
    if (expected := next(filter(None, said), "a value")) != "a list in [ ]":
        return expected
    named = "" if _refused(table, key, "?") else "a text in quotes, or "
    return f"{named}a list"


def _refused(table: type[Table], key: str, value: Any) -> str:
    """Return what an error says that a key expects in place of a value."""
    try:
        table.model_validate({key: value}, context=Context(Path()))
    except ValidationError as error:
        for details in error.errors():
            text = _in_words(details) if details["loc"][:1] == (key,) else ""
            if found := re.search(r"expected (.*?)\.?( Did you.*)?$", text):
                words = found[1].partition(", unable")[0].replace("a valid", "a")
                return words.replace(", in quotes and with its unit", "")
    return ""


def _default(table: type[Table], key: str) -> str:
    """Return the default of a key as a project file writes it."""
    field = table.model_fields[key]
    value: Any = field.get_default(call_default_factory=True, validated_data={})
    if field.is_required():
        return "must be given"
    if isinstance(value, bool | str):
        return toml_value(value)
    expected = _expected(table, key)
    unit = next((d.si for d in _OF_UNIT.values() if d.name in expected), "")
    if type(value) is float:  # those of effectors are in a unit of their own
        share = f"{100 * value:g} %" if "share" in expected else f"{value:g}"
        return readable(value, unit) if unit else share
    if value == (0.0, 0.0, 0.0):
        return "(0, 0, 0)"
    return f"{value}" if isinstance(value, int) else "-"


def _meaning(section: Section, key: str) -> str:
    """Return what a key means.

    Raises:
        ValueError: If nothing says it.
    """
    table, name, sources = section.table, key, [*section.sources]
    if issubclass(table, Maker):
        sources.append(table.makes)
        name = {k: name for name, k in table.key_of.items()}.get(key, key)
    own = f"{table.__name__}.{key}"
    documented = next(filter(None, (_documented(s, name) for s in sources)), "")
    words = MEANT.get(own) or documented or MEANT.get(key) or _made(table, key)
    words = words or (table.model_fields[key].description or "").partition(": ")[0]
    if not words:
        raise ValueError(f"say in MEANT what {own} means.")
    return re.sub(r" \[[\w/ ^-]+\]", "", words[0].upper() + words[1:].rstrip(".")) + "."


def _made(table: type[Table], key: str) -> str:
    """Return what is made of a key: a kind of [[setup]], or a region of a group."""
    parts = get_args(table.model_fields[key].annotation)
    made = [part.makes for part in parts if hasattr(part, "key_of")]
    if issubclass(table, _setup.SetupTable) and hasattr(fields, key):
        made = [getattr(fields, key)]
    return (inspect.getdoc(made[0]) or "").split("\n")[0] if made else ""


def _documented(source: Any, name: str) -> str:
    """Return what the docstring of a class or a function says of a name."""
    for kind in getattr(source, "__mro__", [source]):
        text = inspect.cleandoc(kind.__doc__ or "")
        _, *parts = re.split(r"^(?:Args|Attributes):$", text, flags=re.M)
        found = re.search(rf"^    {name}: (.*(?:\n {{8}}.*)*)", "".join(parts), re.M)
        if found:
            return " ".join(found[1].split())
    return ""


def keys_page() -> str:
    """Return the page."""
    lines = [HEAD]
    for section in sections():
        table = rows(section)
        lines += [f"## {section.title}", ""]
        if not table:
            lines += ["It has no keys of its own.", ""]
            continue
        lines += ["| key | value | default | meaning |", "|---|---|---|---|"]
        for key, *cells in table:
            escaped = (cell.replace("|", "&#124;") for cell in cells)
            lines.append(f"| `{key}` | {' | '.join(escaped)} |")
        lines.append("")
    return "\n".join(lines)


def commands_page() -> str:
    """Return the page of commands, with what each prints with `--help` now."""
    block = r"(?ms)^(## softcal ?([^\n]*)\n\n)```text\n.*?\n```$"
    shown = lambda found: f"{found[1]}```text\n{help_text(found[2])}\n```"
    return re.sub(block, shown, COMMANDS.read_text(encoding="utf-8"))


if __name__ == "__main__":
    PAGE.write_text(keys_page(), encoding="utf-8")
    COMMANDS.write_text(commands_page(), encoding="utf-8")
