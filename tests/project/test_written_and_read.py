"""What is written is read: quantities, project files of designs, names of any kind."""

import csv
import tomllib
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import strategies as st
from project.test_any_input import WORDS, as_toml, check, number_of_examples
from robot_project import PROJECT

from softcal_jax import fields
from softcal_jax._units import UNITS, readable, readable_values
from softcal_jax.configurations import ImposedDisplacement, ImposedForce
from softcal_jax.exchange.proposal import propose_project
from softcal_jax.materials import LAWS
from softcal_jax.mesh import beam, read_mesh, write_mesh
from softcal_jax.project import (
    _goals,
    load_project,
    parse_in_si,
    printed_project,
    toml_key,
    toml_value,
)
from softcal_jax.project._laws import material_table

NUMBERS = st.floats(1e-12, 1e12) | st.floats(-1e12, -1e-12)

ODD = ["a  b", "1.5 bar", "a/b", "Spitze ü", '5" rod', "it's", '"q"', "a\\\\", "file"]
NAMES = st.sampled_from(ODD) | WORDS.map(str.strip).filter(
    lambda name: name.isprintable() and name and not name.startswith(("'", "#"))
)
"""Names as people give them, and any others that no table changes or leaves out."""


def units():
    """SI units of all that is calibrated, imposed or measured, and all that is read."""
    of_laws = [
        constant["unit"]
        for law in LAWS
        for constant in material_table({"law": law}).constants.values()
    ]
    of_setup = [kind.unit for kind in fields.KINDS.values()]
    return sorted({*UNITS, *of_laws, *of_setup} - {""})


@pytest.mark.parametrize("unit", units())
def test_quantities(unit):
    """In the unit in which they read best, with the digits that are written."""

    def once(value):
        assert parse_in_si(readable(value, unit), unit) == pytest.approx(value, 1e-5)
        assert parse_in_si(f"{value!r} {unit}", unit) == value

    check(20, NUMBERS, once)
    shown = {"rad": "deg"}.get(unit, unit)
    assert readable_values([0.0, 0.0], unit) == f"(0, 0) {shown}"


@number_of_examples(60, 2000)
def test_any_document(n):
    leaves = st.booleans() | st.integers(-(2**63), 2**63 - 1) | WORDS
    leaves |= st.floats(allow_nan=False)
    values = st.recursive(
        leaves,
        lambda inner: (
            st.lists(inner, max_size=3) | st.dictionaries(WORDS, inner, max_size=3)
        ),
        max_leaves=8,
    )

    def once(raw):
        assert tomllib.loads(_goals._document(raw)) == raw
        assert tomllib.loads(f"{toml_key('ü.')} = {toml_value(raw)}") == {"ü.": raw}

    check(n, st.dictionaries(WORDS, values, max_size=4), once)


ROUGH = """\
"(20, 10, 20) mm", "(40, 10, 20) mm"]
friction = 0.1
pulled_from = "last"
"""

DESIGN = """\
[[configurations]]
name = NAME
actuation = { arm = "1 N*mm", left = { value = "1 mm", releasing = true } }

[[parameters]]
field = "E"
lower = "123456.7890123 Pa"
upper = "1 MPa"

[[setup]]
motor_zero = "arm"
limit = "3 deg"

[design.limits]
arm = "0 N m to 0.05 N m"
left = "0 mm to 5 mm"
NAME = "0 Pa to 1 kPa"
"""


@number_of_examples(10, 300)
@pytest.mark.usefixtures("unchecked")  # a namespace stands for the design
@pytest.mark.filterwarnings("ignore:.*what the body resists")  # any number is written
def test_the_project_of_a_design(tmp_path, n):
    """A torque, a value on its bound, a cable that is let go, a goal in [shared]."""

    def once(name, torque, pressure):
        quoted = as_toml(name)
        text = PROJECT.partition("[[configurations]]")[0] + DESIGN
        text = text.replace("[actuators.blow]", f"[actuators.{quoted}]")
        text = text.replace('"(40, 10, 20) mm"]\n', ROUGH)
        text = text.replace("[shared]", '[shared]\ngoal = { torque = "10 N*mm" }')
        (tmp_path / "project.toml").write_text(text.replace("NAME", quoted))
        project = load_project(tmp_path / "project.toml", solve=False)
        (goal,) = project.asked.goals
        asked = {
            "arm": ImposedForce(torque),
            "left": ImposedDisplacement(1.2345678901234e-3, releasing=True),
            name: ImposedForce(pressure),
        }
        lowest = float(project.parameters[0].lower)
        found = SimpleNamespace(
            values={"E": np.nextafter(lowest, 0.0)},
            configurations=[replace(goal, actuation=asked)],
        )
        folder = tmp_path / "the design"
        folder.mkdir(exist_ok=True)
        printed = folder / "project.toml"
        printed.write_text(printed_project(project, found, folder))
        again = load_project(printed, solve=False)
        (pose,) = again.calibration
        assert (pose.name, pose.actuation) == (name, asked)
        assert float(again.parameters[0].start) == lowest
        assert again.asked.goals == ()

    names = NAMES.filter(lambda name: name not in ("arm", "left", "push", "spread"))
    values = st.floats(0.0, 0.05), st.floats(0.0, 1e3)
    check(n, st.tuples(names, *values), lambda given: once(*given))


