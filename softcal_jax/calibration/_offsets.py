"""Offsets of points and frames that a fit has found, and measured values without."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

from softcal_jax._typing import Array, Float, HostArray
from softcal_jax.calibration._noise import Attachment, attachments
from softcal_jax.calibration._problem import CalibrationProblem
from softcal_jax.configurations import Configuration, ConfigurationLanes

Offsets = Mapping[Attachment, Float[HostArray, "3"]]
"""Simulated minus measured values that all share, see `Attachments` [m, rad]."""


def attachment_offsets(
    problem: CalibrationProblem,
    configurations: Sequence[Configuration],
    lanes: ConfigurationLanes,
    delta_e: Float[Array, "n_c n_rows 3"],
) -> Offsets:
    """Return the offset of every effector whose displacement was fitted.

    Args:
        problem: The calibration to the fitted configurations, with its noise.
        configurations: All configurations, the fitted ones first.
        lanes: Their effectors.
        delta_e: Simulated minus measured values of the fitted ones.
    """
    effectors = problem.configurations.effectors
    n_rows = effectors.measured.shape[1]
    keys = attachments(configurations, lanes.effectors, n_rows).keys
    if not keys:
        return {}
    assert problem.noise is not None
    offsets = problem.noise.attachment_offsets(effectors, delta_e)
    return dict(zip(keys, offsets, strict=True))


def with_offsets(
    configurations: Sequence[Configuration], lanes: ConfigurationLanes, offsets: Offsets
) -> ConfigurationLanes:
    """Return records whose measured values are moved by their offsets.

    What is left between measured and simulated values are then the errors of the
    displacements, which were fitted.
    """
    if not offsets:
        return lanes
    n_rows = lanes.arrays.effectors.measured.shape[1]
    of_row, axes, keys = attachments(configurations, lanes.effectors, n_rows)
    effectors = []
    for lane, records in enumerate(lanes.effectors):
        moved = []
        for e in records:
            index = of_row[lane, e.index]
            offset = axes[lane, e.index] @ offsets[keys[index]] if index >= 0 else 0.0
            moved.append(replace(e, measured=e.measured + offset))
        effectors.append(tuple(moved))
    return lanes._replace(effectors=tuple(effectors))
