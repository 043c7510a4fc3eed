"""A camera calibrated by the printed board, from corners with known noise."""

import struct
import zlib
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import chi2

from benchmarks._photographs import board, clear_views, phone, random_views
from benchmarks._tags import difference
from softcal_jax.exchange.camera import (
    Photo,
    _photos,
    read_photo,
    tag_corners,
    tag_pose,
)
from softcal_jax.exchange.camera._adjustment import CameraModel, Placement
from softcal_jax.exchange.camera._sheet import opencv

LENS, NOISE, SIZE = phone(), 0.05, 20e-3
TARGET = Placement(np.eye(3), np.array([0.06, 0.02, 0.015]))
TAGS = {0: (Placement(np.eye(3), np.zeros(3)), SIZE), 3: (TARGET, SIZE)}


def photo(name, sheet, view, rng):
    """What is found on a photograph."""
    corners = {}
    for number, (place, size) in sheet.items():
        whole = view @ place
        true = LENS.pixels(tag_corners(size) @ whole.R.T + whole.p)
        corners[number] = true + NOISE * rng.normal(size=true.shape)
    return Photo(Path(name), LENS.size, corners)


@pytest.fixture(scope="module")
def photos():
    """Of the board, whose frame is that of its top left tag, and of two tags."""
    rng, middle = np.random.default_rng(1), np.array([0.068, -0.102, 0.0])
    turned = random_views(rng, middle, 4, away=0.5)
    near = clear_views(rng, TAGS, 3, away=0.4)
    boards = [photo(f"board{i}", board(), v, rng) for i, v in enumerate(turned)]
    return boards, [photo(f"pose{i}", TAGS, v, rng) for i, v in enumerate(near)]


def test_the_board_gives_the_camera(photos):
    start = CameraModel.unknown(LENS.size, 0.8 * LENS.size[0])
    camera = _photos._camera_of(photos[0], [start])
    off = camera.values - np.array([LENS.focal, *LENS.middle, *LENS.distortion])
    std = np.sqrt(np.diag(camera.covariance))
    assert off @ np.linalg.solve(camera.covariance, off) < chi2.ppf(0.999, 8)
    # To a pixel, and 1e-3 of the distortion, from a start that knows nothing.
    assert np.all(std[:3] < 1.0)
    assert np.all(std[3:5] < [2e-3, 2e-2])


def test_a_pose_has_the_camera_of_the_board(photos, monkeypatch):
    """Three photographs of two tags alone hardly say what the focal length is."""
    every = {str(shot.path): shot for shot in [*photos[0], *photos[1]]}
    monkeypatch.setattr(_photos, "read_photo", lambda path: every[str(path)])
    boards, poses = ([shot.path for shot in part] for part in photos)
    one = {"tag": 3, "base_tag": 0, "size": SIZE}
    alone, helped = tag_pose(poses, **one), tag_pose(poses, **one, board=boards)
    assert abs(helped.focal - LENS.focal) < 2.0 < abs(alone.focal - LENS.focal)
    before, after = (np.sqrt(np.diag(pose.covariance)) for pose in (alone, helped))
    assert np.all(after < 1.1 * before)
    assert np.all(after[:3] < 0.1e-3)
    off = difference(helped, TARGET)
    assert off @ np.linalg.solve(helped.covariance, off) < chi2.ppf(0.999, 6)


def huge_png():
    """The header of a picture of 60 000 x 60 000, and nothing after it."""
    header = b"IHDR" + struct.pack(">IIBBBBB", 60_000, 60_000, 8, 0, 0, 0, 0)
    sum_of = struct.pack(">I", zlib.crc32(header))
    return b"\x89PNG\r\n\x1a\n" + struct.pack(">I", 13) + header + sum_of


@pytest.mark.parametrize("content", [b"", b"no picture", huge_png()], ids=len)
def test_what_is_no_photograph(tmp_path, content):
    (tmp_path / "a.png").write_bytes(content)
    with pytest.raises(ValueError, match=r"a\.png cannot be read.*JPEG or PNG"):
        read_photo(tmp_path / "a.png")


def test_a_photograph_without_a_tag(tmp_path):
    opencv().imwrite(str(tmp_path / "a.png"), np.full((50, 50), 255, np.uint8))
    with pytest.raises(ValueError, match=r"does not show tag 3; tags there: none\."):
        tag_pose([tmp_path / "a.png"], tag=3, base_tag=0, size=SIZE)
