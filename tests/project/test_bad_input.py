"""Project files that must be refused: each names the key and says what to write."""

import json
import re

import jax
import meshio
import pytest
from small_project import write_small_project
from wording import saying, says

from softcal_jax.project import ProjectError, load_project

BEAM = 'beam = { size = "(60, 20, 20) mm", cells = [3, 1, 1] }'


def refusal(folder, *changes):
    path = write_small_project(folder, *changes)
    with pytest.raises(ProjectError) as caught:
        load_project(path)
    text = str(caught.value)
    assert text.startswith(f"{path}: ")
    return text.removeprefix(f"{path}: ")


CASES = {
    "unknown key": (
        ('element = "linear"', 'elemnt = "linear"'),
        'mesh.elemnt: unknown key ... mean "element" ... Known here: element, beam',
    ),
    "key of the other kind of mesh": (
        ('element = "linear"', 'unused_nodes = "drop"'),
        "mesh.unused_nodes: unknown key ... Known here: element, beam",
    ),
    "unknown key of an entry": (
        ('group = "x_min"', 'grup = "x_min", group = "x_min"'),
        'shared.supports[1].grup: unknown key ... mean "group"',
    ),
    "unknown key of a shared table": (
        ("displacement_from =", "displacement_form ="),
        'shared.measured.displacement_form: unknown key ... mean "displacement_from"',
    ),
    "unknown shared key": (
        ("[shared.measured]", "[shared.measurd]"),
        'shared.measurd: unknown key ... mean "measured"',
    ),
    "unknown key of a marker": (
        ('std = "0.2 mm"', 'sdt = "0.2 mm"'),
        'markers.positions.side.sdt: unknown key ... mean "std"',
    ),
    "unknown table": (
        ("[groups.tip]", "[group.tip]"),
        'group: unknown key ... mean "groups" ... Known here: name, mesh',
    ),
    "missing key": (
        ("nu = 0.3\n", ""),
        "material.nu: missing ... 0.499",
    ),
    "missing gravity": (
        ('gravity = "(0, 0, -9.81) m/s^2"\n', ""),
        'configurations.weight.gravity: missing ... "(0, 0, -9.81) m/s^2" ... [shared]',
    ),
    "unknown unit": (
        ('E = "200 kPa"', 'E = "200 kpa"'),
        'material.E: "200 kpa": unknown unit "kpa" ... "200 kPa" ... mean "kPa"',
    ),
    "wrong dimension": (
        ('density = "1 g/cm^3"', 'density = "1 g/cm^2"'),
        'material.density: "1 g/cm^2": "g/cm^2" is not a density ... "1070 kg/m^3"',
    ),
    "bare number": (
        ('lower = "100 kPa"', "lower = 100000"),
        'parameters.E.lower: 100000 has no unit ... "200 kPa"',
    ),
    "text for a number": (
        ("nu = 0.3", 'nu = "0.3"'),
        'material.nu: got "0.3" ... number',
    ),
    "fraction of a cell": (
        ("cells = [3, 1, 1]", "cells = [3, 1.5, 1]"),
        "mesh.beam.cells[2]: got 1.5 ... whole number",
    ),
    "two cells": (
        ("cells = [3, 1, 1]", "cells = [3, 1]"),
        "mesh.beam.cells[3]: missing",
    ),
    "four cells": (
        ("cells = [3, 1, 1]", "cells = [3, 1, 1, 1]"),
        "mesh.beam.cells: ... 3 values, got 4",
    ),
    "no cells": (
        ("cells = [3, 1, 1]", "cells = [3, 0, 1]"),
        "mesh: cells ... positive integers, got (3, 0, 1)",
    ),
    "unknown law": (
        ('law = "neo-hookean"', 'law = "neo-hokean"'),
        'material.law: got "neo-hokean" ... "neo-hookean", "mooney-rivlin", "yeoh", '
        '"ogden", "gent", "corotational", "classical-corotational", '
        '"st-venant-kirchhoff", "transverse-hyperelastic", "fibre-reinforced" ... '
        'mean "neo-hookean"',
    ),
    "a law that is a list": (
        ('law = "neo-hookean"', 'law = ["neo-hookean"]'),
        "material.law: got ['neo-hookean'] ... \"neo-hookean\"",
    ),
    "nu": (
        ("nu = 0.3", "nu = 0.5"),
        "material: nu ... (-1, 0.5), got 0.5",
    ),
    "unknown region": (
        ("[[parameters]]", '[material.regions.tipp]\nE = "1 MPa"\n\n[[parameters]]'),
        "material: unknown tet group 'tipp'",
    ),
    "unknown parameter": (
        ('field = "E"', 'field = "young"'),
        'parameters.young.field: got "young" ... "E", "nu", "density"',
    ),
    "bounds crossed": (
        ('lower = "100 kPa"', 'lower = "2 MPa"'),
        "parameters.E: ... crossed ... lower 2 MPa ... upper 1 MPa",
    ),
    "start outside": (
        ('lower = "100 kPa"', 'lower = "250 kPa"'),
        "parameters.E: ... start 200 kPa ... lower 250 kPa ... upper 1 MPa",
    ),
    "negative modulus": (
        ('lower = "100 kPa"', 'lower = "-1 Pa"\nscale = "linear"'),
        "parameters: ... lower bound: E must be positive ... got -1",
    ),
    "bounds of nu": (
        (
            'field = "E"\nlower = "100 kPa"\nupper = "1 MPa"',
            'field = "nu"\nlower = 0.2\nupper = 0.5',
        ),
        "parameters: ... upper bound: nu ... (-1, 0.5), got 0.5",
    ),
    "parameter twice": (
        (
            "[markers]\n",
            '[[parameters]]\nfield = "E"\nlower = "1 kPa"\nupper = "1 MPa"\n'
            "[markers]\n",
        ),
        "parameters: ... 'E' ... more than once",
    ),
    "nothing clamped": (
        ('supports = [{ group = "x_min" }]', "supports = []"),
        "configurations: ... 'weight' is not held ... 0 nodes ... 6 of the 6 rigid "
        "motions ... supports",
    ),
    "held too little": (
        ('group = "x_min"', 'group = "x_min", axes = "z"'),
        "configurations: ... 'weight' is not held ... 4 nodes",
    ),
    "unknown group": (
        ('group = "x_min"', 'group = "x_mn"'),
        "configurations.weight.supports[1]: unknown group 'x_mn' ... mean 'x_min'",
    ),
    "unknown axes": (
        ('group = "x_min"', 'group = "x_min", axes = "xw"'),
        "configurations.weight.supports[1]: axes ... 'xw'",
    ),
    "empty group": (
        ('point = "(60, 0, 0) mm"', 'point = "(61, 0, 0) mm"'),
        "groups.tip: no node lies in",
    ),
    "group without a place": (
        ("plane = {", 'of = "faces"\n#'),
        "groups.tip: ... one of box, plane, sphere, cylinder, annulus, face, "
        "reachable, inside; got none",
    ),
    "load without a force": (
        (', force = "(20, 0, -50) mN"', ""),
        "configurations.pulled.loads[1]: ... got surface.",
    ),
    "force at nothing that is known": (
        ('surface = "x_max", force', 'point = "(60, 0, 0) mm", forse'),
        "configurations.pulled.loads[1].force: missing",
    ),
    "load in two places": (
        ('surface = "x_max", force', 'surface = "x_max", edge = "x_max", force'),
        "configurations.pulled.loads[1]: ... got surface and edge and force",
    ),
    "traction on an edge": (
        (
            'surface = "x_max", force = "(20, 0, -50) mN"',
            'edge = "x_max", traction = "(0, 0, 1) kPa"',
        ),
        "configurations.pulled.loads[1]: ... one of point and force, edge and force, "
        "surface and force, surface and traction; got edge and traction",
    ),
    "load on an unknown surface": (
        ('surface = "x_max"', 'surface = "tip"'),
        "configurations.pulled.loads[1]: 'tip' is a group of nodes ... of = \"faces\"",
    ),
    "marker far outside": (
        ('tip = "(60, 10, 10) mm"', 'tip = "(600, 10, 10) mm"'),
        "configurations: ... 'weight': marker 'tip' ... (600, 10, 10) mm ... 540 mm "
        "from the mesh ... 10 mm",
    ),
    "unknown marker": (
        ('markers = ["tip", "side"]', 'markers = ["tip", "sides"]'),
        'configurations.weight.markers: ... "sides" ... mean "side" ... '
        "tip, side, a, b, c",
    ),
    "marker twice": (
        ('markers = ["tip", "side"]', 'markers = ["tip", "tip"]'),
        "configurations.weight.markers: ... 'tip' ... more than once",
    ),
    "marker of a wrong kind": (
        ('markers = ["tip", "side"]', "markers = [1]"),
        "shared.markers[1]: got 1 ... quotes",
    ),
    "no precision": (
        ('std = "0.1 mm"', 'std = "0 mm"'),
        'markers.std: got "0 mm" ... above zero',
    ),
    "registration on a line": (
        ('markers = ["a", "b", "c"]', 'markers = ["a", "b"]'),
        "configurations.weight.measured: registration ... 3 finite markers, got 2",
    ),
    "missing file": (
        ('file = "markers.csv"', 'file = "marker.csv"'),
        "configurations.weight.measured: marker file ",
    ),
    "unknown recording": (
        ('recording = { run = "pulled" }', 'recording = { run = "pull" }'),
        "configurations.pulled.measured: ... run = pull, phase = loaded",
    ),
    "configuration twice": (
        ('name = "pulled"', 'name = "weight"'),
        "configurations: ... 'weight' is named more than once",
    ),
    "unknown role": (
        ('role = "validation"', 'role = "validaton"'),
        'configurations.pulled.role: got "validaton" ... "calibration", "validation" '
        '... mean "validation"',
    ),
    "gravity of one number": (
        ('gravity = "(0, 0, -9.81) m/s^2"', 'gravity = "9.81 m/s^2"'),
        'shared.gravity: got "9.81 m/s^2" ... three numbers with a unit',
    ),
    "direction of gravity": (
        (
            'gravity = "(0, 0, -9.81) m/s^2"',
            'gravity = { size = "9.81 m/s^2", direction = "down" }',
        ),
        'shared.gravity.direction: got "down" ... "-z" or [0, 0, -1]',
    ),
    "tolerance": (
        (
            '[[configurations]]\nname = "weight"',
            '[settings]\ntol = 2.0\n\n[[configurations]]\nname = "weight"',
        ),
        "settings: tol ... (0, 1), got 2.0",
    ),
    "level of intervals": (
        (
            '[[configurations]]\nname = "weight"',
            '[settings]\nintervals = 95\n\n[[configurations]]\nname = "weight"',
        ),
        "settings.intervals: ... got 95",
    ),
    "precision": (
        (
            '[[configurations]]\nname = "weight"',
            '[settings]\nprecision = 0.0\n\n[[configurations]]\nname = "weight"',
        ),
        "settings.precision: got 0.0 ... more than 0",
    ),
    "newton": (
        (
            '[[configurations]]\nname = "weight"',
            '[newton]\nmax_steps = 0\n\n[[configurations]]\nname = "weight"',
        ),
        "newton: max_steps ... between 1 and 2147483647, got 0",
    ),
    "newton overflow": (
        (
            '[[configurations]]\nname = "weight"',
            "[newton]\nmax_steps_per_load = 99999999999\n\n"
            '[[configurations]]\nname = "weight"',
        ),
        "newton: max_steps_per_load ... between 1 and 2147483647, got 99999999999",
    ),
    "settings overflow": (
        (
            '[[configurations]]\nname = "weight"',
            "[settings]\nmax_steps = 99999999999\n\n"
            '[[configurations]]\nname = "weight"',
        ),
        "settings: max_steps ... between 1 and 1000000, got 99999999999",
    ),
    "solver": (
        (
            '[[configurations]]\nname = "weight"',
            '[newton]\nsolver = "multi"\n\n[[configurations]]\nname = "weight"',
        ),
        'newton.solver: got "multi" ... "pardiso", "klu", "pardiso-host"',
    ),
    "mesh from nowhere": (
        (BEAM, ""),
        "mesh: ... one of file and length_unit, file and size, beam; got none",
    ),
    "mesh without a unit": (
        (BEAM, 'file = "robot.msh"'),
        'mesh.length_unit: missing ... "mm"',
    ),
    "missing mesh": (
        (BEAM, 'file = "robot.msh"\nlength_unit = "mm"'),
        "mesh: mesh file ",
    ),
    "no markers": (
        ("[markers.positions]", "[markers.position]"),
        'markers.position: unknown key ... mean "positions"',
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_refused(tmp_path, case):
    change, message = CASES[case]
    lines = refusal(tmp_path, change).split("\n- ")
    assert says(lines, message)


def test_every_problem_is_listed_once(tmp_path):
    text = refusal(
        tmp_path,
        ('element = "linear"', 'elemnt = "linear"'),
        ('E = "200 kPa"', "E = 200000"),
        ('select = { phase = "loaded" }', "select = 3"),
    )
    first, *problems = text.split("\n- ")
    assert first == "3 problems."
    assert [problem.split(":")[0] for problem in problems] == [
        "mesh.elemnt",
        "material.E",
        "shared.measured.select",
    ]


def test_selection_lists_what_is_there(tmp_path):
    text = refusal(tmp_path, ('{ run = "pulled" }', '{ run = "pull" }'))
    assert says(text, "run = pull ... there: ... pulled")


TIP = "weight,loaded,tip,124.627615364"


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (TIP, "weight,loaded,tip,nan", "line 7: ... 'tip' ... not finite"),
        (TIP, "weight,loaded,tip,", "line 7: ... 'tip' ... missing"),
        (TIP, "weight,loaded,tip,1O", "'1O' ... not a number"),
        ("weight,loaded,side", "weight,loaded,tip", "'tip' ... twice ... lines 7"),
        ("weight,loaded,side", "weight,loaded,new", "no marker 'side'"),
        ("run,phase,marker", "run,state,marker", "'phase' is missing"),
    ],
)
def test_bad_measurements(tmp_path, old, new, message):
    path = write_small_project(tmp_path)
    csv = path.with_name("markers.csv")
    text = csv.read_text()
    assert text.count(old) == 1
    csv.write_text(text.replace(old, new))
    message = saying("configurations.weight.measured:", message)
    with pytest.raises(ProjectError, match=message):
        load_project(path)


