"""How well everything is known that is not calibrated: its prior."""

from dataclasses import fields
from typing import Any, Literal

import equinox as eqx
import numpy as np

from softcal_jax._module import Module

OFFSET = 0.5e-3
"""Offset of a recording, as long as nothing else is known [m]."""

DEGREE = float(np.deg2rad(1.0))


def _std(usual: float, unit: str = "") -> Any:
    """Make a field whose key in [uncertain] has an SI unit, "%", or none."""
    return eqx.field(default=usual, metadata={"unit": unit})


class Uncertain(Module):
    """Standard deviations of what a calibration holds fixed; zero switches one off.

    The defaults are those of careful work on a bench. They count where the robot has
    such a thing and nobody calibrates it; see `ErrorBudget`.

    Attributes:
        nu: Poisson's ratios of the law [-]; at most half of what is left up to 1/2.
        density: Density of the body, relative [-]. One error for the whole body.
        gravity: Direction of gravity in the frame of the mesh, about each of two axes
            [rad]. One error for all configurations that state the same gravity.
        loads: Dead loads, relative [-]. One error for all loads of a name in all
            configurations, since they are weighed on the same scale: such an error is
            not averaged away.
        actuators: Imposed forces, relative [-]. One error for each actuator.
        clamp: Depth at which what holds the body really grips it, along the normal of
            its faces [m]. One error for all configurations that are held alike.
        supports: Stiffness of elastic supports, relative [-]. One error for each.
        recordings: Offset of the points of a recording, along each axis [m]. Unlike the
            others it belongs to the noise: a fit weighs its data by it. "estimated"
            finds it from how far recordings differ, where there are enough of them.
        zeros: Zero error of each motor [rad].
        mountings: Place of each held rigid body, along each axis [m].
        mesh: Error of the mesh, in units of its estimate [-]. One error for all
            configurations. The estimate is how far a finer mesh would move what is
            measured: quadratic tets in place of linear ones, eight quadratic tets in
            place of each. Zero for data that are simulated on the same mesh. Not known
            for more than 50 000 linear or 12 500 quadratic tets, and where the body at
            rest has no stiffness: such a fit has no intervals, and is not called
            identified.
    """

    nu: float = _std(0.05)
    density: float = _std(0.03, "%")
    gravity: float = _std(DEGREE, "rad")
    loads: float = _std(0.02, "%")
    actuators: float = _std(0.02, "%")
    clamp: float = _std(1e-3, "m")
    supports: float = _std(0.3, "%")
    recordings: float | Literal["estimated"] = _std(OFFSET, "m")
    zeros: float = _std(0.5 * DEGREE, "rad")
    mountings: float = _std(0.5e-3, "m")
    mesh: float = _std(1.0)

    def __check_init__(self):
        for name, std in vars(self).items():
            if name == "recordings" and std == "estimated":
                continue
            if not (np.isfinite(std) and std >= 0.0):
                raise ValueError(
                    f"the uncertainty of {name} must be finite and not negative, got "
                    f"{std}; 0 if it is known exactly."
                )


def exactly_known() -> Uncertain:
    """Return what leaves the noise as the only source of error."""
    return Uncertain(**{field.name: 0.0 for field in fields(Uncertain)})
