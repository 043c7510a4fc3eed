"""What a calibration returns."""

from typing import Literal

import equinox as eqx
import numpy as np

from softcal_jax._typing import Array, Bool, Float, HostArray
from softcal_jax._units import readable_unit
from softcal_jax.calibration._starts import MultiStartResult
from softcal_jax.calibration._state import CalibrationSettings
from softcal_jax.calibration._uncertainty import Uncertainty
from softcal_jax.equilibrium import (
    Model,
    NewtonSettings,
    RobotState,
)
from softcal_jax.fields import ParameterSpace


class ParameterEstimate(eqx.Module):
    """A calibrated parameter, in SI units.

    Attributes:
        name: Its name.
        value: Its value.
        standard_error: Standard error; nan on a bound, or if not determined.
        start: Value before.
        lower: Lower bound.
        upper: Upper bound.
        unit: SI unit.
        at_bound: Whether it ended on a bound.
    """

    name: str
    value: float
    standard_error: float
    start: float
    lower: float
    upper: float
    unit: str
    at_bound: bool


IntervalEnd = Literal["likelihood", "bound", "not found"]


class ParameterInterval(eqx.Module):
    """Confidence interval of a calibrated parameter, in SI units.

    Attributes:
        name: Its name.
        level: Confidence [-].
        lower: Lower end; nan if it was not found.
        upper: Upper end; likewise. An angle goes on beyond its bounds, where it is
            periodic.
        lower_end: What ends it below: "likelihood"; "bound", if the data do not exclude
            the bound of the parameter (or half a turn of a periodic angle); or "not
            found", if fits along the profile did not converge, or jumped.
        upper_end: The same above.
        unit: SI unit.
    """

    name: str
    level: float
    lower: float
    upper: float
    lower_end: IntervalEnd
    upper_end: IntervalEnd
    unit: str

    def __str__(self) -> str:
        """Its ends in a readable unit, in one line."""
        factor, unit = readable_unit([self.lower, self.upper], self.unit)
        words = {"likelihood": "", "bound": " (bound)"}
        turn = self.unit == "rad" and np.isclose(self.upper - self.lower, np.pi)
        if turn and self.lower_end == self.upper_end == "bound":
            return "any angle"
        if self.lower_end == self.upper_end == "not found":
            return "not found"
        ends = [
            f"{factor * value:.4g}{words[end]}" if end in words else "not found"
            for value, end in (
                (self.lower, self.lower_end),
                (self.upper, self.upper_end),
            )
        ]
        return f"{ends[0]} to {ends[1]} {unit}".rstrip()


class HistoryEntry(eqx.Module):
    """One step of the outer loop.

    Attributes:
        step: Number of the step; 0 is the start.
        cost: Half the sum of squared errors in noise units [-].
        rms: Root mean square of the marker distances [m].
        lambda_p: The QP step [-].
        step_bound: Bound on the next step [-].
        accepted: Whether the step was kept.
        kkt_residual: Optimality residual of the QP [-].
        newton_steps: Newton iterations of each configuration.
        values: Parameters after the step, in SI units.
        seconds: Wall time since the start [s].
    """

    step: int
    cost: float
    rms: float
    lambda_p: tuple[float, ...]
    step_bound: float
    accepted: bool
    kkt_residual: float
    newton_steps: tuple[int, ...]
    values: dict[str, float]
    seconds: float

    def __str__(self) -> str:
        """One line: the fit and the parameters after the step."""
        values = ", ".join(f"{name} {value:.5g}" for name, value in self.values.items())
        refused = "" if self.accepted else " (step refused)"
        return f"step {self.step}: rms {1e3 * self.rms:.3f} mm, {values}{refused}"


class EffectorFit(eqx.Module):
    """Measured and simulated values of an effector that is no point.

    Attributes:
        name: Its name.
        unit: Unit of its values.
        measured: Measured values; a turn is counted from the measured orientation.
        before: Simulated values with the start parameters; NaN without equilibrium.
        after: Simulated values with the calibrated parameters; likewise.
        error_before: Simulated minus measured, 0 where not measured.
        error_after: The same after calibration.
        is_turn: Whether it is the orientation of a rigid body.
        reference: Of a turn, the orientation that it is counted from, as a matrix [-].
    """

    name: str
    unit: str
    measured: Float[HostArray, " k"]
    before: Float[HostArray, " k"]
    after: Float[HostArray, " k"]
    error_before: Float[HostArray, " k"]
    error_after: Float[HostArray, " k"]
    is_turn: bool
    reference: Float[HostArray, "3 3"] | None = None


