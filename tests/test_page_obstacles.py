"""Obstacles in the view of `report.html`."""

import base64
import dataclasses
import io

import numpy as np
import pytest
from obstacle_results import beside_obstacles, pressed
from PIL import Image
from test_page_view import fields_of

from benchmarks import _browser
from softcal_jax.calibration import SimulationResult
from softcal_jax.results import _write, write_results
from softcal_jax.results._view_data import robot_data, surface_of, view_data

pytestmark = pytest.mark.filterwarnings("ignore::softcal_jax.results.PictureWarning")


@pytest.fixture(scope="module")
def model():
    return beside_obstacles()


def numbers(text, kind):
    return np.frombuffer(base64.b64decode(text), kind).reshape(-1, 3)


def data_of(model, *shown):
    surface = surface_of(model, 1)
    return view_data(model, shown, surface, fields_of(model, shown, surface))


def test_each_pose_places_those_that_are_there(model):
    data = data_of(model, pressed(model), pressed(model, name="off", present=()))
    both, none = (pose["obstacles"] for pose in data["configurations"])
    assert [(o["shape"], o["name"]) for o in both] == [(0, "probe: 5 mN"), (1, "table")]
    assert none == []
    assert both[0]["at"] == [91.0, 10.0, 38.0]
    np.testing.assert_allclose(both[0]["axes"][0], [0.0, 1.0, 0.0], atol=1e-12)
    ball, plate = data["shapes"]
    radii = np.linalg.norm(numbers(ball["points"], "<f4"), axis=1)
    np.testing.assert_allclose(radii, 10.0, rtol=1e-6)
    assert numbers(ball["triangles"], "<u4").max() < len(radii)
    normals = numbers(plate["normals"], "<f4")
    np.testing.assert_allclose(np.abs(normals[:, 2]), 1.0, rtol=1e-6)


def test_the_pressure_of_contact_is_a_field_where_something_touches(model):
    free, surface = pressed(model), surface_of(model, 1)
    assert free.robot is not None
    pressure = np.zeros(len(model.mechanism.contacts.faces))
    pressure[[1, 3]] = 1e3, 2e3
    felt = dataclasses.replace(free.robot.contacts[0], pressure=pressure)
    robot = dataclasses.replace(free.robot, contacts=(felt,))
    touching = dataclasses.replace(free, robot=robot)
    labels = [field.label for field in fields_of(model, [free], surface)]
    assert not any("pressure" in label for label in labels)
    fields = fields_of(model, [free, touching], surface)
    (field,) = (f for f in fields if f.label == "contact pressure [kPa]")
    assert field.place == "face"
    of_faces = 1e-3 * robot.surface_pressure(model)
    assert sorted(of_faces[of_faces > 0.0]) == [1.0, 2.0]
    np.testing.assert_allclose(np.array(field.values), [0.0 * of_faces, of_faces])


def test_they_leave_the_camera_to_the_robot(model):
    """Neither they nor the frames of bodies that only stand beside are looked at."""
    with_them, without = pressed(model), pressed(model, present=())
    assert robot_data(model, with_them)["frames"] == []
    seen = [data_of(model, fit)["view"] for fit in (with_them, without)]
    assert seen[0] == seen[1]


def test_nothing_of_them_is_cut_off(model):
    """All of them is nearer to the middle of the robot than the view is deep."""
    data = data_of(model, pressed(model))
    middle = np.array([50.0, 10.0, 10.0])
    for o in data["configurations"][0]["obstacles"]:
        points = numbers(data["shapes"][o["shape"]]["points"], "<f4") @ o["axes"]
        away = np.linalg.norm(points + o["at"] - middle, axis=1)
        assert away.max() < data["farthest"]


@pytest.mark.slow
def test_a_browser_draws_them_half_transparent(model, tmp_path, monkeypatch):
    try:
        _browser.browser()
    except _browser.NoBrowser as error:
        pytest.skip(str(error))
    monkeypatch.setattr(_write, "rendering_problem", lambda: "no OpenGL here")
    result = SimulationResult(model, (pressed(model),))
    write_results(result, tmp_path / "out")

    def seen(tab):
        tab.ask(
            "new Promise(done => "
            "requestAnimationFrame(() => requestAnimationFrame(done)))"
        )
        image = Image.open(io.BytesIO(tab.screenshot("#view .stage")))
        return np.asarray(image.convert("RGB"), int)

    def with_and_without(tab):
        shown = seen(tab)
        tab.ask("document.getElementById('view-obstacles').click()")
        return shown, seen(tab)

    with _browser.opened(tmp_path / "out" / "report.html") as tab:
        assert tab.loaded == _browser.Visit((), ())
        tab.resize(1200)
        shown, bare = with_and_without(tab)
        tab.ask(
            "const seen = document.getElementById('view-direction');"
            "seen.selectedIndex = 5; seen.dispatchEvent(new Event('change'));"
        )
        bare_above, above = with_and_without(tab)
    white = (bare > 250).all(axis=2)
    grey = white & (shown.max(axis=2) < 230) & (np.ptp(shown, axis=2) < 15)
    assert 0.1 < grey.sum() / white.sum() < 0.95
    # Seen from above, the probe stands before the robot, whose colour comes through.
    coloured = np.ptp(bare_above, axis=2) > 60
    through = coloured & (np.abs(above - bare_above).max(axis=2) > 20)
    assert 0.05 < through.sum() / coloured.sum() < 0.5
    assert np.median(np.ptp(above[through], axis=1)) > 15
