import numpy as np
import pytest
from export.handmade import make_fit, nowhere_before, sag, small_model, with_points
from matplotlib.colors import to_rgb
from matplotlib.image import imread
from wording import says

from softcal_jax.plotting import (
    _configuration,
    _scene,
    choose_view,
    motion_words,
    render_body,
    render_configuration,
    rendering_problem,
)
from softcal_jax.plotting._figure import BAD, MEASURED
from softcal_jax.plotting._view import View, fit_body

pytestmark = pytest.mark.skipif(
    rendering_problem() is not None, reason=str(rendering_problem())
)


def pixels_of(path, colour):
    """Rows and columns of the pixels of one colour."""
    image = imread(path)[..., :3]
    return np.argwhere(np.abs(image - to_rgb(colour)).max(axis=2) < 0.02)


@pytest.fixture
def as_users_see_it(monkeypatch):
    """With the samples per pixel that users get."""
    monkeypatch.setattr(_scene, "_SMOOTHING", "ssaa")


@pytest.fixture
def without_the_body(monkeypatch):
    """White where the body would be, for what is drawn around and over it."""

    def white(*args, size, **keywords):
        return np.full((*size[::-1], 3), 255, np.int32)

    monkeypatch.setattr(_configuration, "body_image", white)


@pytest.fixture(scope="module", params=[pytest.param(1, marks=pytest.mark.slow), 2])
def model(request):
    return small_model(request.param)


def test_markers_lie_where_they_were_measured(model, tmp_path):
    """Two red rings, at the end that moves, on the right of the picture."""
    fit = make_fit(model.mesh)
    path = tmp_path / "a.png"
    render_configuration(model, fit, path, converged=True)
    assert imread(path).shape[1] == 1600
    red = pixels_of(path, MEASURED)
    body = red[red[:, 0] < imread(path).shape[0] - 130]
    assert len(body) > 50
    assert body[:, 1].min() > 1000
    assert body[:, 1].max() < 1410


@pytest.mark.usefixtures("as_users_see_it")
def test_the_body_is_drawn_in_colours(model, tmp_path):
    path = tmp_path / "a.png"
    render_body(model, sag(model.mesh), path, title="a")
    image = imread(path)[130:-130, :1390, :3]
    coloured = np.ptp(image, axis=2) > 0.2
    assert 0.1 < coloured.mean() < 0.8
    # Not cut off: nothing but white at the rim.
    rim = np.concatenate([image[0], image[-1], image[:, 0], image[:, -1]])
    np.testing.assert_array_equal(rim, 1.0)
    assert len(pixels_of(path, MEASURED)) == 0


@pytest.mark.usefixtures("as_users_see_it")
def test_layers_cover_white_and_each_other():
    """Each pixel is a mean of samples; where all are of the body at rest, its grey."""
    model = small_model()
    u = sag(model.mesh)
    view = choose_view(model.mesh.points, u)
    look = {"size": (600, 400), "scale": 300.0 / view.width, "largest": 0.03}
    image = _scene.body_image(model, u, view, **look)
    assert image.min() >= 0
    assert image.max() == 255
    np.testing.assert_array_equal(image[0], 255)
    grey = int(_scene._GHOST[1:3], 16)
    assert (np.abs(image - grey) <= 1).all(axis=2).mean() > 0.01


@pytest.mark.usefixtures("as_users_see_it")
def test_body_and_markers_are_drawn_to_the_same_scale(tmp_path):
    """VTK draws the one, Matplotlib the other: the body must lie in the view."""
    model = small_model()
    u = sag(model.mesh)
    view = choose_view(model.mesh.points, u)
    scale, height = fit_body(view, 1410, 60, 420, 900)
    render_body(model, u, tmp_path / "a.png", title="a")
    image = imread(tmp_path / "a.png")[130:-130, :1390, :3]
    drawn = np.argwhere((image < 0.99).any(axis=2))
    middle = np.array([0.5 * height, 705.0])
    half = 0.5 * scale * np.array([view.height, view.width])
    # Lines stand out by half their width, rounded to pixels.
    np.testing.assert_allclose(drawn.min(axis=0), middle - half, atol=2.5)
    np.testing.assert_allclose(drawn.max(axis=0), middle + half, atol=2.5)


