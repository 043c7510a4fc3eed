"""Printed tags on photographs: the pose of one tag in the frame of another."""

from softcal_jax.exchange.camera._detection import Photo, read_photo
from softcal_jax.exchange.camera._photos import TagPose, find_photos, tag_pose
from softcal_jax.exchange.camera._sheet import (
    BOARD_IDS,
    board_corners,
    tag_cells,
    tag_corners,
    write_tags,
)

__all__ = [
    "BOARD_IDS",
    "Photo",
    "TagPose",
    "board_corners",
    "find_photos",
    "read_photo",
    "tag_cells",
    "tag_corners",
    "tag_pose",
    "write_tags",
]
