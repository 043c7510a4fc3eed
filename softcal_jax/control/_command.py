"""A command as a problem: inputs are its parameters, what follows them has limits."""

from collections.abc import Sequence
from copy import copy
from dataclasses import replace

import equinox as eqx
import jax
import numpy as np

from softcal_jax._lanes import lane_of
from softcal_jax._module import Module
from softcal_jax._typing import Array, Bool, Float, HostArray
from softcal_jax.calibration import (
    OUTSIDE,
    CalibrationSettings,
    Evaluation,
    Evaluator,
)
from softcal_jax.configurations import (
    AbstractEffector,
    ActuatorDisplacement,
    ActuatorForce,
    Configuration,
    ConfigurationArrays,
    configuration_lanes,
)
from softcal_jax.control._goals import Input
from softcal_jax.control._inputs import force_compliance, is_resisted, with_inputs
from softcal_jax.equilibrium import EquilibriumSolution, Model, NewtonSettings, Workers
from softcal_jax.fields import Parameter, ParameterSpace, SetupParameter
from softcal_jax.inference import Whitened
from softcal_jax.sensitivity import Response
from softcal_jax.unknowns import Problem, ReadingLimits

FAR = 1e6
"""Where an input without a limit ends, in motions of a node by the size of the robot.

A parameter needs two ends, and there is no equilibrium near these.
"""

JUST_TAUT = 1e-7
"""How far a slack cable is wound up beyond its length, in such motions: it acts."""


class ControlSettings(Module):
    """Settings of inverse control.

    Attributes:
        tol: Error of every effector coordinate at which a goal is met, in units of its
            standard deviation [-].
        step_tol: Step of the inputs at which the search ends, as the displacement of a
            node that it causes at the start, relative to the size of the robot [-].
        max_steps: Number of steps after which the search gives up.
        step_bound: First bound on the step of every input, measured as `step_tol` [-].
        max_step_bound: Largest value of that bound [-].
        epsilon: Weight of the energy of the actuators, Eq. (6), relative to the effect
            of the inputs on the effectors [-]. It determines inputs that the goals
            leave open, such as co-contraction, at the price of missing the goals by
            about as much. With 0 the search ends as soon as the goals are met.
        other_starts: Number of other starts to try, and after them a continuation of
            the goals, before the search says that a goal cannot be met. With 0 the
            first local optimum counts.
        newton: Settings of the equilibria.
    """

    tol: float = 1e-2
    step_tol: float = 1e-6
    max_steps: int = 50
    step_bound: float = 0.1
    max_step_bound: float = 0.5
    epsilon: float = 0.0
    other_starts: int = 24
    newton: NewtonSettings = eqx.field(default_factory=NewtonSettings)

    def __check_init__(self):
        for name in ("tol", "step_tol", "step_bound", "max_step_bound"):
            value, most = getattr(self, name), 1.0 if name == "step_tol" else np.inf
            if not value > 0.0:
                raise ValueError(f"{name} must be positive, got {value}.")
            if not value < most:
                raise ValueError(f"{name} must be below {most:g}, got {value}.")
        if self.max_steps < 1:
            raise ValueError(f"max_steps must be at least 1, got {self.max_steps}.")
        for name in ("other_starts", "epsilon"):
            if not getattr(self, name) >= 0.0:
                value = getattr(self, name)
                raise ValueError(f"{name} must not be negative, got {value}.")

    @property
    def loop(self) -> CalibrationSettings:
        """Settings of the loop of a fit, with these tolerances."""
        return CalibrationSettings(
            tol=self.step_tol,
            max_steps=self.max_steps,
            step_bound=self.step_bound,
            max_step_bound=self.max_step_bound,
            least_cost=0.5 * self.tol**2,
        )


