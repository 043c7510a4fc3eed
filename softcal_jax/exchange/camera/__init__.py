"""Printed tags on photographs: the pose of one tag in the frame of another."""

from softcal_jax.exchange.camera._photos import (
    Photo as Photo,
    TagPose as TagPose,
    find_photos as find_photos,
    read_photo as read_photo,
    tag_pose as tag_pose,
)
from softcal_jax.exchange.camera._sheet import (
    BOARD_IDS as BOARD_IDS,
    board_corners as board_corners,
    tag_cells as tag_cells,
    tag_corners as tag_corners,
    write_tags as write_tags,
)
