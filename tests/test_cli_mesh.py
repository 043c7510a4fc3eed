"""`softcal mesh`: what it writes, prints and refuses."""

import numpy as np
import pytest
from matplotlib.image import imread
from project.test_cad_project import BLOCK, open_block
from wording import says

from softcal_jax.cli import main
from softcal_jax.mesh import read_mesh, write_mesh


@pytest.fixture
def block(tmp_path):
    write_mesh(open_block(), tmp_path / "block.msh", length_unit="mm")
    (tmp_path / "project.toml").write_text(BLOCK)
    return tmp_path


def test_the_groups_of_a_project(block, capsys):
    """Written, drawn, and listed with a point that can be pasted."""
    out = block / "out.msh"
    assert main(["mesh", str(block / "project.toml"), "-o", str(out)]) == 0
    mesh = read_mesh(out, length_unit="mm")
    assert {"base", "wall", "around"} <= mesh.surface_groups.keys()
    assert {"core"} == mesh.tet_groups.keys()
    assert imread(out.with_suffix(".png")).std() > 0.05
    text = capsys.readouterr().out
    assert f"picture in {out.with_suffix('.png')}" in text
    (line,) = (row for row in text.splitlines() if row.lstrip().startswith("wall "))
    point = line.split('"')[1]
    assert point.endswith(" mm")
    assert "1 m2" in line  # four sides of 2/9 and the end of 1/9 m2
    # Written again only where asked.
    again = ["mesh", str(block / "project.toml"), "-o", str(out)]
    assert main(again) == 2
    assert says(capsys.readouterr().err, "exist already ... another name")
    assert main([*again, "--force"]) == 0


def test_another_mesh_file(block, capsys):
    out = ["-o", str(block / "out.msh")]
    assert main(["mesh", str(block / "block.msh"), *out]) == 2
    assert says(capsys.readouterr().err, "--length-unit mm")
    assert main(["mesh", str(block / "block.msh"), "--length-unit", "mm", *out]) == 0
    assert "inlet side" in capsys.readouterr().out


def test_a_cad_model(tmp_path, capsys):
    models = pytest.importorskip("exchange.cad.cad_models")
    step, out = models.write_finger(tmp_path / "finger.step"), tmp_path / "finger.msh"
    command = ["mesh", str(step), "-o", str(out)]
    assert main([*command, "--size", "5 mm"]) == 0
    mesh = read_mesh(out, length_unit="mm")
    assert len(mesh.surface_groups) == 13
    np.testing.assert_allclose(np.ptp(mesh.points, axis=0), [0.06, 0.016, 0.012])
    text = capsys.readouterr().out
    assert "face 13" in text
    assert main([*command, "--force", "--size", "5"]) == 2
    assert "--size: 5 has no unit" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["project.toml", "-o", "out.vtk"], "ends in .msh"),
        (["project.toml", "--size", "3 mm", "-o", "a.msh"], "--size is for CAD models"),
        (["project.toml", "--length-unit", "mm", "-o", "a.msh"], "states it in [mesh]"),
        (["projekt.toml", "-o", "a.msh"], "Did you mean"),
    ],
)
def test_what_is_refused(block, monkeypatch, capsys, arguments, message):
    monkeypatch.chdir(block)
    assert main(["mesh", *arguments]) == 2
    assert message in capsys.readouterr().err
