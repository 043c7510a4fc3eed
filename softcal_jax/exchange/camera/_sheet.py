"""The printed tags and the board: their patterns, and where their corners are.

The tags are those of the family AprilTag 36h11 (Olson, ICRA 2011): a black border, one
cell wide, around 6 x 6 cells. The frame of a tag has its origin in the middle, x to the
right of the print, y up and z out of the paper.
"""

from typing import Any

import numpy as np

from softcal_jax._typing import Bool, Float, HostArray

CELLS = 8
"""Cells along a side of a tag, with its border."""

N_TAGS = 587
"""Tags of the family, numbered from 0."""

BOARD_SHAPE = (5, 7)
"""Columns and rows of the board."""

BOARD_TAG, BOARD_GAP = 24e-3, 10e-3
"""Side of a tag of the board, and the gap to the next one [m]."""

FIRST_OF_BOARD = 500
"""Number of the first tag of the board, top left; they go on to the right."""

BOARD_IDS = range(FIRST_OF_BOARD, FIRST_OF_BOARD + BOARD_SHAPE[0] * BOARD_SHAPE[1])
"""Numbers of the tags of the board."""


def opencv() -> Any:
    """Import OpenCV with its tags.

    Raises:
        ImportError: If it is not installed, or without the module of tags.
    """
    try:
        import cv2

        cv2.aruco.ArucoDetector  # noqa: B018
    except (ImportError, AttributeError) as error:
        raise ImportError(
            "tags need OpenCV with its contributed modules: "
            "pip install 'softcal-jax[camera]'."
        ) from error
    return cv2


def dictionary() -> Any:
    """Return the family of tags, for OpenCV."""
    cv2 = opencv()
    return cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)


def check_tag(number: int) -> None:
    """Raise ValueError unless there is a tag with a number."""
    if not 0 <= number < N_TAGS:
        raise ValueError(f"there is no tag {number}: they go from 0 to {N_TAGS - 1}.")


def tag_cells(number: int) -> Bool[HostArray, "8 8"]:
    """Return which cells of a tag are white, from its top row down.

    Raises:
        ValueError: If there is no such tag.
        ImportError: If OpenCV is not installed.
    """
    check_tag(number)
    image = opencv().aruco.generateImageMarker(dictionary(), number, CELLS)
    return np.asarray(image) > 127


def tag_corners(size: float) -> Float[HostArray, "4 3"]:
    """Return the corners of a tag of a size, from the top left one clockwise [m]."""
    return 0.5 * size * np.array([[-1, 1, 0], [1, 1, 0], [1, -1, 0], [-1, -1, 0]])


def board_corners(number: int) -> Float[HostArray, "4 3"]:
    """Return the corners of a tag of the board, in the frame of the board [m].

    Its origin is the middle of the top left tag.
    """
    row, column = divmod(number - FIRST_OF_BOARD, BOARD_SHAPE[0])
    pitch = BOARD_TAG + BOARD_GAP
    return tag_corners(BOARD_TAG) + pitch * np.array([column, -row, 0.0])
