"""Numbers that are hard to believe get a line each, and stop nothing."""

import re
import warnings
from dataclasses import replace

import pytest
from small_project import write_small_project
from wording import says

from softcal_jax.actuators import Cable
from softcal_jax.equilibrium import build_model
from softcal_jax.materials import NeoHookean
from softcal_jax.mesh import beam
from softcal_jax.project import ProjectWarning, implausible, load_project
from softcal_jax.robots import ready_made_path

FORCE = 'force = "(20, 0, -50) mN"'
GRAVITY = 'gravity = "(0, 0, -9.81) m/s^2"'


def said(folder, *changes) -> list[str]:
    """Load a project, and return what it warns of, without the file."""
    path = write_small_project(folder, *changes)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        load_project(path)
    assert all(issubclass(w.category, ProjectWarning) for w in caught)
    return [str(w.message).removeprefix(f"{path}: ") for w in caught]


def test_a_usual_project_says_nothing(tmp_path):
    assert said(tmp_path) == []


# Warnings are errors in tests/robots/test_pneumatic_arm.py, which loads it, too.
@pytest.mark.parametrize("robot", ["beam", "pneumatic-arm"])
def test_nor_do_the_demos(robot):
    pytest.importorskip("ezc3d")
    with warnings.catch_warnings():
        warnings.simplefilter("error", ProjectWarning)
        load_project(ready_made_path(robot))


@pytest.mark.parametrize("density", ["1 kg/m^3", "1000 g/cm^3"])
def test_density(tmp_path, density):
    line, *_ = said(tmp_path, ('"1 g/cm^3"', f'"{density}"'))
    assert line.startswith("material.density: 1")
    assert says(line, "kg/m^3", "water", "1000")


def test_gravity(tmp_path):
    (line,) = said(tmp_path, (GRAVITY, GRAVITY.replace("m/s^2", "mm/s^2")))
    assert says(line, "configurations.weight.gravity: (0, 0, -0.00981) m/s^2", "0.001")
    assert says(line, "unit")


def test_loads(tmp_path):
    """200 kPa on 4 cm2 are 80 N; as a beam, six times its slenderness of 3 less."""
    assert said(tmp_path, (FORCE, 'force = "(0, 0, -1) N"')) == []
    (line,) = said(tmp_path, (FORCE, 'force = "(0, 0, -141.2) N"'))
    assert says(
        line, "configurations.pulled.loads: 141 N is 1.8 times", "80 N", "units"
    )
    (line,) = said(tmp_path, (FORCE, 'force = "(0, 0, -1) mN"'))
    assert says(line, "configurations.pulled.loads: 1 mN is", "4.44 N")


@pytest.mark.parametrize(
    ("changes", "factor", "words"),
    [
        ({}, 10.0, ""),
        (
            {"supports": "x_max"},
            10.0,
            ".supports: where x_max holds, a marker moved: 'tip'",
        ),
        ({"supports": "x_max"}, 1.0, ""),  # within what noise and frame explain
        ({"gravity": (0.0, 0.0, 9.81)}, 10.0, ": markers moved against gravity"),
        (
            {"gravity": (0.0, 0.0, 0.0)},
            10.0,
            ": nothing acts, but markers moved, 'side' by 5.85 mm",
        ),
        (
            {},
            1e-4,
            ": every marker was measured at its place at rest",
        ),
    ],
)
def test_readings(tmp_path, changes, factor, words):
    """A pose that sags by 0.57 mm, or by more or less, as it is or stated otherwise."""
    project = load_project(write_small_project(tmp_path))
    (pose,) = project.calibration
    places = pose.markers.positions
    measured = places + factor * (pose.measured - places)
    stated = replace(pose, measured=measured, **changes)
    lines = [*implausible(project.model, {"weight": stated})]
    if words:
        (line,) = lines
        assert says(line, "weight" + words)
    else:
        assert lines == []


def test_guides_out_of_order():
    """There and back again, once; a cable around a corner is not named."""
    mesh = beam(0.08, 0.01, 0.01, (4, 1, 1))
    places = [(x, 0.005, 0.01) for x in (0.0, 0.02, 0.04, 0.06)]
    corner = [*places, (0.08, 0.005, 0.01), (0.08, 0.005, 0.0), (0.04, 0.005, 0.0)]
    for guides, named in (
        (places, False),
        ([places[k] for k in (0, 2, 1, 3)], True),
        ([places[k] for k in (1, 0, 2, 3)], True),
        (corner, False),
    ):
        cable = Cable("left", guides)
        model = build_model(mesh, NeoHookean(2e5, 0.4), density=1e3, actuators=[cable])
        lines = [*implausible(model, {})]
        assert bool(lines) == named
        if named:
            assert says(lines, "actuators.left.guides", "180 deg", "60 mm", "order")


def test_points(tmp_path):
    """Positions in metres, read as they are, in the frame of the cameras."""
    far = ('displacement_from = { phase = "rest" }\n', "")
    start = (
        'registration = { markers = ["a", "b", "c"], select = { phase = "rest" } }\n'
    )
    (line,) = said(tmp_path, far, (start, ""))
    assert re.match(r"configurations\.(weight|pulled)\.measured: 'side'", line)
    assert says(line, "mm", "rest", "66.33 mm", "unit")


def test_the_frame_of_a_reference_is_its_own(tmp_path):
    """Only differences count between configurations in the frame of the cameras."""
    far = ('displacement_from = { phase = "rest" }', 'displacement_from = "weight"')
    start = (
        'registration = { markers = ["a", "b", "c"], select = { phase = "rest" } }\n'
    )
    assert said(tmp_path, far, (start, "")) == []


def test_what_is_not_of_the_file_is_not_judged(tmp_path):
    """A sweep loads the project with many values, of which the file was judged."""
    path = write_small_project(tmp_path)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        load_project(path, changes={"material.density": "1 kg/m^3"})
