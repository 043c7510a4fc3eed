import numpy as np
import pytest
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.image import imread

from softcal_jax.mesh import beam
from softcal_jax.plotting import draw_fibres, plot_fibres

SIZE = (0.1, 0.02, 0.03)


def drawn(mesh, theta, **options):
    """Axes and the colour bar beside them."""
    axes = draw_fibres(Figure().subplots(), mesh, theta, **options)
    return axes.figure.axes


def fibres(axes):
    """Segments of the fibres in mm, which are drawn last."""
    collections = [c for c in axes.collections if isinstance(c, LineCollection)]
    return np.array(collections[-1].get_segments())


@pytest.mark.parametrize(
    ("cells", "order", "layer"),
    # With a side of the cells in the middle, it is the layer above.
    [((4, 3, 3), 1, 1), ((4, 3, 3), 2, 1), ((4, 2, 3), 1, 1)],
)
def test_lines_lie_along_the_fibre_at_centroids_of_the_middle_layer(
    cells, order, layer
):
    mesh = beam(*SIZE, cells, order=order)
    theta = np.linspace(-1.0, 1.0, mesh.n_tets)
    axes, _ = drawn(mesh, theta, plane="xz")
    lines = fibres(axes)
    middle = np.floor(mesh.centroids[:, 1] / SIZE[1] * cells[1]) == layer
    assert len(lines) == middle.sum()
    along = lines[:, 1] - lines[:, 0]
    np.testing.assert_allclose(
        np.arctan2(along[:, 1], along[:, 0]), theta[middle], atol=1e-12
    )
    centroids = 1e3 * mesh.centroids[middle]
    np.testing.assert_allclose(lines.mean(axis=1), centroids[:, [0, 2]], atol=1e-9)


@pytest.mark.parametrize(
    ("largest", "limit"), [(35.0, 35.0), (85.0, 90.0)], ids=["small", "half a turn"]
)
def test_colours_tell_the_angle(largest, limit):
    """Up to 90 degrees the map is cyclic: +90 and -90 are the same axis."""
    mesh = beam(*SIZE, (4, 3, 3))
    theta = np.deg2rad(np.linspace(-largest, largest, len(mesh.tets)))
    _, bar = drawn(mesh, theta, plane="xy")
    np.testing.assert_allclose(bar.get_ylim(), (-limit, limit))
    assert "theta [degrees]" in bar.get_ylabel()


def test_picture_with_control_points(tmp_path):
    mesh = beam(*SIZE, (4, 3, 3))
    zero = np.zeros(len(mesh.tets))
    points = np.array([[0.0, 0.01, 0.015], [0.1, 0.01, 0.015]])
    path = tmp_path / "f.png"
    panels = {"a $1$": zero, "b": zero}
    plot_fibres(mesh, panels, path, plane="xy", control_points=points, title="t")
    assert imread(path).shape[1] == 1600


def test_control_points_are_marked():
    mesh = beam(*SIZE, (4, 3, 3))
    zero = np.zeros(len(mesh.tets))
    points = np.array([[0.0, 0.01, 0.015], [0.1, 0.01, 0.015]])
    first, _ = drawn(mesh, zero, plane="xy", control_points=points, title="a $1$")
    assert first.get_title() == "a $1$"
    marked = [line for line in first.lines if line.get_marker() == "o"]
    np.testing.assert_allclose(marked[0].get_xydata(), [[0, 10], [100, 10]])


def test_wrong_panels(tmp_path, unchecked):
    mesh = beam(*SIZE, (4, 3, 3))
    with pytest.raises(ValueError, match="panels is empty"):
        plot_fibres(mesh, {}, tmp_path / "f.png", plane="xy")
    with pytest.raises(ValueError, match=r"panel 'a' .* 216 .*\(3,\)"):
        plot_fibres(mesh, {"a": np.zeros(3)}, tmp_path / "f.png", plane="xy")
