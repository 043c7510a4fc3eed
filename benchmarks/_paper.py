"""The beam of Sec. V, measured by its own model: what the paper's figures share."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._typing import Array, Float, HostArray
from softcal_jax.calibration import (
    CalibrationSettings,
    Evaluator,
    Run,
    build_problem,
    images_of,
    run_start,
)
from softcal_jax.equilibrium import Workers
from softcal_jax.fields import ParameterSpace
from softcal_jax.robots import AnisotropicBeam, anisotropic_beam, synthetic_measurements
from softcal_jax.unknowns import Problem

Cells = tuple[int, int, int]

CELLS: Cells = (10, 2, 2)
"""525 nodes with quadratic tets."""

LENGTH = 0.150
"""Length of the beam [m]."""

STD = 1e-4
"""Standard deviation of all markers, so that errors in its units are lengths [m]."""

CLOSE = 1e-4
"""Largest error at which p_target counts as found: relative for moduli, or [rad]."""

PAPER: dict[str, Any] = {
    "scaling": "linear",
    "interpolation": "linear",
    "tensor_steps": False,
}
"""Choices of `anisotropic_beam` that are the paper's, without its step limits."""


class MeasuredBeam(NamedTuple):
    """A beam of Sec. V, and its calibration against its own p_target."""

    beam: AnisotropicBeam
    problem: Problem

    @property
    def space(self) -> ParameterSpace:
        """The parameters."""
        return self.problem.space

    @property
    def target(self) -> Float[Array, " n_p"]:
        """p_target, scaled [-]."""
        values = [self.beam.target[name] for name in self.space.names]
        return self.space.to_scaled(jnp.asarray(values))


def measured_beam(cells: Cells = CELLS, **choices: Any) -> MeasuredBeam:
    """The beam with effectors measured at p_target, without noise.

    Args:
        cells: Cells along, up and across.
        choices: Further arguments of `anisotropic_beam`.
    """
    beam = anisotropic_beam(cells=cells, std=STD, **choices)
    poses = synthetic_measurements(
        beam.model, beam.space, beam.configurations, beam.target
    )
    return MeasuredBeam(beam, build_problem(beam.model, beam.space, poses))


def subset(
    problem: Problem,
    lanes: Sequence[int],
    markers: Sequence[int] | None = None,
) -> Problem:
    """Some configurations and effectors of a problem, in arrays of the same shapes.

    So that one compiled program serves all of them: lanes to spare repeat the first
    configuration, and what is left out has no weight.

    Args:
        problem: All configurations and effectors.
        lanes: Configurations that are kept, from 0.
        markers: Effectors that are kept, from 0; all by default.
    """
    n = problem.configurations.gravity.shape[0]
    take = np.array([*lanes, *[lanes[0]] * (n - len(lanes))])
    pick = lambda leaf: np.asarray(leaf)[take]
    kept = jax.device_put(jax.tree.map(pick, problem.configurations))
    weight = np.array(kept.effectors.inverse_std)
    weight[len(lanes) :] = 0.0
    if markers is not None:
        weight[:, np.setdiff1d(np.arange(weight.shape[1]), markers)] = 0.0
    kept = eqx.tree_at(lambda c: c.effectors.inverse_std, kept, jnp.asarray(weight))
    return eqx.tree_at(lambda p: p.configurations, problem, kept)


def paper_settings(step_bound: float, max_steps: int) -> CalibrationSettings:
    """The outer loop of the paper: every QP step is taken, with one bound."""
    return CalibrationSettings(adapt=False, step_bound=step_bound, max_steps=max_steps)


def run_each(
    problems: Sequence[Problem],
    settings: CalibrationSettings,
    start: Float[Array, " n_p"],
) -> list[Run]:
    """Runs of several calibrations of one body, side by side, without mirror images.

    Args:
        problems: The calibrations; those with alike arrays share their programs.
        settings: Settings of the outer loop.
        start: Scaled parameters that all of them start from [-].
    """
    images = images_of(problems[0].space, mirror=False)
    lanes = len(problems) * len(problems[0].configurations.gravity)
    with Workers(problems[0].model, lanes) as workers:
        ended = workers.side_by_side(
            partial(
                run_start, Evaluator(problem, workers), settings, start, images=images
            )
            for problem in problems
        )
    return [each.best for each in ended]


def one_run(
    problem: Problem,
    settings: CalibrationSettings,
    start: Float[Array, " n_p"],
) -> Run:
    """A run from one start, without its mirror images."""
    return run_each([problem], settings, start)[0]


def error_curve(run: Run) -> HostArray:
    """||Delta_e|| after each step, from the start on [m]."""
    errors = np.asarray(run.errors) * STD
    return errors[np.isfinite(errors)]


def steps_until(curve: HostArray, size: float) -> int | None:
    """The first step after which an error curve stays at or below a size."""
    above = np.flatnonzero(curve > size)
    first = int(above[-1]) + 1 if above.size else 0
    return first if first < len(curve) else None


def parameter_errors(
    space: ParameterSpace,
    z: Float[Array | HostArray, " n_p"],
    target: Float[Array, " n_p"],
) -> HostArray:
    """Errors of the parameters: relative for moduli, modulo 180 degrees for angles."""
    in_si = lambda v: np.asarray(space.from_scaled(jnp.asarray(v)))
    p, p_target = in_si(z), in_si(target)
    gap = p - p_target
    turn = np.abs(np.mod(gap + 0.5 * np.pi, np.pi) - 0.5 * np.pi)
    angles = np.array([q.unit == "rad" for q in space.parameters])
    return np.where(angles, turn, np.abs(gap / p_target))


def recovered(errors: HostArray) -> bool:
    """Whether every parameter is that of p_target."""
    return bool(np.max(errors) <= CLOSE)


def readable(names: Sequence[str], values: HostArray) -> str:
    """Values of {E_t, E_l, theta} at control points, in kPa and degrees."""
    shown = [
        f"{np.rad2deg(v):.1f} deg" if "theta" in name else f"{v / 1e3:.1f} kPa"
        for name, v in zip(names, values, strict=True)
    ]
    return ", ".join(f"{n} {v}" for n, v in zip(names, shown, strict=True))


def fit_by_scipy(
    residuals: Callable[[HostArray], HostArray],
    jacobian: Callable[[HostArray], HostArray],
    start: HostArray,
    space: ParameterSpace,
    stop: Callable[[HostArray], bool],
) -> HostArray:
    """`scipy.optimize.least_squares` between the bounds, until told to stop.

    Args:
        residuals: Errors at scaled parameters.
        jacobian: Their derivative.
        start: Scaled parameters to start from [-].
        space: The parameters, with their bounds.
        stop: Whether to stop at the parameters of an iteration.

    Returns:
        Scaled parameters at the end [-].
    """
    from scipy.optimize import least_squares

    def watch(intermediate_result) -> None:
        if stop(intermediate_result.x):
            raise StopIteration

    low, high = np.asarray(space.lower()), np.asarray(space.upper())
    return least_squares(
        residuals,
        np.clip(start, low + 1e-9, high - 1e-9),
        jacobian,  # pyright: ignore[reportArgumentType]
        (low, high),
        xtol=1e-10,
        ftol=1e-14,
        gtol=1e-10,
        max_nfev=500,
        callback=watch,
    ).x
