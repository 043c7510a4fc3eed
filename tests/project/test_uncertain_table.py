"""What is known of all that is not calibrated, as [uncertain]."""

from dataclasses import fields

import numpy as np
import pytest
from small_project import write_small_project

from softcal_jax.fields import Uncertain
from softcal_jax.project import ProjectError, load_project


def read(folder, *lines):
    text = "\n".join(["[uncertain]", *lines])
    return load_project(
        write_small_project(folder, ("[markers]\n", f"{text}\n\n[markers]\n"))
    ).uncertain


def test_without_the_table_the_defaults_count(tmp_path):
    std = load_project(write_small_project(tmp_path)).uncertain
    assert vars(std) == vars(Uncertain())


def test_every_key(tmp_path):
    std = read(
        tmp_path,
        "nu = 0.02",
        'density = "3.5 %"',
        'gravity = "2 deg"',
        'loads = "1 %"',
        'load_offsets = "5 mN"',
        'actuators = "4%"',
        'clamp = "0.2 mm"',
        'supports = "50 %"',
        'recordings = "0.1 mm"',
        'zeros = "1 deg"',
        'mountings = "2 mm"',
        'shapes = "0.1 mm"',
        "contact = 2.0",
        "mesh = 0.5",
    )
    expected = {
        "nu": 0.02,
        "density": 0.035,
        "gravity": np.deg2rad(2.0),
        "loads": 0.01,
        "load_offsets": 5e-3,
        "actuators": 0.04,
        "clamp": 2e-4,
        "supports": 0.5,
        "recordings": 1e-4,
        "zeros": np.deg2rad(1.0),
        "mountings": 2e-3,
        "shapes": 1e-4,
        "contact": 2.0,
        "mesh": 0.5,
    }
    assert set(expected) == {field.name for field in fields(Uncertain)}
    assert vars(std) == pytest.approx(expected, rel=1e-12)


def test_offsets_of_recordings_may_be_estimated(tmp_path):
    assert read(tmp_path, 'recordings = "estimated"').recordings == "estimated"


@pytest.mark.parametrize(
    ("text", "value"), [('"2.5 %"', 0.025), ("0", 0.0), ('"estimated"', "estimated")]
)
def test_creep_is_a_share_of_the_motion_of_all_poses_or_of_one(tmp_path, text, value):
    shared = ("[shared]\n", f"[shared]\nrelative_std = {text}\n")
    project = load_project(write_small_project(tmp_path, shared))
    assert {c.relative_std for c in project.configurations} == {value}


def test_creep_is_no_length(tmp_path):
    shared = ("[shared]\n", '[shared]\nrelative_std = "1 mm"\n')
    path = write_small_project(tmp_path, shared)
    with pytest.raises(ProjectError, match=r'relative_std: .*"1 mm"; .*"3 %"'):
        load_project(path)


def test_zero_needs_no_unit(tmp_path):
    std = read(tmp_path, "nu = 0.0", "density = 0", "clamp = 0", "gravity = 0.0")
    assert (std.nu, std.density, std.clamp, std.gravity) == (0.0, 0.0, 0.0, 0.0)
    assert std.loads == Uncertain().loads


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ('density = "3 kg"', 'uncertain.density: .*"3 kg"; .*"3 %"'),
        ("loads = 0.02", r'uncertain.loads: .* 0\.02; .*"3 %"'),
        ("clamp = 1", "uncertain.clamp: 1 .*unit; .*length"),
        ('clamp = "-1 mm"', 'uncertain.clamp: .*"-1 mm"; .*zero'),
        ("nu = -0.1", r"uncertain.nu: .* -0\.1; .* 0\."),
        ('nu = "5 %"', 'uncertain.nu: .*"5 %"; .*number'),
        ('clmap = "1 mm"', 'uncertain.clmap: .* mean "clamp"'),
    ],
)
def test_what_is_wrong_is_said(tmp_path, line, message):
    with pytest.raises(ProjectError, match=message):
        read(tmp_path, line)


def test_a_calibration_uses_it(tmp_path):
    """The modulus of a body under its weight alone follows its density."""
    path = write_small_project(
        tmp_path, ("[markers]\n", '[uncertain]\ndensity = "7 %"\n\n[markers]\n')
    )
    result = load_project(path).calibrate()
    assert result.budget.by_cause()["density"][0] == pytest.approx(
        0.07 * result.value("E"), rel=1e-3
    )
