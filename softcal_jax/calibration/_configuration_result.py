"""One configuration at equilibrium: its effectors, measured and simulated."""

from collections.abc import Sequence
from typing import Literal

import equinox as eqx
import numpy as np

from softcal_jax._typing import Float, HostArray
from softcal_jax.configurations import EffectorRecord
from softcal_jax.equilibrium import Model, RobotState


class ConfigurationResult(eqx.Module):
    """A configuration that was fitted, predicted, or only simulated.

    Attributes:
        name: Name of the configuration.
        role: Whether it was fitted, predicted with parameters fitted to others, or
            simulated with given parameters.
        converged: Whether it has an equilibrium.
        outcome: How the solve ended, in words.
        effectors: Measured and simulated values: markers, then other effectors.
        displacement: Nodal displacement [m].
        newton_steps: Newton iterations of the equilibrium.
        load_steps: Its load steps.
        residual: Its relative residual [-].
        min_det_F: Its smallest det F [-].
        robot: Rigid bodies, actuators and reactions; None without an equilibrium, and
            for a body without rigid bodies and actuators.
    """

    name: str
    role: Literal["calibration", "validation", "simulation"]
    converged: bool
    outcome: str
    effectors: tuple[EffectorRecord, ...]
    displacement: Float[HostArray, "n_nodes 3"]
    newton_steps: int
    load_steps: int
    residual: float
    min_det_F: float
    robot: RobotState | None = None

    @property
    def points(self) -> tuple[EffectorRecord, ...]:
        """Markers and points of other effectors."""
        return tuple(e for e in self.effectors if e.quantity == "point")

    @property
    def others(self) -> tuple[EffectorRecord, ...]:
        """Orientations, lengths, angles and forces."""
        return tuple(e for e in self.effectors if e.quantity != "point")

    @property
    def turns(self) -> tuple[EffectorRecord, ...]:
        """Orientations of rigid bodies."""
        return tuple(e for e in self.effectors if e.is_turn)

    @property
    def error_after(self) -> Float[HostArray, "n_points 3"]:
        """Simulated minus measured positions, 0 where not measured [m]."""
        errors = [e.error(e.simulated) for e in self.points]
        return np.array(errors).reshape(-1, 3)

    @property
    def rms_before(self) -> float:
        """Root mean square of the marker distances with the start parameters [m].

        NaN if there is no equilibrium with them, and without markers.
        """
        return _rms([e.error(e.simulated_before) for e in self.points])

    @property
    def rms_after(self) -> float:
        """Root mean square of the marker distances after calibration [m]; likewise."""
        return _rms(self.error_after)

    @property
    def motion(self) -> float:
        """Root mean square displacement of the markers, in measured coordinates [m]."""
        return _rms([e.error(e.at_rest) for e in self.points])

    @property
    def turn_before(self) -> float:
        """Root mean square angle between simulated and measured orientations [rad].

        With the start parameters; NaN without an orientation or an equilibrium.
        """
        return _rms([e.error(e.simulated_before) for e in self.turns])

    @property
    def turn_after(self) -> float:
        """The same after calibration [rad]."""
        return _rms([e.error(e.simulated) for e in self.turns])

    @property
    def rms_share(self) -> float:
        """Marker distances after calibration over their motion; NaN without one [-]."""
        return self.rms_after / self.motion if self.motion > 0.0 else float("nan")

    @property
    def largest_displacement(self) -> float:
        """Displacement of the node that moves most [m]."""
        return float(np.linalg.norm(self.displacement, axis=1).max())


def _rms(errors: Sequence[Float[HostArray, "3"]] | HostArray) -> float:
    if len(errors) == 0:
        return float("nan")
    return float(np.sqrt(np.mean(np.sum(np.square(errors), axis=1))))


class SimulationResult(eqx.Module):
    """A forward simulation.

    Attributes:
        model: The model that was simulated.
        configurations: Its equilibrium in each configuration.
    """

    model: Model
    configurations: tuple[ConfigurationResult, ...]

    @property
    def converged(self) -> bool:
        """Whether every configuration has an equilibrium."""
        return all(result.converged for result in self.configurations)