def test_files_are_found_from_the_folder_of_the_design():
    """A mesh beside the project, and photographs; but a marker "file" is no file."""
    tag = {"photos": ["a.jpg"], "board": "../b.jpg", "tag": 3}
    moved = {"photos": ["../a.jpg"], "board": "../../b.jpg", "tag": 3}
    pose = {"goal": {"file": "1 mm"}, "measured": {"effectors": {"board": tag}}}
    raw = {
        "mesh": {"file": "finger.msh"},
        "bodies": {"file": {"shape": {"type": "surface", "file": "a.stl"}}},
        "markers": {"positions": {"file": "(1, 2, 3) mm", "board": "(0, 0, 0) mm"}},
        "shared": {"measured": {"file": "a.csv", "select": {"file": "1"}}},
        "configurations": [pose],
    }
    wanted = {
        "mesh": {"file": "../finger.msh"},
        "bodies": {"file": {"shape": {"type": "surface", "file": "../a.stl"}}},
        "markers": raw["markers"],
        "shared": {"measured": {"file": "../a.csv", "select": {"file": "1"}}},
        "configurations": [{**pose, "measured": {"effectors": {"board": moved}}}],
    }
    assert _goals._moved(raw, _goals.Path("..")) == wanted


@number_of_examples(30, 500)
def test_groups_of_a_mesh(tmp_path, n):
    """Of faces, tets and nodes, through Gmsh's format."""
    bar = beam(0.06, 0.02, 0.02, (2, 1, 1))

    def once(name):
        made = bar.with_surface_group(name, bar.surface_groups["x_max"])
        made = made.with_tet_group(f"{name} tets", [0, 1])
        made = made.with_node_group(f"nodes {name}", [3])
        write_mesh(made, tmp_path / "bar.msh", length_unit="mm")
        again = read_mesh(tmp_path / "bar.msh", length_unit="mm")
        assert len(again.faces(name)) == 2
        assert len(again.tets_of(f"{name} tets")) == 2
        assert again.nodes(f"nodes {name}").tolist() == [3]  # as they were numbered

    check(n, NAMES.filter(lambda name: name not in bar.node_groups), once)


@number_of_examples(10, 300)
def test_a_proposed_project(tmp_path, n):
    """With files, columns, poses and markers of these names."""
    places = (60, 10, 10), (60, 10, 20), (5, 0, 5)
    write_mesh(beam(0.06, 0.02, 0.02, (2, 1, 1)), tmp_path / "bar.msh")
    taken = {"marker", "x_mm", "y_mm", "z_mm", "rest", "bar.msh"}

    def once(name):
        file = tmp_path / (name.replace("/", "").replace("\\", "") + ".csv")
        with file.open("w", newline="") as table:
            rows = csv.writer(table, quoting=csv.QUOTE_ALL)
            rows.writerow([name, "marker", "x_mm", "y_mm", "z_mm"])
            for pose in ("rest", name):
                for number, place in enumerate(places):
                    rows.writerow([pose, f"{name} {number}", *place])
        folder = tmp_path / f"made {len([*tmp_path.iterdir()])}"
        propose_project(tmp_path / "bar.msh", folder, recordings=[file])
        project = load_project(folder / "project.toml", changes={}, solve=False)
        assert [c.name for c in project.calibration] == ["rest", name]
        markers = project.calibration[0].markers
        assert markers.names == tuple(f"{name} {k}" for k in range(3))
        file.unlink()

    check(n, NAMES.filter(lambda name: name not in taken), once)


@pytest.mark.parametrize("key", ["configurations.{}.role", 'configurations."{}".role'])
def test_a_configuration_is_addressed_by_its_name(tmp_path, key):
    """Whatever dots it has, and beside one with the first part of it."""
    name = "1.5.up 2"
    text = PROJECT.replace('name = "up"', f'name = "{name}"')
    text = text.replace('"let go"', '"1"')
    (tmp_path / "project.toml").write_text(text)
    changes = {key.format(name): "validation", "configurations.1.role": "calibration"}
    project = load_project(tmp_path / "project.toml", changes=changes, solve=False)
    assert [c.name for c in project.validation] == [name]
    more = {f"configurations.{name}.actuation": {}, "actuators.blow": None}
    more[f'configurations.{name}.actuation."a.b"'] = "10 Pa"
    more['actuators."a.b"'] = {"type": "surface-pressure", "surface": "z_min"}
    more["configurations.crushed.actuation"] = {}
    project = load_project(tmp_path / "project.toml", changes=more, solve=False)
    (pose, *_) = project.calibration
    assert pose.actuation == {"a.b": ImposedForce(10.0)}
    with pytest.raises(ValueError, match=r"there is no '2'.*1\.5\.up 2, 1, crushed"):
        load_project(tmp_path / "project.toml", changes={"configurations.2.5.role": ""})
