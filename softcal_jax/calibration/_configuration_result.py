"""One configuration at equilibrium: its effectors, measured and simulated."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from scipy.special import chdtrc

from softcal_jax._module import Module, Result
from softcal_jax._typing import Float, HostArray
from softcal_jax.calibration._noise import AnyArray, CorrelatedNoise
from softcal_jax.configurations import (
    Configuration,
    ConfigurationArrays,
    ConfigurationLanes,
    EffectorRecord,
    configuration_lanes,
)
from softcal_jax.equilibrium import (
    RESULTS,
    EquilibriumSolution,
    Model,
    RobotState,
    effector_values,
    robot_states,
)
from softcal_jax.inference import UNLIKELY, whitened
from softcal_jax.sensitivity import Response

Role = Literal["calibration", "validation", "simulation"]
Misfit = Literal["worse than before", "unexplained"]


class ConfigurationResult(Module):
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
        rounding: What rounding leaves of that, see `EquilibriumSolution` [-].
        at_rounding: Whether Newton stopped there, with a residual above `rtol`.
        min_det_F: Its smallest det F [-].
        robot: Rigid bodies, actuators and reactions; None without an equilibrium, and
            for a body without rigid bodies and actuators.
        W_ep: Compliances of the rows of its effectors, in their units, per unit of
            lambda_p; None where nothing was calibrated.
        columns: Correlated part of the noise of all coordinates, in the order of the
            effectors, in units of their standard deviations; see `CorrelatedNoise` [-].
        posed: The configuration as described: supports, loads, gravity; None where a
            result was made without.
    """

    name: str
    role: Role
    converged: bool
    outcome: str
    effectors: tuple[EffectorRecord, ...]
    displacement: Float[HostArray, "n_nodes 3"]
    newton_steps: int
    load_steps: int
    residual: float
    rounding: float
    at_rounding: bool
    min_det_F: float
    robot: RobotState | None = None
    W_ep: Float[HostArray, "n_rows 3 n_p"] | None = None
    columns: Float[HostArray, "n_coordinates n_columns"] | None = None
    posed: Configuration | None = None

    def __str__(self) -> str:
        """Write how far the markers are off before and after, in one line."""
        before, after = 1e3 * self.rms_before, 1e3 * self.rms_after
        return f"{self.name} ({self.role}): rms {before:.3f} to {after:.3f} mm"

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
    def off(self) -> str:
        """Marker distances after calibration, "1.06 mm off, 6 % of how far they moved".

        Without the share if the markers did not move.
        """
        text = f"{1e3 * self.rms_after:.2f} mm off"
        if self.motion > 0.0:
            text += f", {100.0 * self.rms_share:.0f} % of how far they moved"
        return text

    def noise_probability(self, noise_scale: float = 1.0) -> float:
        """Compute the probability of residuals as large from the noise alone [-].

        Args:
            noise_scale: Factor on the stated standard deviations [-].
        """
        return self._chance(lambda e: e.simulated, noise_scale)

    @property
    def stays(self) -> bool:
        """Whether the stated noise explains that its markers are not at rest."""
        return self._chance(lambda e: e.at_rest, points=True) >= UNLIKELY

    def _chance(
        self,
        value: Callable[[EffectorRecord], Float[HostArray, " k"]],
        noise_scale: float = 1.0,
        *,
        points: bool = False,
    ) -> float:
        """Compute the probability that noise alone puts effectors as far from values.

        From the chi-squared distribution of the measured coordinates; NaN without any.
        With `points`, of these alone.
        """
        counts = [e.quantity == "point" or not points for e in self.effectors]
        asked = [e for e, own in zip(self.effectors, counts, strict=True) if own]
        own = [e.error(value(e)) / e.std for e in asked]
        errors = np.concatenate([np.zeros(0), *own]) / noise_scale
        if self.columns is not None:
            sizes = [len(e.std) for e in self.effectors]
            rows = np.repeat(np.array(counts, bool), sizes)
            errors = whitened(self.columns[rows] / noise_scale, errors)
        n = sum(int(e.seen.sum()) for e in asked)
        return float(chdtrc(n, np.sum(errors**2))) if n else float("nan")

    def misfit(
        self, noise: Literal["stated", "estimated"], noise_scale: float = 1.0
    ) -> Misfit | None:
        """Say how the calibrated model contradicts it, if it does.

        Residuals that a stated noise explains are no misfit, however large. A noise
        that is estimated from the residuals explains nothing, but for a pose whose
        markers did not move (within the stated noise, since a wrong pose raises the
        estimated one): there is no motion to compare its residuals with.

        Args:
            noise: Where the noise comes from.
            noise_scale: Factor on the stated standard deviations, see
                `Uncertainty.level`.
        """
        compared = noise == "stated" or self.stays
        if compared and self.noise_probability(noise_scale) >= UNLIKELY:
            return None
        if self.role == "calibration" and self.rms_after > self.rms_before:
            return "worse than before"
        return "unexplained" if self.rms_after > 0.25 * self.motion else None

    @property
    def largest_displacement(self) -> float:
        """Displacement of the node that moves most [m]."""
        return float(np.linalg.norm(self.displacement, axis=1).max())