class Command(Evaluator):
    """A robot that is commanded: `z` are its inputs, scaled by the motion they cause.

    A unit of z moves some node by the size of the robot at the start, which makes
    inputs of different units comparable. Goals are the measured values of its one pose.
    Where it is evaluated, slack cables are wound up until they are just taut: that
    changes no equilibrium, but a slack cable has no effect and so no derivative.

    Attributes:
        configuration: As the user gave it; its actuation is where the command starts.
        settings: Settings of the search.
        records: Records of its effectors.
        inputs: The actuators that are commanded.
        free: Indices of those that have room, whose values are z.
        scale: Inputs per unit of z, each in its unit.
        box: Lowest and highest scaled inputs, limits on steps included.
        energy: Matrix from their forces to the rows of their energy; 0 without.
    """

    def __init__(
        self,
        model: Model,
        configuration: Configuration,
        inputs: Sequence[Input],
        settings: ControlSettings,
        workers: Workers,
    ):
        """Pose the command.

        Raises:
            ValueError: If the limits leave no actuator any room.
        """
        self.configuration, self.settings = configuration, settings
        self.inputs = [*inputs]
        self.free = [k for k, i in enumerate(inputs) if i.box[0] < i.box[1]]
        if not self.free:
            raise ValueError(
                f"the limits of configuration {configuration.name!r} leave no actuator "
                "any room: widen them, or simulate the configuration."
            )
        follow, lengths = zip(*(_readings(model, i) for i in inputs), strict=True)
        own = {reading.name: reading for reading in (*follow, *lengths) if reading}
        whole = (*configuration.effectors, *own.values())
        read = [replace(configuration, effectors=whole)]
        lanes = configuration_lanes(model.mesh, read, model.mechanism)
        rows = {record.name: record.index for record in lanes.effectors[0]}
        self.records = [r for r in lanes.effectors[0] if r.name not in own]
        self._follow = [rows[reading.name] for reading in follow]
        self._lengths = [None if r is None else rows[r.name] for r in lengths]
        n = len(self.free)
        self.energy, self.scale = np.zeros((n, n)), np.ones(n)
        ends = np.array([i.following for i in inputs]).T
        limits = ReadingLimits([3 * row for row in self._follow], *ends)
        about = {"newton": settings.newton, "limits": limits}
        posed = Problem(model, self._space(model), lanes, [configuration], **about)
        self._pose(posed, workers)

    def _pose(self, problem: Problem, workers: Workers) -> None:
        super().__init__(problem, workers)
        ends = problem.space.lower(), problem.space.upper()
        self.box = np.stack([*map(np.asarray, ends)])

    def _space(self, model: Model) -> ParameterSpace:
        """Make inputs parameters, with the value of a unit step of each."""
        entries = []
        for i, S in zip(self._free(), self.scale.tolist(), strict=True):
            name, (low, high) = model.mechanism.actuators.names[i.a], i.box
            far = FAR * max(S, abs(i.start))
            ends = max(low, i.start - far), min(high, i.start + far)
            value = Parameter(name, "", i.start, *ends, scale="linear", S=S)
            entries.append(SetupParameter("command", name, [value]))
        return ParameterSpace(entries)

    def _free(self) -> list[Input]:
        return [self.inputs[k] for k in self.free]

    def by_motion(self, here: Evaluation) -> tuple["Command", Evaluation]:
        """Scale the inputs by the motion that they cause at an equilibrium."""
        model, response, other = self.problem.model, here.response, copy(self)
        size = np.ptp(model.mechanism.points, axis=0).max()
        assert response.displacement is not None
        motion, W = map(np.asarray, (response.displacement, response.W_ep))
        moved = np.abs(motion[0]).max(axis=(1, 2)) / self.scale
        other.scale = size / np.where(moved > 0.0, moved, size)
        other._pose(replace(self.problem, space=other._space(model)), self.workers)
        ratio = other.scale / self.scale
        by_input = W * ratio, motion * ratio[:, None, None]
        z, W, motion = jax.device_put((np.asarray(here.z) / ratio, *by_input))
        return other, other.weighed(z, response._replace(W_ep=W, displacement=motion))

    def towards(self, goal: Float[HostArray, "n_rows 3"]) -> "Command":
        """Return the same command with other goals, and without the energy."""
        other, goals = copy(self), lambda p: p.lanes.arrays.effectors.measured
        other._pose(eqx.tree_at(goals, self.problem, goal[None]), self.workers)
        other.settings = eqx.tree_at(lambda s: s.epsilon, self.settings, 0.0)
        other.energy = np.zeros_like(self.energy)
        return other

    @property
    def start(self) -> Float[HostArray, " n_p"]:
        """Scaled inputs at which the command starts."""
        return np.asarray(self.problem.space.start())

    def lane(self, here: Evaluation) -> ConfigurationArrays:
        """Return the configuration with the inputs of an evaluation."""
        lane, inputs = self.problem.configurations[0], self._free()
        value, box = np.array(lane.actuation.value), np.array([i.box for i in inputs])
        found = self.scale * np.asarray(here.z)
        value[[i.a for i in inputs]] = np.clip(found, *box.T)  # scaling back rounds
        return with_inputs(lane, jax.device_put(value))

    def solution(self, here: Evaluation) -> EquilibriumSolution:
        """Return the equilibrium of an evaluation."""
        return lane_of(here.equilibrium, 0)

    def residuals(self, here: Evaluation) -> Float[HostArray, " n_e"]:
        """Return effector errors in units of std, 0 without a goal [-]."""
        goals = self.problem.configurations.effectors
        weight, goal = map(np.asarray, (goals.inverse_std, goals.measured))
        off = np.where(weight > 0.0, np.asarray(here.effectors) - goal, 0.0)
        return np.ravel(weight * off)

    def off(self, here: Evaluation) -> float:
        """Return the largest of them [-]."""
        return float(np.abs(self.residuals(here)).max())

    def reached(
        self, here: Evaluation
    ) -> list[tuple[tuple[int, int], Float[HostArray, " n_p"]]]:
        """List the limits that are reached: of which input, which, and their gradients.

        They are 0 and 1 for the lower and the upper limit of the input, 2 and 3 for
        those of what follows it. A gradient is by z, of unit length.
        """
        assert here.excess is not None
        (low, high), z, n = self.box, np.asarray(here.z), len(self.inputs)
        unit, ends = np.zeros((n, len(z))), np.full((2, n), np.inf)
        unit[self.free] = np.eye(len(z))
        ends[:, self.free] = z - low, high - z
        excess, slopes = map(np.asarray, here.excess)
        length = np.linalg.norm(slopes, axis=1)
        length = np.where(length > 0.0, length, 1.0)
        room = np.concatenate([ends, np.reshape(-excess / length, (2, n))])
        gradients = np.concatenate([-unit, unit, slopes / length[:, None]])
        near = np.argwhere(room.T <= 10.0 * OUTSIDE).tolist()
        return [((k, kind), gradients[kind * n + k]) for k, kind in near]

    def moved(self, base: Evaluation, change: Float[HostArray, " n_p"]) -> Evaluation:
        """Evaluate after a change of scaled inputs, from its prediction."""
        u, by_input = base.equilibrium.displacement, base.response.displacement
        assert by_input is not None
        motion = np.tensordot(change, np.asarray(by_input), axes=(0, 1))
        z = jax.device_put(np.asarray(base.z) + change)
        return self(z, jax.device_put(np.asarray(u) + motion), u)

    def __call__(
        self,
        z: Float[Array, " n_p"],
        guess: Float[Array, "n_c n_points 3"],
        before: Float[Array, "n_c n_points 3"] | None = None,
        precise: bool | Bool[Array, ""] = False,
    ) -> Evaluation:
        """Evaluate at inputs within their limits, and wind up what is slack there."""
        z = jax.device_put(np.clip(z, *self.box))
        here = super().__call__(z, guess, before, precise)
        taut = self._wound(here)
        if taut is None:
            return here
        return super().__call__(taut, here.equilibrium.displacement, None, precise)

    def _wound(self, here: Evaluation) -> Float[Array, " n_p"] | None:
        """Return inputs with slack cables just taut; None if none is slack."""
        if not bool(here.equilibrium.converged[0]):
            return None
        z, before, (_, upper) = np.array(here.z), here.z, self.box
        read = np.asarray(here.effectors)[0, :, 0]
        for n, k in enumerate(self.free):
            row = self._lengths[k]
            if row is not None:
                length, force = read[row] / self.scale[n], read[self._follow[k]]
                if force <= 0.0 and length >= z[n]:
                    z[n] = min(length + JUST_TAUT, upper[n])
        return None if np.array_equal(z, before) else jax.device_put(z)

    def weighed(self, z: Float[Array, " n_p"], response: Response) -> Evaluation:
        """Weigh the errors, and the energy of the actuators beside them, Eq. (6)."""
        here = super().weighed(z, response)
        forces, by_force, _ = self._actuators(here)
        (error, W), E = map(np.asarray, here.rows), self.energy
        both = np.append(error, E @ forces), np.concatenate([W, E @ by_force])
        return eqx.tree_at(lambda e: e.rows, here, Whitened(*jax.device_put(both)))

    def _actuators(
        self, here: Evaluation
    ) -> tuple[Float[HostArray, " k"], HostArray, HostArray]:
        """Return the forces, and changes of forces and displacements by z."""
        n, read = len(self.free), np.asarray(here.effectors)[0, :, 0]
        W = np.asarray(here.response.W_ep)[0]
        forces, (by_force, by_displacement) = np.zeros(n), np.zeros((2, n, n))
        has_displacement = self.problem.model.mechanism.actuators.has_displacement
        for m, (k, i) in enumerate(zip(self.free, self._free(), strict=True)):
            both, row = (by_force, by_displacement), self._follow[k]
            own, other = both[::-1] if i.by_displacement else both
            own[m, m], forces[m] = self.scale[m], self.scale[m] * float(here.z[m])
            if i.by_displacement:
                forces[m] = read[row]
            if i.by_displacement or has_displacement[i.a]:
                other[m] = W[3 * row]
        return forces, by_force, by_displacement

    def weighing_energy(self, here: Evaluation) -> tuple["Command", Evaluation]:
        """Count epsilon lambda_a^T W_aa lambda_a, with W_aa as it is here, Eq. (6).

        It is relative to the effect of the inputs on the effectors. Where motors hold a
        robot in a state that would be unstable without them, W_aa has negative
        eigenvalues; their magnitude is used.
        """
        epsilon = self.settings.epsilon
        if epsilon == 0.0:
            return self, here
        actuators = self.problem.model.mechanism.actuators
        _, by_force, by_displacement = self._actuators(here)
        assert here.response.displacement is not None
        motion = np.asarray(here.response.displacement)[0]
        acts = is_resisted(by_force, by_displacement, motion)
        symmetric = not any(actuators.has_friction)
        W_aa = force_compliance(by_force, by_displacement, acts, symmetric=symmetric)
        size = np.sqrt(np.abs(np.diag(W_aa)))
        size = np.where(size > 0.0, size, 1.0)
        # Scaled to a unit diagonal, so that units do not affect the eigenvalues.
        values, vectors = np.linalg.eigh(W_aa / np.outer(size, size))
        root = np.sqrt(np.abs(values))[:, None] * vectors.T * size
        energy = ((root @ by_force) ** 2).sum()
        W = np.asarray(here.rows.W)[: here.delta_e.size]
        ratio = (W**2).sum() / energy if energy > 0.0 else 0.0
        other = copy(self)
        other.energy = np.sqrt(epsilon * ratio) * root
        return other, other.weighed(here.z, here.response)


def _readings(
    model: Model, i: Input
) -> tuple[AbstractEffector, ActuatorDisplacement | None]:
    """Return readings of what follows an input, and of a cable that can be slack.

    Of a force without a displacement it is the force itself: each input has a reading.
    """
    actuators = model.mechanism.actuators
    kind, name = actuators.kinds[i.a], actuators.names[i.a]
    drives = ActuatorForce(f"what drives {name!r}", name, std=1.0)
    if not kind.displacement_unit:
        return drives, None
    covers = ActuatorDisplacement(f"what {name!r} covers", name, std=1.0)
    if not i.by_displacement:
        return covers, None
    return drives, covers if kind.unilateral else None
