"""Whether intervals by profile likelihood hold p_target, draw by draw."""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from benchmarks._paper import one_run
from benchmarks._problem import Options
from softcal_jax._typing import Array, Float, HostArray
from softcal_jax.calibration import (
    CalibrationSettings,
    LowerCostFound,
    evaluate,
    profile_ends,
)
from softcal_jax.inference import independent
from softcal_jax.unknowns import Problem

SETTINGS = CalibrationSettings(max_steps=40)


MOST_AGAIN = 5
"""Calibrations of a draw that are begun again where its profile found a lower cost."""


class Profiles(NamedTuple):
    """Intervals of the draws of one level of noise.

    Attributes:
        inside: Whether the interval of each parameter in each draw holds p_target.
        both_ends: Whether it has both ends.
        again: Calibrations that were begun again.
    """

    inside: HostArray
    both_ends: HostArray
    again: int

    @property
    def coverage(self) -> float:
        """Share of the intervals with both ends that hold p_target [-]."""
        return float(np.mean(self.inside[self.both_ends]))


def profiles(
    problem: Problem,
    target: Float[Array, " n_p"],
    measured: Float[HostArray, "n_draws n_c n_rows 3"],
    rise: float,
    options: Options,
) -> Profiles:
    """Calibrate each draw and find the interval of every parameter.

    Args:
        problem: The calibration, with its level of noise.
        target: p_target, scaled [-].
        measured: What each draw measured [m].
        rise: Root of the rise of twice the cost at the end of an interval [-].
        options: Who is told how far it is.
    """
    rows, again = [], 0
    for number, draw in enumerate(measured, start=1):
        drawn = eqx.tree_at(_measured, problem, jnp.asarray(draw))
        z, tries = target, 0
        while True:
            z, converged, linear = _fit(drawn, z)
            try:
                ends = (
                    profile_ends(
                        drawn,
                        SETTINGS,
                        z=z,
                        linear=linear,
                        rise=rise,
                        which=range(len(z)),
                    )
                    if converged
                    else None
                )
            except LowerCostFound as lower:
                if tries < MOST_AGAIN:
                    z, tries = lower.z, tries + 1
                    continue
                ends = None
            break
        again += tries
        rows.append(_row(drawn, target - z, ends))
        if number % 10 == 0:
            options.say(f"  intervals of {number} draws")
    both_ends = np.array([[np.isfinite(a + b) for a, b, _ in row] for row in rows])
    inside = np.array([[-a <= gap <= b for a, b, gap in row] for row in rows])
    return Profiles(inside, both_ends, again)


def _measured(problem: Problem):
    return problem.configurations.effectors.measured


def _fit(problem: Problem, z: Float[Array, " n_p"]):
    """A calibration from z, with its linear model at the end."""
    run = one_run(problem, SETTINGS, z)
    z = jnp.asarray(run.z)
    error, W = map(np.asarray, evaluate(problem, z).rows)
    return z, run.converged, independent(W, tuple(problem.space.names), r=error)


def _row(problem: Problem, gap, ends) -> list[tuple[float, float, float]]:
    """How far an interval goes down and up, and how far away p_target is."""
    gaps = np.asarray(problem.space.shorter(gap))
    if ends is None:
        return [(np.nan, np.nan, float(g)) for g in gaps]
    return [
        (low.distance, high.distance, float(g))
        for (low, high), g in zip(ends, gaps, strict=True)
    ]