@pytest.mark.usefixtures("without_the_body")
@pytest.mark.parametrize("letters", ["long ", "W", "."])
def test_a_long_title_is_not_cut_off(tmp_path, letters):
    model = small_model()
    path = tmp_path / "a.png"
    render_body(model, sag(model.mesh), path, title=60 * letters)
    title = np.argwhere((imread(path)[:70, :, :3] < 0.8).any(axis=2))
    assert title[:, 1].min() > 15
    assert title[:, 1].max() < 1600 - 15


def test_the_picture_depends_on_the_displacement(tmp_path):
    """A body at rest can be drawn, too."""
    model = small_model()
    for tip in (0.0, 0.03):
        render_body(model, sag(model.mesh, tip), tmp_path / f"{tip}.png", title="a")
    rest, other = (imread(tmp_path / f"{tip}.png") for tip in (0.0, 0.03))
    assert rest.shape[1] == 1600
    assert rest.shape != other.shape or np.abs(rest - other).max() > 0.5


@pytest.mark.usefixtures("without_the_body")
def test_a_run_that_did_not_converge_never_looks_good(tmp_path):
    model = small_model()
    fit = make_fit(model.mesh)
    for converged in (True, False):
        path = tmp_path / f"{converged}.png"
        render_configuration(model, fit, path, converged=converged)
    band = imread(tmp_path / "False.png")[:60, :, :3].reshape(-1, 3)
    red = np.abs(band - to_rgb(BAD)).max(axis=1) < 0.02
    assert red.mean() > 0.8
    assert len(pixels_of(tmp_path / "True.png", BAD)) == 0


@pytest.mark.usefixtures("without_the_body")
def test_a_marker_that_was_lost_is_left_out(tmp_path):
    """NaN in one of two measured markers: half the red, and no warning."""
    model = small_model()
    fit = make_fit(model.mesh)
    markers = np.array([point.measured for point in fit.points])
    lost = markers.copy()
    lost[0, 1] = np.nan
    counts = []
    for i, measured in enumerate((markers, lost)):
        path = tmp_path / f"{i}.png"
        render_body(
            model,
            fit.displacement,
            path,
            title="a",
            measured=measured,
            simulated=np.array([point.simulated for point in fit.points]),
            marker_names=[point.name for point in fit.points],
        )
        red = pixels_of(path, MEASURED)
        counts.append(np.sum(red[:, 0] < imread(path).shape[0] - 130))
    assert 0.3 * counts[0] < counts[1] < 0.7 * counts[0]


@pytest.mark.parametrize("w", [0.01, 0.1, 1.0])
@pytest.mark.parametrize("h", [0.01, 0.1, 1.0])
def test_the_body_fits_and_fills_its_part(w, h):
    x, y, z = np.eye(3)
    view = View(right=x, up=y, towards=z, centre=np.zeros(3), width=w, height=h)
    scale, height = fit_body(view, 1410, 60, 420, 900)
    assert 420 <= height <= 900
    assert max(w * scale / (1410 - 120), h * scale / (height - 120)) == (
        pytest.approx(1.0, abs=0.01)  # whole pixels
    )


@pytest.mark.usefixtures("without_the_body")
def test_markers_seen_along_some_axes_are_drawn(model, tmp_path):
    """What was not measured is taken from the simulation: no distance along it."""
    counts = []
    for axes in ("xyz", "xz", ""):
        fit = make_fit(model.mesh, axes=axes or "xyz", y=0.0 if axes == "xyz" else 7.0)
        if not axes:  # nothing was measured at all
            fit = with_points(
                fit,
                measured=lambda p: np.full_like(p.measured, np.nan),
                std=lambda p: np.full_like(p.std, np.inf),
            )
        render_configuration(model, fit, tmp_path / "a.png")
        red = pixels_of(tmp_path / "a.png", MEASURED)
        counts.append(np.sum(red[:, 0] < imread(tmp_path / "a.png").shape[0] - 130))
    assert counts[0] == counts[1] > 50
    assert counts[2] == 0


def test_the_subtitle_says_no_equilibrium_instead_of_nan():
    fit = make_fit(small_model().mesh)
    after = "1.00 mm after (5.0 %"
    assert says(motion_words(fit), "4.00 mm before", after)
    assert says(motion_words(nowhere_before(fit)), "no equilibrium found before", after)