def _rms(errors: Sequence[Float[HostArray, "3"]] | HostArray) -> float:
    if len(errors) == 0:
        return float("nan")
    return float(np.sqrt(np.mean(np.sum(np.square(errors), axis=1))))


class SimulationResult(Result):
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

    @property
    def headline(self) -> str:
        """In how many configurations there is an equilibrium, in a sentence."""
        n = len(self.configurations)
        found = sum(result.converged for result in self.configurations)
        if found < n:
            return f"{found} of {n} configurations have an equilibrium."
        every = "The configuration has" if n == 1 else f"All {n} configurations have"
        return f"{every} an equilibrium."

    def _words(self) -> str:
        return self.headline


def configuration_results(
    model: Model,
    configurations: Sequence[Configuration],
    lanes: ConfigurationLanes,
    *,
    n_fitted: int,
    before: Float[AnyArray, "n_c n_rows 3"],
    response: Response,
    noise: CorrelatedNoise | None,
) -> tuple[ConfigurationResult, ...]:
    """Describe fitted and held-out configurations that have an equilibrium.

    Args:
        model: The model with the calibrated parameters.
        configurations: The configurations, the fitted ones first.
        lanes: Their arrays and effectors.
        n_fitted: Number of those that were fitted.
        before: Effectors with the start parameters.
        response: Equilibria, effectors and compliances with the calibrated ones.
        noise: Their noise.
    """
    effectors = [
        tuple(
            replace(e, simulated_before=e.among(first), simulated=e.among(last))
            for e in of_pose
        )
        for of_pose, first, last in zip(
            lanes.effectors,
            np.asarray(before),
            np.asarray(response.effectors),
            strict=True,
        )
    ]
    held_out = len(configurations) - n_fitted
    roles: tuple[Role, ...] = ("calibration",) * n_fitted + ("validation",) * held_out
    results = _results(
        model,
        configurations,
        lanes.arrays,
        response.equilibrium,
        roles=roles,
        effectors=effectors,
    )
    W_ep = np.asarray(response.W_ep).reshape(*np.shape(response.effectors), -1)
    columns = _columns(lanes, noise)
    return tuple(
        replace(result, W_ep=W, columns=A)
        for result, W, A in zip(results, W_ep, columns, strict=True)
        if result.converged
    )