def test_bad_mesh(tmp_path):
    """What `mesh` refuses is told with the file and the key."""
    points = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]]
    meshio.Mesh(points, [("tetra", [[0, 2, 1, 3]])]).write(tmp_path / "bad.vtu")
    text = refusal(tmp_path, (BEAM, 'file = "bad.vtu"\nlength_unit = "mm"'))
    assert re.match(r"mesh: .*bad\.vtu: .*1 of 1 tets", text)


def test_no_such_file(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"no\.toml .*not exist"):
        load_project(tmp_path / "no.toml")


def test_directory(tmp_path):
    with pytest.raises(ProjectError, match="is a directory"):
        load_project(tmp_path)


@pytest.mark.parametrize(
    "content", [b"[mesh", b"\xff\xfe\x00", json.dumps({}).encode()]
)
def test_no_toml(tmp_path, content):
    path = tmp_path / "project.toml"
    path.write_bytes(content)
    with pytest.raises(ProjectError, match=r"project\.toml .* TOML: "):
        load_project(path)


def test_empty_file(tmp_path):
    path = tmp_path / "project.toml"
    path.write_text("")
    with pytest.raises(ProjectError) as caught:
        load_project(path)
    for key in ("name", "mesh", "material", "configurations"):
        assert f"- {key}: missing. Expected " in str(caught.value)


