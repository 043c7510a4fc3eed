"""`softcal check`: what it says of a project, draws, refuses, and does not compile."""

import numpy as np
import pytest
from all_kinds_project import ALL_KINDS
from matplotlib.image import imread
from small_project import write_small_project
from wording import says

from benchmarks._compilations import Compilations
from softcal_jax.cli import main
from softcal_jax.project import load_project, quantities_as_read

MORE = """
[[configurations]]
name = "loaded"
supports = [{ group = "foot", axes = "z", displacement = "(0, 0, 1) mm" }]
loads = [{ surface = "y_max", force = "(0, 2, 0) N" }]
effectors = []

[groups.foot]
box = { lower = "(10, 0, 0) mm", upper = "(20, 20, 0) mm" }
"""


def checked(path, capsys, *options):
    """Exit code, lines with single spaces, and the programs that were compiled."""
    with Compilations() as compiled:
        code = main(["check", str(path), *options])
    lines = [" ".join(line.split()) for line in capsys.readouterr().out.splitlines()]
    return code, lines, compiled.programs


@pytest.fixture
def every_kind(tmp_path):
    path = tmp_path / "robot.toml"
    path.write_text(ALL_KINDS.replace("\n[[candidates]]", MORE + "\n[[candidates]]"))
    return path


def test_one_of_each_kind(every_kind, capsys):
    """Numbers worked out by hand from the file, and not one program compiled."""
    code, lines, programs = checked(every_kind, capsys)
    assert code == 0
    assert programs == []
    for line in (
        "mesh 28 nodes, 36 linear tets; (60, 20, 20) mm",
        "volume 24 ml",
        # 24 g and the 10 g of the tip.
        "weight 333.4 mN (34 g)",
        "tip 4 (60, 10, 10) mm 10 g",
        "collar 4 (30, 10, 10) mm tip",
        # From (0, 10, 20) to (45, 10, 20) mm.
        "left cable 45 mm",
        "hinged candidate 9.81 m/s2 along -z arm 20 deg, left 1 N, tip hinged",
        "imposed forces sensor, position moved by 59.9 mm from rest 0.3 mm",
        "middle, position moved by 5 mm from rest not stated: 1 mm as a weight",
        "clamp, reaction (0, 0, 1) N 10 mN",
        "E 300 kPa 100 kPa 1 MPa log +- 30 %",
        "mounting z of arm 2 mm 0 m 4 mm linear none",
        'actuators.left.guides[1].point "(0, 1, 2) cm" (0, 10, 20) mm',
        'material.density "1 g/cm^3" 1000 kg/m3',
        'effectors.torque.std "1 N*mm" 0.001 N m',
        "softcal identify ready to run",
    ):
        assert line in lines
    assert says(lines, "Nothing was solved")
    assert says(lines, "softcal export not for SOFA", "(arm, tip, collar)")
    loaded = next(line for line in lines if line.startswith("loaded fitted"))
    assert "foot (4 nodes, only z, displaced by (0, 0, 1) mm)" in loaded
    assert "2 N along +y on y_max = 6 x weight" in loaded
    (refused,) = (i for i, line in enumerate(lines) if "would refuse: 2" in line)
    assert says(lines[refused + 1], "configurations.held: ... no `measured`")
    picture = every_kind.with_name("robot_check.png")
    assert f"Picture: {picture}" in lines
    pixels = imread(picture)[..., :3]
    assert pixels.shape[1] == 1600
    for colour in ("#8c510a", "#1b7837", "#d95f02", "#7b3294", "#e3001b"):
        wanted = np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)]) / 255.0
        near = np.abs(pixels - wanted).max(axis=2) < 0.06
        assert near.sum() > 100, colour


def test_what_the_model_leaves_out(every_kind, capsys):
    """A cable and a force at points of bare tets, and a body that nobody weighed."""
    _, lines, _ = checked(every_kind, capsys, "--no-pictures")
    start = lines.index("Left out of the model")
    left_out = lines[start + 1 : lines.index("", start)]
    assert says(left_out, "what cable 'left' moves ... dent ... [bodies]")
    assert says(left_out, "what force actuator 'push' moves")
    assert says(left_out, "No mass ... 'arm'")
    assert len(left_out) == 3


def test_markers_of_recordings(tmp_path, capsys):
    """An earlier picture is replaced, a picture of someone else is not."""
    path = write_small_project(tmp_path, ('[markers]\nstd = "0.1 mm"', "[markers]"))
    picture = tmp_path / "drawn.png"
    option = ["-o", str(picture)]
    for _ in range(2):
        code, lines, programs = checked(path, capsys, *option)
        assert (code, programs) == (0, [])
    for line in (
        "tip (60, 10, 10) mm inside",
        "pulled held out 9.81 m/s2 along -z x_min (4 nodes) "
        "53.85 mN along (0.371, 0, -0.928) on x_max = 0.229 x weight",
        "softcal calibrate ready to run",
    ):
        assert line in lines
    assert any(
        line.startswith("weight 2 markers moved by 0.57 mm to") for line in lines
    )
    picture.write_bytes(b"a picture of someone else")
    assert main(["check", str(path), *option]) == 2
    assert says(capsys.readouterr().err, "exists already ... another name")
    assert main(["check", str(path), *option, "--no-pictures"]) == 0
    assert picture.read_bytes() == b"a picture of someone else"


def test_what_is_doubted_comes_first(tmp_path, capsys):
    path = write_small_project(tmp_path, ('"1 g/cm^3"', '"1 g/mm^3"'))
    code, lines, _ = checked(path, capsys, "--no-pictures")
    assert code == 0
    warned = next(i for i, line in enumerate(lines) if line.startswith("warning: "))
    (summary,) = (i for i, line in enumerate(lines) if "warnings above: 1" in line)
    assert warned < summary
    assert "material.density" in lines[warned]
    assert not (tmp_path / "project_check.png").exists()


def test_bad_input(tmp_path, capsys):
    path = write_small_project(tmp_path, ('E = "200 kPa"', 'E = "200 kPaa"'))
    assert main(["check", str(path)]) == 2
    assert 'unknown unit "kPaa"' in capsys.readouterr().err
    assert main(["check", str(tmp_path / "projekt.toml")]) == 2
    assert not list(tmp_path.glob("*.png"))


def test_a_project_that_was_only_read_is_not_solved(tmp_path):
    project = load_project(write_small_project(tmp_path), solve=False)
    with pytest.raises(RuntimeError, match='solver="none"'):
        project.simulate()


def test_a_name_is_no_quantity(tmp_path):
    text = ALL_KINDS.replace('name = "held"', 'name = "350 mbar"')
    path = tmp_path / "project.toml"
    path.write_text(text)
    quantities = {q.key: q.read for q in quantities_as_read(path)}
    assert quantities["configurations.350 mbar.actuation.left"] == "1 mm"
    assert not any(key.endswith(".name") for key in quantities)
