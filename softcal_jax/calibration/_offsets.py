"""Offsets of markers that a fit has found, and measured values without them."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from softcal_jax._typing import Float, HostArray
from softcal_jax.calibration._problem import CalibrationProblem, Evaluation
from softcal_jax.calibration._references import referred_markers
from softcal_jax.configurations import Configuration, ConfigurationLanes

Offsets = Mapping[tuple[str, str], Float[HostArray, "3"]]
"""Simulated minus measured positions that all share, by reference and marker [m]."""


def marker_offsets(
    problem: CalibrationProblem,
    configurations: Sequence[Configuration],
    evaluation: Evaluation,
) -> Offsets:
    """Return the offset of every marker whose displacement was fitted."""
    weight = np.asarray(problem.configurations.effectors.inverse_std)
    keys = referred_markers(configurations, weight.shape[1]).keys
    if not keys:
        return {}
    assert problem.noise is not None
    found = problem.noise.marker_offsets(np.asarray(evaluation.delta_e), weight)
    return dict(zip(keys, found, strict=True))


def with_offsets(
    configurations: Sequence[Configuration], lanes: ConfigurationLanes, offsets: Offsets
) -> ConfigurationLanes:
    """Return records whose measured markers are moved by their offsets.

    What is left between measured and simulated positions are then the errors of the
    displacements, which were fitted.
    """
    if not offsets:
        return lanes
    n_rows = lanes.arrays.effectors.measured.shape[1]
    index, keys = referred_markers(configurations, n_rows)
    effectors = tuple(
        tuple(
            replace(e, measured=e.measured + offsets[keys[own[e.index]]])
            if own[e.index] >= 0
            else e
            for e in records
        )
        for own, records in zip(index, lanes.effectors, strict=True)
    )
    return lanes._replace(effectors=effectors)
