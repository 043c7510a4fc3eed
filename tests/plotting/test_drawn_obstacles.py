"""Obstacles in pictures: where they stand, half transparent, no part of the view."""

from dataclasses import replace

import jax
import numpy as np
import pytest
from matplotlib.image import imread
from obstacle_results import PRESSED, beside_obstacles, pressed

from softcal_jax import contact
from softcal_jax.plotting import (
    _configuration,
    _robot,
    choose_view,
    obstacle_surface,
    plot_plan,
    render_configuration,
    rendering_problem,
    robot_picture,
)
from softcal_jax.plotting._scene import body_image


@pytest.fixture(scope="module")
def model():
    return beside_obstacles()


def egg(folder):
    import pyvista

    surface = pyvista.Sphere(radius=0.01)
    surface.points[:, 0] *= 1.5
    surface.save(folder / "egg.stl")
    return contact.read_surface(folder / "egg.stl", points=24)


@pytest.mark.parametrize(
    "shape",
    [
        contact.HalfSpace(),
        contact.Ball(0.01),
        contact.Capsule(0.005, 0.03),
        contact.RoundedCylinder(0.01, 0.03, 0.002),
        contact.RoundedBox((0.01, 0.02, 0.03), 1e-9),
        "egg",
    ],
)
def test_what_is_drawn_is_the_surface(shape, tmp_path):
    """All points have the distance 0; closed but for the plate of a half-space."""
    shape = egg(tmp_path) if shape == "egg" else shape
    surface = shape.drawn(0.1)
    distance = jax.vmap(shape.distance)(np.asarray(surface.points, float))
    # The spline of the grid passes linear interpolation by its curvature.
    atol = 1e-4 if isinstance(shape, contact.DistanceGrid) else 1e-8
    np.testing.assert_allclose(distance, 0.0, atol=atol)
    assert (surface.n_open_edges > 0) == isinstance(shape, contact.HalfSpace)


def test_they_stand_where_their_frames_have_moved(model):
    probe, table = robot_picture(model, pressed(model)).obstacles
    assert probe.name == "probe: 5 mN"
    assert table.name == "table"
    np.testing.assert_allclose(probe.origin, [0.091, 0.01, 0.038], atol=1e-12)
    # The pose turns x to y, and a point of the frame with it.
    expected = probe.origin + PRESSED.matrix @ [0.01, 0.0, 0.0]
    (moved,) = probe.place(np.array([[0.01, 0.0, 0.0]]))
    np.testing.assert_allclose(moved, expected, atol=1e-12)


def test_the_plate_of_a_table_lies_below_the_body(model):
    """Although the origin of its frame is 2 m away."""
    _, table = robot_picture(model, pressed(model)).obstacles
    points = table.place(obstacle_surface(model, table.number).points)
    np.testing.assert_allclose(points[:, 2], -0.03, atol=1e-9)
    np.testing.assert_allclose(points.mean(axis=0)[:2], [0.05, 0.01], atol=1e-6)
    assert np.ptp(points, axis=0).max() < 2.0 * model.mesh.size


def test_what_is_absent_is_not_drawn(model):
    (table,) = robot_picture(model, pressed(model, present=("table",))).obstacles
    assert table.name == "table"


def test_a_plan_shows_them_before_the_load(model, tmp_path, monkeypatch):
    seen = []
    draw = lambda axes, view, picture: seen.append(picture.obstacles)
    monkeypatch.setattr(_robot, "draw_obstacles", draw)
    poses = [
        pressed(model, name=n, present=p).posed
        for n, p in (("a", ("probe",)), ("b", ()))
    ]
    plot_plan(model, {"a": "a", "b": "b"}, poses, tmp_path / "a.png", title="t")
    (probe,), none = seen
    np.testing.assert_allclose(probe.origin, [0.09, 0.01, 0.04], atol=1e-12)
    assert none == []


def test_a_plan_with_bodies_that_have_no_nodes(model, tmp_path):
    """It keeps its camera, and is darker where the table and the probe are."""
    path, posed = tmp_path / "a.png", pressed(model).posed
    absent = pressed(model, present=()).posed
    plot_plan(model, {"a": "a"}, [absent], path, title="t")
    bare = imread(path)[..., :3]
    plot_plan(model, {"a": "a"}, [posed], path, title="t")
    shown = imread(path)[..., :3]
    assert shown.shape == bare.shape
    darker = (bare - shown).max(axis=2) > 0.05
    assert 0.1 < darker.mean() < 0.9


@pytest.mark.skipif(rendering_problem() is not None, reason=str(rendering_problem()))
class TestPictures:
    def test_they_are_half_transparent(self, model):
        rest = np.zeros_like(model.mesh.points)
        view = choose_view(model.mesh.points)
        probe = robot_picture(model, pressed(model)).obstacles[0]

        def middle(*obstacles):
            """The colour of the body's middle, where the probe is in the way."""
            shown = {"size": (300, 200), "scale": 2500.0, "largest": 1e-3}
            surfaces = _robot.placed_surfaces(model, obstacles)
            image = body_image(model, rest, view, **shown, obstacles=surfaces)
            return image[90:110, 140:160].mean(axis=(0, 1))

        front, behind = (
            probe._replace(origin=view.centre + way * view.towards)
            for way in (0.05, -0.05)
        )
        own = middle()
        # Half of the violet of the body at rest, half of the ball's light grey.
        ball = 2.0 * middle(front) - own
        assert ball.min() > 120
        assert np.ptp(ball) < 25
        # Of one behind, only what is beside the body is seen.
        np.testing.assert_allclose(middle(behind), own, atol=1.0)

    def test_a_picture_keeps_its_camera(self, model, tmp_path, monkeypatch):
        views = []

        def note(model, u, view, **shown):
            views.append(view)
            return np.full((*shown["size"][::-1], 3), 255, np.int32)

        monkeypatch.setattr(_configuration, "body_image", note)
        legends = []
        legend_of = _configuration.figures.legend_of
        monkeypatch.setattr(
            _configuration.figures,
            "legend_of",
            lambda drawn, *rest: legends.append(drawn) or legend_of(drawn, *rest),
        )
        for present in ((), ("probe", "table")):
            fit = pressed(model, present=present)
            render_configuration(model, fit, tmp_path / "a.png")
        np.testing.assert_equal(*(view._asdict() for view in views))
        assert "obstacle" not in legends[0]
        assert "obstacle" in legends[1]
        assert "rigid body" not in legends[1]

    def test_what_is_touched_shows_the_pressure(self, model, tmp_path, monkeypatch):
        """Through an obstacle too; a second scale has its unit, and nothing else."""
        fit = pressed(model)
        probe, table = fit.robot.contacts
        faces = model.mechanism.contacts.faces
        top = np.isclose(model.mesh.points[faces][..., 2], 0.02).all(axis=1)
        probe = replace(probe, pressure=np.where(top, 5e3, 0.0))
        touched = replace(fit, robot=replace(fit.robot, contacts=(probe, table)))
        scales, draw = [], _configuration.figures.draw_colour_scale
        monkeypatch.setattr(
            _configuration.figures,
            "draw_colour_scale",
            lambda axes, *scale: scales.append(scale) or draw(axes, *scale),
        )
        path = tmp_path / "a.png"
        render_configuration(model, fit, path)
        render_configuration(model, touched, path)
        assert len(scales) == 3
        assert scales[2][:2] == (5.0, "contact pressure [kPa]")
        image = (255.0 * imread(path)[..., :3])[:, :1200]
        dark = np.linalg.norm(image - [103.0, 0.0, 13.0], axis=2) < 60.0
        assert dark.sum() > 5000
