"""Displacements from a reference configuration that is itself simulated.

Where a marker was glued is known to a millimetre or so, and its motion between two
poses to a tenth of that. A configuration that names another one as its reference is
compared by differences of poses on both sides, measured and simulated: every marker has
an unknown offset that both share. As a column of the covariance of the errors, with a
standard deviation far beyond any offset, it takes out what the errors of a marker have
in common and nothing else. This is generalised least squares on the differences with
their covariance: the noise of the reference is in all of them (Seber and Wild,
Nonlinear Regression, 1989, sec. 2.1.4).
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from softcal_jax._names import unknown_name
from softcal_jax._typing import HostArray, Int
from softcal_jax.configurations import Configuration

GLUED = 1.0
"""Standard deviation of the offset of a marker, far beyond that of any glue [m]."""


class Referred(NamedTuple):
    """Markers with an offset.

    Attributes:
        of_row: Index of the marker of each row, -1 for rows without.
        keys: Names of the reference and of the marker, by this index.
    """

    of_row: Int[HostArray, "n_c n_rows"]
    keys: tuple[tuple[str, str], ...]


def referred_markers(configurations: Sequence[Configuration], n_rows: int) -> Referred:
    """Number the markers whose displacement counts, and not their position.

    Markers of the same name share their offset in all configurations with the same
    reference, and in the reference itself.
    """
    references = {c.displacement_from for c in configurations} - {None}
    index = np.full((len(configurations), n_rows), -1, np.int32)
    keys: dict[tuple[str, str], int] = {}
    for c, own in zip(configurations, index, strict=True):
        reference = c.displacement_from or (c.name if c.name in references else None)
        if reference is None or c.markers is None:
            continue
        for row, marker in enumerate(c.markers.names):
            own[row] = keys.setdefault((reference, marker), len(keys))
    return Referred(index, tuple(keys))


def check_references(
    fitted: Sequence[Configuration], held_out: Sequence[Configuration]
) -> None:
    """Check that references are fitted configurations with the same markers.

    Raises:
        ValueError: If one is not; the message names it.
    """
    by_name = {c.name: c for c in fitted}
    for c in (*fitted, *held_out):
        name = c.displacement_from
        if name is None:
            continue
        what = f"displacement_from of configuration {c.name!r}"
        if name not in by_name:
            raise unknown_name(f"configuration in {what}", name, by_name)
        reference = by_name[name]
        if reference is c or reference.displacement_from is not None:
            raise ValueError(
                f"{what} is {name!r}, which has a reference itself: name a "
                "configuration that has none, such as the robot at rest."
            )
        if reference.measured is None or reference.markers is None:
            raise ValueError(
                f"{what} is {name!r}, whose markers were not measured: give its "
                "`markers` and `measured`."
            )
        own = () if c.markers is None else c.markers.names
        missing = [m for m in own if m not in reference.markers.names]
        if missing or not own:
            lacks = f"lacks marker {missing[0]!r}" if missing else "has other effectors"
            raise ValueError(
                f"{what} is {name!r}, which {lacks}: only markers that both have can "
                "be compared by their displacement."
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