def test_nothing_to_calibrate(tmp_path):
    start = '[[parameters]]\nfield = "E"\nlower = "100 kPa"\nupper = "1 MPa"\n'
    project = load_project(write_small_project(tmp_path, (start, "")))
    with pytest.raises(ProjectError, match=r"parameters: .*add \[\["):
        project.calibrate()


def test_nothing_measured(tmp_path):
    changes = [
        ('name = "weight"\nmeasured.recording = { run = "weight" }', 'name = "weight"'),
        ('measured.recording = { run = "pulled" }', ""),
    ]
    path = write_small_project(tmp_path, *changes)
    text = path.read_text()
    start, end = text.index("[shared.measured]"), text.index("[[configurations]]")
    path.write_text(text[:start] + text[end:])
    project = load_project(path)
    with pytest.raises(ProjectError) as caught:
        project.calibrate()
    for name in ("weight", "pulled"):
        assert says(caught.value, f"- configurations.{name}: ... no `measured`")


OF_WEIGHT = 'measured.recording = { run = "weight" }'


def test_not_measured_yet(tmp_path):
    """What [shared.measured] says is not of a pose that has `measured = false`."""
    path = write_small_project(tmp_path, (OF_WEIGHT, "measured = false"))
    project = load_project(path)
    assert [c.is_measured for c in project.configurations] == [False, True]
    with pytest.raises(ProjectError, match=r"weight: .*no `measured`"):
        project.calibrate()


def test_a_pose_that_selects_no_rows(tmp_path):
    text = refusal(
        tmp_path,
        ('select = { phase = "loaded" }\n', ""),
        ('displacement_from = { phase = "rest" }\n', ""),
        (
            'registration = { markers = ["a", "b", "c"], select = { phase = "rest" } }',
            "",
        ),
        (OF_WEIGHT, ""),
    )
    assert says(text, "configurations.weight.measured: ... twice ... 2 and 7; select")
    assert says(text, "not measured ... `measured = false`")


def test_measured_is_a_table_or_false(tmp_path):
    said = refusal(tmp_path, (OF_WEIGHT, "measured = true"))
    assert says(said, "configurations.weight.measured: ... true ... table ... false")


def test_float32(tmp_path):
    path = write_small_project(tmp_path)
    remedy = pytest.raises(ValueError, match=r"float64.* float32.*jax_enable_x64")
    with jax.enable_x64(False), remedy:
        load_project(path)
