"""The benchmark of exchange: its parts, with few of each."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from wording import says

from benchmarks import _cad_to_result, _calculix, _mujoco, _tags, exchange
from benchmarks._problem import Options
from softcal_jax.exchange.camera import TagPose


def run(folder, **counts):
    """Figures, and what was said."""
    said = []
    outcome = exchange.run(Options(folder, said.append, counts))
    assert set(outcome.goals) <= set(outcome.figures)
    for name, goal in outcome.goals.items():
        assert goal.met(outcome.figures[name]), f"{name}: {outcome.figures[name]}"
    return outcome.figures, said


def test_every_part_has_a_count_and_every_goal_a_part():
    assert set(exchange.COUNTS) == set(exchange._PARTS)
    starts = {"sofa", "calculix", "icesl", "tag", "cad", "mujoco"}
    assert {name.partition("_")[0] for name in exchange.GOALS} == starts


@pytest.mark.slow
def test_scenes_for_sofa(tmp_path):
    """Of a robot with cables and a chamber, four configurations, releases and units."""
    figures, said = run(tmp_path, sofa_scenes=1)
    assert figures == {"sofa_scene_names_unknown": 0, "sofa_scenes": 16}
    assert said == ["sofa_scenes: actuators"]


def test_without_calculix_it_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setattr(_calculix, "missing", lambda: True)
    figures, said = run(tmp_path, calculix=1)
    assert figures == {}
    assert says(said[0], "install ... calculix-ccx")


def test_without_mujoco_it_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setattr(_mujoco, "missing", lambda: True)
    figures, said = run(tmp_path, mujoco=1)
    assert figures == {}
    assert says(said[0], "Install mujoco")


def test_a_pose_within_what_is_stated():
    """Two standard deviations along one axis are within 95 % in six, four are not."""
    std, angle = 1e-4, 1e-3
    covariance = np.diag([std] * 3 + [angle] * 3) ** 2
    for shift, inside in ((2.0, True), (4.0, False)):
        pose = TagPose(
            np.array([shift * std, 0.0, 0.0]),
            np.eye(3),
            covariance,
            0.1,
            np.ones(1),
            1.0,
        )
        true: Any = SimpleNamespace(R=np.eye(3), p=np.zeros(3))
        error = _tags.error_of(pose, true)
        assert error.inside is inside
        np.testing.assert_allclose(error[:2], [shift * std, 0.0], atol=1e-15)


@pytest.mark.slow
def test_a_command_that_fails_is_told(tmp_path):
    with pytest.raises(RuntimeError, match=r"softcal mesh none.step -o a.msh failed"):
        _cad_to_result._softcal(tmp_path, ["mesh", "none.step", "-o", "a.msh"])


@pytest.mark.slow
def test_random_fields_for_icesl(tmp_path):
    figures, said = run(tmp_path, icesl=4)
    assert 0.4 < figures["icesl_roundtrip_steps"] < 0.501
    # Some of what is asked for lies out of the foam's reach, so the list is not empty.
    assert figures["icesl_listed_percent"] > 0
    assert len(said) == 4


@pytest.mark.slow
def test_the_tip_of_a_beam_of_sofa(tmp_path):
    figures, _ = run(tmp_path, sofa_tip=1)
    assert figures["sofa_tip_numpy_difference_mm"] < 1e-9


@pytest.mark.slow
@pytest.mark.skipif(_calculix.missing(), reason="CalculiX (ccx) is not installed")
def test_calculix(tmp_path):
    figures, _ = run(tmp_path, calculix=1)
    assert 2 < figures["calculix_incompressible_difference_percent"] < 30


@pytest.mark.slow
@pytest.mark.skipif(_mujoco.missing(), reason="MuJoCo is not installed")
def test_a_robot_in_mujoco(tmp_path):
    figures, said = run(tmp_path, mujoco=1)
    assert figures["mujoco_tip_percent"] < 0.01
    assert says(said[0], "beam, gravity")


@pytest.mark.slow
def test_photographs_of_a_tag(tmp_path):
    figures, said = run(tmp_path, tags=1)
    assert figures["tag_draws"] == 1
    assert len(said) == 1


@pytest.mark.slow
def test_a_finger_from_cad_to_other_programs(tmp_path):
    pytest.importorskip("gmsh", exc_type=(ImportError, OSError))
    figures, said = run(tmp_path, cad_to_result=1)
    assert figures["cad_to_result_s"] > 0
    assert len(said) == 1 + len(_cad_to_result.COMMANDS)
