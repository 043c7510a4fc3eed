"""The command: a calibration again for MuJoCo, which runs what is written to rest."""

import json
from xml.etree import ElementTree

import numpy as np
import pytest
from small_project import E_TRUE, write_small_project
from wording import says

from benchmarks._mujoco import ROBOTS, exported, tip_at_rest
from softcal_jax.cli import main
from softcal_jax.project import load_project
from softcal_jax.results import load_result, write_results

pytestmark = pytest.mark.slow

QUICK = (
    '[markers]\nstd = "0.1 mm"\n',
    '[settings]\nintervals = 0\n\n[markers]\nstd = "0.1 mm"\n',
)
QUADRATIC = ('element = "linear"\n', "")


def test_the_command_calibrates_again_for_the_flex(tmp_path, capsys):
    path = write_small_project(tmp_path / "project", QUICK, QUADRATIC)
    results, folder = tmp_path / "results", tmp_path / "mujoco"
    write_results(load_project(path).calibrate(), results, pictures=None)
    argv = ["export", "mujoco", str(results), "-o", str(folder)]
    assert main(argv) == 0
    said = capsys.readouterr().out
    assert says(said, "calibrating ... MuJoCo ... E: ... for MuJoCo")
    assert says(said, "MuJoCo, own values ... neither was calibrated ... mujoco.viewer")
    root = ElementTree.parse(folder / "robot.xml").getroot()
    names = [key.get("name") for key in root.iter("key")]
    assert names == ["weight", "pulled"]
    index = json.loads((folder / "robot.json").read_text())
    assert index["configurations"] == dict.fromkeys(names, "robot.xml")
    (young,) = {float(e.get("young")) for e in root.iter("elasticity")}
    # The recordings are equilibria of these linear tets, whose law is much the same at
    # such strains: so their modulus comes out, which quadratic tets do not find.
    np.testing.assert_allclose(young, E_TRUE, rtol=0.01)
    assert abs(load_result(results).values["E"] / E_TRUE - 1.0) > 0.1
    assert main(argv) == 2
    assert "--force" in capsys.readouterr().err
    assert main([*argv, "--force"]) == 0


@pytest.mark.parametrize("robot", ROBOTS)
def test_the_tip_at_rest_is_that_of_the_model(robot, tmp_path):
    """To 1 % of the motion; to 0.01 % without guides between nodes."""
    pytest.importorskip("mujoco")
    export = exported(robot, tmp_path)
    names, _ = ROBOTS[robot]
    assert tuple(export.files) == names
    for pose in names:
        tip = tip_at_rest(tmp_path / "mujoco", export, pose)
        assert tip.apart < {"beam": 1e-4, "tentacle": 1e-2}[robot]
