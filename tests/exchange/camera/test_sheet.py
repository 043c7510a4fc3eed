"""What is printed: tags of the family, to scale, and a board with known corners."""

import cv2
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from wording import says

from softcal_jax.cli import main
from softcal_jax.exchange.camera import (
    BOARD_IDS,
    board_corners,
    read_photo,
    tag_cells,
    write_tags,
)
from softcal_jax.exchange.camera._sheet import (
    INCH,
    PAPERS,
    board_page,
    tag_pages,
)

DPI = 200.0


def test_tags_are_those_of_the_family():
    """Against the codes that its authors publish, of tags 0 and 1, row by row.

    Which side is up is OpenCV's choice, and does not matter to a printed tag.
    """
    for number, code in ((0, 0xD5D628584), (1, 0xD97F18B49)):
        cells = tag_cells(number)
        assert not cells[[0, -1]].any()
        assert not cells[:, [0, -1]].any()
        published = np.array(list(f"{code:036b}")).reshape(6, 6) == "1"
        turned = [np.rot90(published, k) for k in range(4)]
        assert any(np.array_equal(cells[1:-1, 1:-1], pattern) for pattern in turned)
    with pytest.raises(ValueError, match=r"no tag 587.* 0 to 586"):
        tag_cells(587)


def printed(page, path):
    """What a perfect printer and scanner make of a page; pixels per metre."""
    page.set_dpi(DPI)
    canvas = FigureCanvasAgg(page)
    canvas.draw()
    cv2.imwrite(str(path), np.asarray(canvas.buffer_rgba())[..., 0])
    return read_photo(path)


@pytest.mark.parametrize("paper", ["a4", "letter"])
def test_tags_are_printed_to_scale(tmp_path, paper):
    (page,) = tag_pages(20e-3, count=12, first=3, paper=paper)
    np.testing.assert_allclose(page.get_size_inches() * INCH, PAPERS[paper])
    tags = printed(page, tmp_path / "page.png").corners
    assert sorted(tags) == list(range(3, 15))
    side = 20e-3 / INCH * DPI
    # The scanner mixes codes of sRGB, not light, on the borders of the squares.
    for corners in tags.values():
        edges = np.roll(corners, -1, axis=0) - corners
        np.testing.assert_allclose(np.linalg.norm(edges, axis=1), side, atol=0.5)
        # Upright: the first edge is the top one, to the right.
        np.testing.assert_allclose(edges[0], [side, 0.0], atol=0.5)


def test_the_board_is_where_it_is_said_to_be(tmp_path):
    tags = printed(board_page("letter"), tmp_path / "page.png").corners
    assert sorted(tags) == list(BOARD_IDS)
    origin = tags[BOARD_IDS[0]].mean(axis=0)
    for number, corners in tags.items():
        expected = board_corners(number)[:, :2] * [1.0, -1.0] / INCH * DPI
        np.testing.assert_allclose(corners - origin, expected, atol=0.5)


def test_more_tags_take_more_pages(tmp_path):
    assert len(tag_pages(40e-3, count=12, first=0, paper="a4")) == 2
    assert write_tags(tmp_path / "tags.pdf", size=60e-3, count=2) == 2
    assert (tmp_path / "tags.pdf").read_bytes().startswith(b"%PDF")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"size": 0.0}, "size .* 0 m; "),
        ({"size": 0.25}, "250 mm .* a4"),
        ({"count": 0}, "count .* 0; "),
        ({"first": 580}, "no tag 591"),
        ({"first": 495}, "500 to 534 .*board.* 495 to 506"),
        ({"paper": "a3"}, "paper 'a3'.*'a4', 'letter'"),
    ],
)
def test_refused(tmp_path, options, message):
    with pytest.raises(ValueError, match=message):
        write_tags(tmp_path / "tags.pdf", **options)
    assert not (tmp_path / "tags.pdf").exists()


def test_the_command(tmp_path, capsys):
    path = tmp_path / "tags.pdf"
    assert main(["tags", "-o", str(path), "--size", "35 mm", "--count", "4"]) == 0
    assert says(capsys.readouterr().out, "tags 0 to 3 ... 35 mm")
    assert main(["tags", "-o", str(path)]) == 2
    assert "exists already" in capsys.readouterr().err
    assert main(["tags", "-o", str(path), "--force", "--size", "35"]) == 2
    assert "--size: 35 has no unit" in capsys.readouterr().err
