"""One configuration at equilibrium: its effectors, measured and simulated."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Literal

import jax
import numpy as np
from scipy.special import chdtrc

from softcal_jax._lanes import lane_of
from softcal_jax._module import Module, Result
from softcal_jax._text import MOST_NAMED, listed
from softcal_jax._typing import Float, HostArray
from softcal_jax._units import readable
from softcal_jax.configurations import (
    Configuration,
    ConfigurationLanes,
    EffectorRecord,
    configuration_lanes,
    following_each_other,
    rms_distance,
)
from softcal_jax.contact import face_size
from softcal_jax.equilibrium import (
    EquilibriumSolution,
    Model,
    Omission,
    RobotState,
    compiled_effectors,
    effector_values,
    omission_sentences,
    omissions,
    outcome_words,
    robot_states,
)
from softcal_jax.inference import UNLIKELY, LinearModel, whitened
from softcal_jax.mesh import SelfContact, self_contact
from softcal_jax.sensitivity import Response
from softcal_jax.unknowns import AnyArray, CorrelatedNoise, attachments

_BETWEEN = 0.02
"""Depth from which nodes count where contact is modelled, over a face's size [-]."""

Role = Literal[
    "calibration", "validation", "prediction", "design", "command", "simulation"
]


class ConfigurationResult(Module):
    """A configuration that was fitted, predicted, or only simulated.

    Attributes:
        name: Name of the configuration.
        role: Whether it was fitted, held out of a fit, measured and predicted without
            any, designed or commanded for goals, or simulated without a measurement.
        converged: Whether it has an equilibrium.
        outcome: How the solve ended, in words.
        effectors: Measured and simulated values: markers, then other effectors.
        displacement: Nodal displacement [m].
        newton_steps: Newton iterations of the equilibrium.
        load_steps: Its load steps.
        residual: Its relative residual [-].
        rounding: Relative residual that rounding leaves, see `EquilibriumSolution` [-].
        at_rounding: Whether Newton stopped at rounding, with a residual above `rtol`.
        min_det_F: Its smallest det F [-].
        robot: Rigid bodies, actuators, reactions and contacts; None without an
            equilibrium, and for a body without any that could be.
        W_ep: Compliances of the rows of its effectors, in their units, per unit of
            lambda_p; None where nothing was calibrated.
        columns: Errors that coordinates share, in the order of the effectors, in units
            of their standard deviations: the correlated part of the noise, and with a
            stated one what is considered [-].
        posed: The configuration as described; None where a result was made without it.
        self_contact: Where the body passes through itself; None if it does not, or
            there is no equilibrium.
        omissions: What else the model leaves out.
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
    self_contact: SelfContact | None = None
    omissions: tuple[Omission, ...] = ()

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
        """Simulated minus measured positions, NaN where not measured [m]."""
        return np.array([e.residual for e in self.points]).reshape(-1, 3)

    @property
    def rms_before(self) -> float:
        """The same as `rms_after` with the start parameters [m]."""
        return rms_distance(self.points, lambda e: e.simulated_before)

    @property
    def rms_after(self) -> float:
        """Root mean square distance of measured points after calibration [m].

        Of a point of which some coordinates were measured, along these; NaN where no
        point was measured.
        """
        return rms_distance(self.points, lambda e: e.simulated)

    @property
    def motion(self) -> float:
        """Root mean square displacement of the same points, as measured [m]."""
        return rms_distance(self.points, lambda e: e.at_rest)

    @property
    def turn_before(self) -> float:
        """Root mean square angle to measured orientations before calibration [rad]."""
        return rms_distance(self.turns, lambda e: e.simulated_before)

    @property
    def turn_after(self) -> float:
        """Root mean square angle to measured orientations after calibration [rad]."""
        return rms_distance(self.turns, lambda e: e.simulated)

    @property
    def rms_share(self) -> float:
        """Marker distances after calibration over their motion; NaN without one [-]."""
        return self.rms_after / self.motion if self.motion > 0.0 else float("nan")

    def _chance(
        self,
        value: Callable[[EffectorRecord], Float[HostArray, " k"]],
        noise_scale: float = 1.0,
        *,
        points: bool = False,
    ) -> float:
        """Compute the chance that noise alone takes readings as far from given values.

        By the chi-squared distribution of all measured coordinates, or with `points` of
        those of points alone; NaN without any.
        """
        errors, rows, n = [np.zeros(0)], [], 0
        for e in self.effectors:
            asked = e.quantity == "point" or not points
            rows += [asked] * len(e.std)
            if asked:
                errors.append(np.where(e.seen, e.error(value(e)), 0.0) / e.std)
                n += int(e.seen.sum())
        stacked = np.concatenate(errors) / noise_scale
        if self.columns is not None:
            columns = self.columns[np.array(rows, bool)]
            stacked = whitened(columns / noise_scale, stacked)
        return float(chdtrc(n, np.sum(stacked**2))) if n else float("nan")

    def with_considered(self, linear: LinearModel) -> "ConfigurationResult":
        """Return it with the considered errors of a fit among its columns."""
        assert self.W_ep is not None
        assert self.columns is not None
        errors = linear.considered.values[linear.pose == linear.poses.index(self.name)]
        seen = np.zeros(self.W_ep.shape[:2], bool)
        for e in self.effectors:
            seen[e.index, : len(e.std)] = e.seen
        every = np.zeros((*seen.shape, errors.shape[1]))
        every[seen] = errors
        more = _in_order(every, self.effectors)
        return replace(self, columns=np.concatenate([self.columns, more], axis=1))

    def misfit(self, noise: Literal["stated", "estimated"], noise_scale: float) -> bool:
        """Return whether the calibrated model contradicts this configuration.

        Residuals that stated errors explain are no misfit, however large. A noise
        that is estimated from the residuals explains none, except in a pose whose
        markers did not move, which has no motion to compare residuals with. Whether
        they moved is judged by the stated noise: a wrong pose raises the estimated one.

        Args:
            noise: Where the noise comes from.
            noise_scale: Factor on the stated standard deviations [-].
        """
        at_rest, simulated = lambda e: e.at_rest, lambda e: e.simulated
        stays = self._chance(at_rest, points=True) >= UNLIKELY
        compared = noise == "stated" or stays
        if compared and self._chance(simulated, noise_scale) >= UNLIKELY:
            return False
        worse = self.role == "calibration" and self.rms_after > self.rms_before
        return worse or self.rms_after > 0.25 * self.motion

    @property
    def largest_displacement(self) -> float:
        """Displacement of the node that moves most [m]."""
        return float(np.linalg.norm(self.displacement, axis=1).max())


def off_by(poses: Sequence[tuple[str, float, float]], done: str = "") -> str:
    """Say how far poses are `done` off, given their names, errors and motions [m]."""
    share = lambda x, u: f", {100.0 * x / u:.0f} % of its motion" if u > 0.0 else ""
    each = [
        f"{p} is {done}{readable(x, 'distance')} off{share(x, u)}" for p, x, u in poses
    ]
    more = [f"{len(each) - MOST_NAMED} more"] * (len(each) > MOST_NAMED)
    return "; ".join(each[:MOST_NAMED] + more)


def omitted(fits: Sequence[ConfigurationResult]) -> tuple[str, ...]:
    """Say what the model leaves out, and in which poses the body touches itself."""
    sentences = omission_sentences(o for fit in fits for o in fit.omissions)
    deep = [(f.self_contact, f.name) for f in fits if f.self_contact is not None]
    if not deep:
        return sentences
    deep.sort(key=lambda one: -one[0].depth[0])
    names = listed([name for _, name in deep], MOST_NAMED)
    words = f"{'up to ' * (len(deep) > 1)}{deep[0][0].words}"
    touches = (
        f"The body touches itself in {names}, {words}: this is not modelled where it "
        "is not said which surfaces touch (`touching`)."
    )
    return *sentences, touches


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
    def doubts(self) -> tuple[str, ...]:
        """What the model leaves out, one sentence each; empty if nothing is known."""
        return omitted(self.configurations)


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
    """Describe configurations that have an equilibrium, the fitted ones first.

    `before` are the effectors with the start parameters; `model` and `response` are
    those with the calibrated ones.
    """
    held_out = len(configurations) - n_fitted
    roles: tuple[Role, ...] = ("calibration",) * n_fitted + ("validation",) * held_out
    after, solution = np.asarray(response.effectors), response.equilibrium
    results = _results(
        model, configurations, lanes, solution, roles=roles, before=before, after=after
    )
    W_ep = np.asarray(response.W_ep).reshape(*after.shape, -1)
    columns = [None] * len(results) if noise is None else _columns(lanes, noise)
    return tuple(
        replace(result, W_ep=W, columns=A)
        for result, W, A in zip(results, W_ep, columns, strict=True)
        if result.converged
    )


def _columns(lanes: ConfigurationLanes, noise: CorrelatedNoise) -> list[HostArray]:
    """Return the `columns` of the result of each configuration."""
    effectors = lanes.arrays.effectors
    # Offsets of attachments have been taken off the measured values already.
    A = noise.on_host(effectors)[:, : noise.n_common] * np.asarray(noise.jitter)
    A = A.reshape(*np.shape(effectors.inverse_std), noise.n_common)
    columns = []
    for of_pose, records in zip(A, lanes.effectors, strict=True):
        stacked = _in_order(of_pose, records)
        columns.append(stacked[:, np.any(stacked != 0.0, axis=0)])
    return columns


def _in_order(of_rows: HostArray, effectors: Sequence[EffectorRecord]) -> HostArray:
    """Stack the rows of effectors in their order."""
    rows = [of_rows[e.index, : len(e.std)] for e in effectors]
    return np.concatenate([np.zeros((0, of_rows.shape[-1])), *rows])


def displaced(
    configurations: Sequence[Configuration],
    lanes: ConfigurationLanes,
    delta_e: Float[AnyArray, "n n_rows 3"],
) -> ConfigurationLanes:
    """Move measured values by the offsets of effectors whose displacement counts.

    Then errors are those of displacements. `delta_e` is of the first configurations.
    """
    weight, errors = np.asarray(lanes.arrays.effectors.inverse_std), np.asarray(delta_e)
    attached = attachments(configurations, lanes.effectors, weight.shape[1])
    weight = np.where(np.isfinite(errors), weight[: len(errors)], 0.0)
    shifts = attached.shifts(weight, np.nan_to_num(errors))
    records = tuple(
        tuple(replace(e, measured=e.measured + e.among(shift)) for e in of_lane)
        for shift, of_lane in zip(shifts, lanes.effectors, strict=True)
    )
    return lanes._replace(effectors=records)


def simulation_result(
    model: Model,
    configurations: Sequence[Configuration],
    solution: EquilibriumSolution,
    lanes: ConfigurationLanes | None = None,
) -> SimulationResult:
    """Describe a forward simulation, and compare what was measured.

    A result without equilibrium says why. The `lanes` may have calibrated parameters.
    """
    lanes = lanes or configuration_lanes(model.mesh, configurations, model.mechanism)
    arrays = lanes.arrays
    values = np.full(np.shape(arrays.effectors.measured), np.nan)
    # Positions are cheap enough to compute without compiling.
    compute = compiled_effectors if arrays.effectors.observed else effector_values
    each = following_each_other([*arrays], np.asarray(solution.displacement))
    for i in np.flatnonzero(np.asarray(solution.converged)).tolist():
        states = lane_of((solution.displacement, solution.multipliers), i)
        values[i] = np.asarray(compute(model, each[i], *states))
    errors = values - np.asarray(arrays.effectors.measured)
    lanes = displaced(configurations, lanes, errors)
    measured = [any(e.seen.any() for e in of_lane) for of_lane in lanes.effectors]
    roles: list[Role] = ["prediction" if some else "simulation" for some in measured]
    before = np.full(values.shape, np.nan)
    results = _results(
        model, configurations, lanes, solution, roles=roles, before=before, after=values
    )
    return SimulationResult(model, results)


def _results(
    model, configurations, lanes, solution, *, roles: Sequence[Role], before, after
) -> tuple[ConfigurationResult, ...]:
    """Make the results of all configurations, with the effectors filled in."""
    states = robot_states(model, configurations, solution, lanes.arrays)
    solution = jax.device_get(solution)
    fill_in = lambda e, i: replace(
        e, simulated_before=e.among(before[i]), simulated=e.among(after[i])
    )
    return tuple(
        ConfigurationResult(
            name=configuration.name,
            role=roles[i],
            converged=bool(solution.converged[i]),
            outcome=_outcome(solution, i),
            effectors=tuple(fill_in(e, i) for e in lanes.effectors[i]),
            displacement=np.asarray(solution.displacement[i])[: model.mesh.n_nodes],
            newton_steps=int(solution.steps[i]),
            load_steps=int(solution.load_steps[i]),
            residual=float(solution.residual[i]),
            rounding=float(solution.rounding[i]),
            at_rounding=bool(solution.at_rounding[i]),
            min_det_F=float(solution.min_det_F[i]),
            robot=states[i],
            posed=configuration,
            self_contact=_self_contact(model, lanes, solution, states[i], i),
            omissions=_omissions(model, configuration, lanes, solution, i),
        )
        for i, configuration in enumerate(configurations)
    )


def _omissions(model, configuration, lanes, solution, i: int) -> tuple[Omission, ...]:
    """List what a configuration leaves out, without an equilibrium as far as seen."""
    lane = jax.device_get(lane_of(lanes.arrays, i))
    u = np.asarray(solution.displacement[i]) if solution.converged[i] else None
    return tuple(omissions(model, configuration, lane, u, lanes.effectors[i]))


def _self_contact(model, lanes, solution, state, i: int) -> SelfContact | None:
    """Find where the body of a configuration with an equilibrium touches itself."""
    if not solution.converged[i]:
        return None
    n, bodies = model.mesh.n_nodes, model.mechanism.bodies
    carrier = np.full(n, -1)
    carrier[bodies.attached] = bodies.owner[bodies.body]
    held = [
        k for k, of in enumerate(state.bodies if state else ()) if of.state == "held"
    ]
    placed = np.asarray(lanes.arrays.fixed)[i, :n].all(axis=1) | np.isin(carrier, held)
    u = np.asarray(solution.displacement[i])[:n]
    contacts, within = model.mechanism.contacts, np.zeros(n)
    if contacts.touching is not None:
        # Nodes lie deeper than the quadrature points between them, which are pressed.
        least = max(float(contacts.scale), _BETWEEN * face_size(model.mesh))
        within[contacts.touching.faces] = least
    of_nodes = {"carrier": carrier, "placed": placed, "within": within}
    return self_contact(model.mesh, u, **of_nodes)


def _outcome(solution: EquilibriumSolution, i: int) -> str:
    """Say how the solve of a configuration ended."""
    words = outcome_words(lane_of(solution, i))
    if not solution.at_rounding[i]:
        return words
    # Without any load, rounding is all that there is.
    loaded = solution.rounding[i] < 1.0
    residual = f" (residual {solution.residual[i]:.1e})" if loaded else ""
    return f"{words} at rounding{residual}"