def _columns(
    lanes: ConfigurationLanes, noise: CorrelatedNoise | None
) -> list[HostArray | None]:
    """Return the correlated noise of each configuration alone, see its results."""
    if noise is None:
        return [None] * len(lanes.effectors)
    effectors = lanes.arrays.effectors
    # Measured values are without the offsets of attachments.
    A = noise.on_host(effectors)[:, : noise.n_common] * np.asarray(noise.jitter)
    A = A.reshape(*np.shape(effectors.inverse_std), noise.n_common)
    found: list[HostArray | None] = []
    for own, records in zip(A, lanes.effectors, strict=True):
        rows = [own[e.index, : len(e.std)] for e in records]
        stacked = np.concatenate([np.zeros((0, A.shape[-1])), *rows])
        found.append(stacked[:, np.any(stacked != 0.0, axis=0)])
    return found


def simulation_result(
    model: Model, configurations: Sequence[Configuration], solution: EquilibriumSolution
) -> SimulationResult:
    """Describe a forward simulation.

    Args:
        model: The model.
        configurations: What was simulated; measured values are ignored, and turns are
            counted from rest.
        solution: Their equilibria, one lane per configuration; without one, the
            result says why.
    """
    lanes = configuration_lanes(model.mesh, configurations, model.mechanism)
    reference = lambda arrays: arrays.effectors.turn_reference
    from_rest = jnp.broadcast_to(jnp.eye(3), reference(lanes.arrays).shape)
    arrays = eqx.tree_at(reference, lanes.arrays, from_rest)

    effectors = [
        _simulated(own, model, _lane(arrays, i), _lane(solution, i))
        for i, own in enumerate(lanes.effectors)
    ]
    results = _results(
        model,
        configurations,
        arrays,
        solution,
        roles=("simulation",) * len(configurations),
        effectors=effectors,
    )
    return SimulationResult(model, results)


_effector_values = eqx.filter_jit(effector_values)


def _simulated(
    records: Sequence[EffectorRecord],
    model: Model,
    lane: ConfigurationArrays,
    solution: EquilibriumSolution,
) -> tuple[EffectorRecord, ...]:
    """Fill in the values at one equilibrium, as if nothing had been measured."""
    records = tuple(
        replace(
            record,
            measured=np.full_like(record.measured, np.nan),
            std=np.full_like(record.std, np.inf),
            reference=np.eye(3),
        )
        for record in records
    )
    if not (records and solution.converged):
        return records
    # Positions are cheap enough to compute without compiling.
    compute = _effector_values if lane.effectors.has_forces else effector_values
    values = np.asarray(
        compute(model, lane, solution.displacement, solution.multipliers)
    )
    return tuple(replace(e, simulated=e.among(values)) for e in records)


def _results(
    model, configurations, arrays, solution, *, roles: Sequence[Role], effectors
) -> tuple[ConfigurationResult, ...]:
    """Describe every configuration of a batch."""
    states = robot_states(model, configurations, solution, arrays)
    return tuple(
        ConfigurationResult(
            name=configuration.name,
            role=roles[i],
            converged=bool(solution.converged[i]),
            outcome=_outcome(solution, i),
            effectors=effectors[i],
            displacement=np.asarray(solution.displacement[i])[: model.mesh.n_nodes],
            newton_steps=int(solution.steps[i]),
            load_steps=int(solution.load_steps[i]),
            residual=float(solution.residual[i]),
            rounding=float(solution.rounding[i]),
            at_rounding=bool(solution.at_rounding[i]),
            min_det_F=float(solution.min_det_F[i]),
            robot=states[i],
            posed=configuration,
        )
        for i, configuration in enumerate(configurations)
    )


def _outcome(solution: EquilibriumSolution, i: int) -> str:
    """Say how the solve of a configuration ended."""
    words = RESULTS[_lane(solution.result, i)]
    if not solution.at_rounding[i]:
        return words
    # Without any load, rounding is all that there is.
    loaded = solution.rounding[i] < 1.0
    residual = f" (residual {solution.residual[i]:.1e})" if loaded else ""
    return f"{words} at rounding{residual}"


def _lane(batch, i: int):
    """Pick one configuration of a batch."""
    # Sliced on the host: on the device, each shape compiles a program.
    return jax.device_put(jax.tree.map(lambda leaf: np.asarray(leaf)[i], batch))
