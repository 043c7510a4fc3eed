"""Attachments of points and frames of which only the displacement is fitted.

Where a marker was glued is known to a millimetre or so, and its motion between two
poses to a tenth of that. A configuration that names another one as its reference is
compared by differences of poses on both sides, measured and simulated. Every point then
has an unknown offset, and every 6-D sensor an unknown mounting, that both poses share.
As columns of the covariance, with a standard deviation far beyond any offset, they take
out what the errors have in common and nothing else. This is generalised least squares
on the differences, all of which contain the noise of the reference.

A point keeps its offset along the axes of the mesh. A sensor that is mounted with an
offset d and a turn r is at T M on a body at T, and T_c T_r^-1, the rigid motion from
the reference r to a configuration c, is the same for every mounting M. To first order
the errors of its position and orientation are R d and R r, with the rotation R of the
body in each pose. Sensitivities are those of the nominal point and axes, but half
the unknown turn tilts the axes: know the mounting to millimetres and some degrees.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from softcal_jax._typing import Float, HostArray, Int
from softcal_jax.configurations import Configuration, EffectorRecord
from softcal_jax.inference import RANK

FAR_BEYOND: Mapping[str, float] = {"point": 1.0, "turn": 100.0}
"""Standard deviation of an unknown offset, far beyond any real offset [m, rad]."""

Attachment = tuple[str, str, str]
"""Names of the reference and of an effector, and its quantity."""


class Attachments(NamedTuple):
    """Attachments of the effectors whose displacement counts, not their position.

    Attributes:
        of_row: Index of the attachment of each row, -1 for rows without.
        axes: Axes of its offset, as a matrix for each row [-].
        keys: What each attachment is, by this index.
    """

    of_row: Int[HostArray, "n_c n_rows"]
    axes: Float[HostArray, "n_c n_rows 3 3"]
    keys: tuple[Attachment, ...]

    def shifts(
        self,
        weight: Float[HostArray, "n n_rows 3"],
        delta_e: Float[HostArray, "n n_rows 3"],
    ) -> Float[HostArray, "n_c n_rows 3"]:
        """Return what the offset of its attachment adds to each row [m, rad].

        Offsets fit the weighted errors of the first configurations, by least squares.
        """
        shifts, n = np.zeros((*self.of_row.shape, 3)), len(weight)
        for k in range(int(self.of_row.max(initial=-1)) + 1):
            mine = self.of_row == k
            w = weight[mine[:n]]
            A, b = w[:, :, None] * self.axes[:n][mine[:n]], w * delta_e[mine[:n]]
            offset, *_ = np.linalg.lstsq(A.reshape(-1, 3), b.ravel(), rcond=RANK)
            shifts[mine] = self.axes[mine] @ offset
        return shifts


def attachments(
    configurations: Sequence[Configuration],
    effectors: Sequence[Sequence[EffectorRecord]],
    n_rows: int,
) -> Attachments:
    """Number the points and frames whose displacement counts.

    Effectors of the same name share their offset in all configurations with the same
    reference, and in the reference itself.
    """
    references = {c.displacement_from for c in configurations} - {None}
    index = np.full((len(configurations), n_rows), -1, np.int32)
    axes = np.tile(np.eye(3), (*index.shape, 1, 1))
    keys: dict[Attachment, int] = {}
    for lane, (c, records) in enumerate(zip(configurations, effectors, strict=True)):
        reference = c.displacement_from or (c.name if c.name in references else None)
        if reference is None:
            continue
        measured = lambda e: Rotation.from_rotvec(np.nan_to_num(e.measured)).as_matrix()
        turned = {e.name: measured(e) @ e.reference for e in records if e.is_turn}
        for e in records:
            if e.quantity in FAR_BEYOND:
                key = (reference, e.name, e.quantity)
                index[lane, e.index] = keys.setdefault(key, len(keys))
                axes[lane, e.index] = turned.get(e.name, np.eye(3))
    return Attachments(index, axes, tuple(keys))
