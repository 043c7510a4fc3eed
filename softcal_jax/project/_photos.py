"""Table of a project file for the pose of a printed tag on photographs."""

from pathlib import Path

import numpy as np
from pydantic import Field

from softcal_jax._typing import Float, HostArray
from softcal_jax.bodies import Pose
from softcal_jax.exchange.camera import TagPose, find_photos, tag_pose
from softcal_jax.project._sensors import (
    FrameTable,
    Motion,
    MotionSource,
    OrientationTable,
)
from softcal_jax.project._table import Integer, Names, PositiveLength, Table


class EarlierPhotosTable(Table):
    """Photographs of an earlier pose, of the same tags."""

    photos: Names = Field(description='photographs: "rest/*.jpg"')


class PhotosTable(MotionSource):
    """The pose of a tag on a rigid body, from photographs of it and of a base tag.

    `base` of the effector is the frame of the base tag, and `orientation` that of the
    tag on the mesh at rest. `board` are photographs of the printed board, by which the
    camera is calibrated.
    """

    photos: Names = Field(description='photographs: "pose1/*.jpg"', min_length=1)
    tag: Integer = Field(description="number of the tag on the rigid body: 3")
    base_tag: Integer = Field(description="number of the tag on the base: 0")
    size: PositiveLength = Field(description='side of the black square: "20 mm"')
    base_size: PositiveLength | None = None
    board: Names = ()
    displacement_from: EarlierPhotosTable | None = None

    def files(self, folder: Path) -> tuple[Path, ...]:
        earlier = self.displacement_from
        more = () if earlier is None else earlier.photos
        return find_photos([*self.photos, *more, *self.board], folder)

    def motion(
        self,
        folder: Path,
        base: FrameTable,
        mounted: OrientationTable,
        rest: Float[HostArray, "3"],
    ) -> Motion:
        """Compute the motion from the pose of the tag in the frame of the base tag."""
        own = self._pose(folder, self.photos)
        turn, covariance = base.pose.matrix, own.covariance
        position = turn @ own.position + base.pose.translation
        rotation = turn @ own.rotation
        before, mounting = rest, mounted.rotation
        if self.displacement_from is not None:
            earlier = self._pose(folder, self.displacement_from.photos)
            before = turn @ earlier.position + base.pose.translation
            mounting = turn @ earlier.rotation
            # Turned by the motion: exp(r) R (exp(s) S)^T = exp(r - R S^T s) R S^T.
            change = np.eye(6)
            change[3:, 3:] = own.rotation @ earlier.rotation.T
            covariance = covariance + change @ earlier.covariance @ change.T
        axes = np.kron(np.eye(2), turn)
        motion = Pose.from_matrix(rotation @ mounting.T, position - before)
        return motion, axes @ covariance @ axes.T

    def _pose(self, folder: Path, photos: tuple[str, ...]) -> TagPose:
        return tag_pose(
            find_photos(photos, folder),
            tag=self.tag,
            base_tag=self.base_tag,
            size=self.size,
            base_size=self.base_size,
            board=find_photos(self.board, folder),
        )
