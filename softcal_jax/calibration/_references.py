"""Displacements from a reference configuration that is itself simulated.

Where a marker was glued is known to a millimetre or so, and its motion between two
poses to a tenth of that. A configuration that names another one as its reference is
compared by differences of poses on both sides, measured and simulated. Every point then
has an unknown offset, and every 6-D sensor an unknown mounting, that both share. As
columns of the covariance of the errors, with a standard deviation far beyond any
offset, they take out what the errors have in common and nothing else. This is
generalised least squares on the differences with their covariance: the noise of the
reference is in all of them (Seber and Wild, Nonlinear Regression, 1989, sec. 2.1.4).

A point keeps its offset along the axes of the mesh. A sensor that is mounted with an
offset d and a turn r is at T M on a body at T, and T_c T_r^-1, the rigid motion from
the reference r to a configuration c, is the same for every mounting M. To first order
the errors of its position and orientation are R d and R r, with the rotation R of the
body in each pose. Sensitivities are those of the nominal point and axes, which half the
unknown turn tilts, so the mounting should be known to millimetres and some degrees.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from softcal_jax._names import unknown_name
from softcal_jax._typing import Float, HostArray, Int
from softcal_jax.configurations import Configuration, EffectorRecord

FAR_BEYOND: Mapping[str, float] = {"point": 1.0, "turn": 100.0}
"""Standard deviation of the offset of an effector, far beyond that of any [m, rad]."""

Attachment = tuple[str, str, str]
"""Names of the reference and of an effector, and its quantity."""


class Attachments(NamedTuple):
    """Where effectors are attached whose displacement counts, and not their position.

    Attributes:
        of_row: Index of the attachment of each row, -1 for rows without.
        axes: Axes of its offset, as a matrix for each row [-].
        keys: What each is, by this index.
    """

    of_row: Int[HostArray, "n_c n_rows"]
    axes: Float[HostArray, "n_c n_rows 3 3"]
    keys: tuple[Attachment, ...]

    @property
    def std(self) -> Float[HostArray, " n_attachments"]:
        """Standard deviation of the offset of each [m, rad]."""
        return np.array([FAR_BEYOND[quantity] for *_, quantity in self.keys], float)


def attachments(
    configurations: Sequence[Configuration],
    effectors: Sequence[Sequence[EffectorRecord]],
    n_rows: int,
) -> Attachments:
    """Number the points and frames whose displacement counts.

    Effectors of the same name share their offset in all configurations with the same
    reference, and in the reference itself.

    Args:
        configurations: The configurations.
        effectors: Effectors of each.
        n_rows: Rows of each configuration.
    """
    references = {c.displacement_from for c in configurations} - {None}
    index = np.full((len(configurations), n_rows), -1, np.int32)
    axes = np.tile(np.eye(3), (*index.shape, 1, 1))
    keys: dict[Attachment, int] = {}
    for lane, (c, own) in enumerate(zip(configurations, effectors, strict=True)):
        reference = c.displacement_from or (c.name if c.name in references else None)
        if reference is None:
            continue
        turned = {e.name: _orientation(e) for e in own if e.is_turn}
        for e in own:
            if e.quantity in FAR_BEYOND:
                key = (reference, e.name, e.quantity)
                index[lane, e.index] = keys.setdefault(key, len(keys))
                axes[lane, e.index] = turned.get(e.name, np.eye(3))
    return Attachments(index, axes, tuple(keys))


def _orientation(turn: EffectorRecord) -> Float[HostArray, "3 3"]:
    """Return the measured rotation of a body from rest, as a matrix [-]."""
    own = Rotation.from_rotvec(np.nan_to_num(turn.measured)).as_matrix()
    return own @ turn.reference


def check_references(
    configurations: Sequence[Configuration],
    effectors: Sequence[Sequence[EffectorRecord]],
    *,
    fitted: Sequence[Configuration] | None = None,
) -> None:
    """Check that references are fitted configurations with the same effectors.

    Args:
        configurations: The configurations, those that are fitted among them.
        effectors: Effectors of each.
        fitted: Those that are fitted; by default all.

    Raises:
        ValueError: If one is not; the message names it.
    """
    known = {c.name: c for c in (configurations if fitted is None else fitted)}
    read = {
        c.name: {(e.name, e.quantity): bool(np.any(e.seen)) for e in own}
        for c, own in zip(configurations, effectors, strict=True)
    }
    for c in configurations:
        name = c.displacement_from
        if name is None:
            continue
        what = f"displacement_from of configuration {c.name!r}"
        if name not in known:
            raise unknown_name(f"configuration in {what}", name, known)
        if name == c.name or known[name].displacement_from is not None:
            raise ValueError(
                f"{what} is {name!r}, which has a reference itself: name a "
                "configuration that has none, such as the robot at rest."
            )
        own = {key: seen for key, seen in read[c.name].items() if key[1] in FAR_BEYOND}
        if not own:
            raise ValueError(
                f"{what} is {name!r}, but it has no points or frames, whose "
                "displacement could count: add markers or a `BodyFrame`."
            )
        for key, seen in own.items():
            if seen and not read[name].get(key, False):
                raise ValueError(
                    f"{what} is {name!r}, where {key[0]!r} was not measured: only "
                    "points and frames that both have can be compared by their "
                    "displacement."
                )


def independent_recordings(configurations: Sequence[Configuration]) -> list[str]:
    """Return the recording of each configuration, one for all that share a reference.

    The noise of the reference is in all of them, so they are no independent witnesses.
    """
    recording = {c.name: c.recording or c.name for c in configurations}
    return [
        recording.get(c.displacement_from or c.name, c.displacement_from or c.name)
        for c in configurations
    ]