class ConfigurationFit(eqx.Module):
    """Measured and simulated effectors of one configuration.

    Points, markers before all, stand in arrays; `others` holds the rest.

    Attributes:
        name: Name of the configuration.
        role: Whether it was fitted, or only predicted.
        marker_names: Names of the markers.
        measured: Measured positions [m].
        seen: Which of their coordinates were measured; the others are NaN, or numbers
            that mean nothing.
        at_rest: Marker positions on the undeformed mesh [m].
        before: Simulated positions with the start parameters; NaN if these have no
            equilibrium [m].
        after: Simulated positions with the calibrated parameters; likewise [m].
        error_before: Simulated minus measured, 0 where not measured [m].
        error_after: The same after calibration [m].
        displacement: Nodal displacement after calibration [m].
        newton_steps: Newton iterations of the last equilibrium.
        residual: Its relative residual [-].
        min_det_F: Its smallest det F [-].
        others: Effectors that are no points: orientations, lengths, angles, forces.
        robot: Rigid bodies, actuators and reactions after calibration; None for a body
            without rigid bodies and actuators.
    """

    name: str
    role: Literal["calibration", "validation"]
    marker_names: tuple[str, ...]
    measured: Float[HostArray, "n_markers 3"]
    seen: Bool[HostArray, "n_markers 3"]
    at_rest: Float[HostArray, "n_markers 3"]
    before: Float[HostArray, "n_markers 3"]
    after: Float[HostArray, "n_markers 3"]
    error_before: Float[HostArray, "n_markers 3"]
    error_after: Float[HostArray, "n_markers 3"]
    displacement: Float[HostArray, "n_nodes 3"]
    newton_steps: int
    residual: float
    min_det_F: float
    others: tuple[EffectorFit, ...] = ()
    robot: RobotState | None = None

    @property
    def turn_before(self) -> float:
        """Root mean square angle between simulated and measured orientations [rad].

        With the start parameters; NaN without an orientation or an equilibrium.
        """
        return _rms_turn([e.error_before for e in self.others if e.is_turn])

    @property
    def turn_after(self) -> float:
        """The same after calibration [rad]."""
        return _rms_turn([e.error_after for e in self.others if e.is_turn])

    @property
    def rms_before(self) -> float:
        """Root mean square of the marker distances with the start parameters [m].

        NaN if there is no equilibrium with them.
        """
        return _rms(self.error_before)

    @property
    def rms_after(self) -> float:
        """Root mean square of the marker distances after calibration [m].

        NaN if there is no equilibrium.
        """
        return _rms(self.error_after)

    @property
    def motion(self) -> float:
        """Root mean square of how far the markers moved from rest [m].

        Over the measured coordinates, like the distances.
        """
        return _rms(np.where(self.seen, self.measured - self.at_rest, 0.0))


def _rms(distances: Float[HostArray, "n_markers 3"]) -> float:
    if len(distances) == 0:
        return float("nan")
    return float(np.sqrt(np.mean(np.sum(distances**2, axis=1))))


def _rms_turn(errors: list[Float[HostArray, "3"]]) -> float:
    return _rms(np.array(errors).reshape(-1, 3))


class CalibrationResult(eqx.Module):
    """Outcome of a calibration.

    Attributes:
        converged: Whether lambda_p vanished.
        parameters: The calibrated parameters.
        uncertainty: Their covariance and what it rests on.
        configurations: Fits, then predictions.
        history: One entry per step.
        space: The parameters, with start and bounds.
        model: The model with the calibrated parameters.
        z: Scaled parameters [-].
        W_ep: Stacked compliances in noise units, for identifiability [-].
        settings: Settings of the outer loop.
        newton: Settings of the equilibrium.
        timing_s: Wall time of "compile" (JAX tracing and compiling) and "solve" [s].
        notes: What the user should know before using the numbers.
        starts: Where runs from many starts ended, if there were any.
        intervals: What `profile_intervals` gave, if it was asked.
    """

    converged: bool
    parameters: tuple[ParameterEstimate, ...]
    uncertainty: Uncertainty
    configurations: tuple[ConfigurationFit, ...]
    history: tuple[HistoryEntry, ...]
    space: ParameterSpace
    model: Model
    z: Float[Array, " n_p"]
    W_ep: Float[HostArray, "n_e n_p"]
    settings: CalibrationSettings
    newton: NewtonSettings
    timing_s: dict[str, float]
    notes: tuple[str, ...]
    starts: MultiStartResult | None = None
    intervals: tuple[ParameterInterval, ...] = ()

    def __str__(self) -> str:
        """The parameters, the fits and the notes, in a few lines."""
        verdict = "converged" if self.converged else "NOT CONVERGED"
        lines = [f"Calibration {verdict} in {len(self.history) - 1} steps."]
        lines += [
            f"  {p.name} = {p.value:.5g} +- {p.standard_error:.2g} {p.unit} "
            f"(start {p.start:.5g}, bounds {p.lower:.5g} to {p.upper:.5g})"
            for p in self.parameters
        ]
        lines += [
            f"  {100 * i.level:g} % interval of {i.name}: {i}" for i in self.intervals
        ]
        lines += [
            f"  {fit.name} ({fit.role}): rms {1e3 * fit.rms_before:.3f} to "
            f"{1e3 * fit.rms_after:.3f} mm"
            for fit in self.configurations
        ]
        return "\n".join(lines + [f"  Note: {note}" for note in self.notes])

    def value(self, name: str) -> float:
        """Calibrated value of a parameter.

        Raises:
            ValueError: If no parameter has that name.
        """
        for parameter in self.parameters:
            if parameter.name == name:
                return parameter.value
        raise ValueError(
            f"unknown parameter {name!r}; this calibration has "
            f"{', '.join(p.name for p in self.parameters)}."
        )
