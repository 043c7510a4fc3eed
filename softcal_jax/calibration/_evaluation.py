"""Equilibria, errors and compliances of a calibration at some parameters."""

from collections.abc import Callable, Hashable, Mapping, Sequence
from copy import copy
from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._files import digest_of
from softcal_jax._lanes import lane_of, stacked, unstacked
from softcal_jax._module import Module
from softcal_jax._typing import Array, Bool, Float, HostArray, numpy_of
from softcal_jax.calibration._problem import linear_model
from softcal_jax.configurations import (
    ConfigurationArrays,
    earlier_lanes,
    following_each_other,
    in_order,
)
from softcal_jax.equilibrium import (
    EquilibriumSolution,
    Known,
    Model,
    Program,
    Report,
    Workers,
    effectors_on_all_cores,
    equilibria,
)
from softcal_jax.fields import ParameterSpace
from softcal_jax.inference import ErrorColumns, LinearModel, Whitened
from softcal_jax.sensitivity import (
    EnergyCompliance,
    Response,
    energy_compliance,
    equilibrium_response,
)
from softcal_jax.unknowns import CorrelatedNoise, Problem

MOST_WITHOUT = 50
"""Newton iterations after which a state without actuation is given up."""

_FROM_REST, MOST_KEPT = dict[Hashable, Response](), 4
"""Responses at the last starts, kept for fits to other data, and how many are kept."""


class Evaluation(Module):
    """Equilibria, errors and compliances of all configurations at one z.

    Attributes:
        z: Scaled parameters [-].
        response: Equilibria, effectors and W_ep, one lane per configuration.
        delta_e: Simulated minus measured values; 0 where nothing is measured.
        rows: Errors and their derivatives in units of the noise, followed by those of
            the priors: what the QP of Eq. (10) minimises.
        ok: Whether every lane has an equilibrium and a regular tangent, and the cost is
            finite.
        excess: How far readings exceed their limits, if there are any, see `Problem`.
    """

    z: Float[Array, " n_p"]
    response: Response
    delta_e: Float[Array, "n_c n_rows 3"]
    rows: Whitened
    ok: Bool[Array, ""]
    excess: Whitened | None = None

    @property
    def equilibrium(self) -> EquilibriumSolution:
        """Equilibria, one lane per configuration."""
        return self.response.equilibrium

    @property
    def effectors(self) -> Float[Array, "n_c n_rows 3"]:
        """Simulated effector coordinates: positions [m], turns [rad], ..."""
        return self.response.effectors

    @property
    def cost(self) -> Float[Array, ""]:
        """Half the sum of squared errors in noise units; infinite if not ok [-].

        Distances from the prior count like errors.
        """
        return _cost(self.ok, self.rows.error)

    def linear(
        self,
        problem: Problem,
        z: Float[Array, " n_p"],
        considered: ErrorColumns | None = None,
    ) -> LinearModel:
        """Make the linear model at z, see the function of this name."""
        return linear_model(
            problem,
            z,
            W_ep=self.response.W_ep,
            ok=self.response.ok,
            delta_e=self.delta_e,
            rows=self.rows,
            considered=considered,
        )


@jax.jit
def _cost(ok, error) -> Float[Array, ""]:
    return jnp.where(ok, 0.5 * jnp.sum(error**2), jnp.inf)


def effector_errors(
    problem: Problem, e: Float[Array, "n_c n_rows 3"]
) -> Float[Array, "n_c n_rows 3"]:
    """Return Delta_e, simulated minus measured values; 0 where nothing is measured."""
    effectors = problem.configurations.effectors
    xp = numpy_of(effectors, e)
    weight, measured, e = map(
        xp.asarray, (effectors.inverse_std, effectors.measured, e)
    )
    return jax.device_put(xp.where(weight > 0.0, e - measured, 0.0))


@eqx.filter_jit
def weighed(
    problem: Problem, z: Float[Array, " n_p"], response: Response
) -> Evaluation:
    """Weigh the errors and compliances of all lanes, and add those of the priors."""
    delta_e = effector_errors(problem, response.effectors)
    compliance = response.W_ep.reshape(-1, z.shape[0])
    rows = problem.rows(z, delta_e, compliance)
    excess = problem.excess(response.effectors, compliance)
    ok = jnp.all(response.equilibrium.converged) & jnp.all(response.ok)
    # A tiny `std` makes the squares overflow, and an infinite cost never falls.
    finite = jnp.isfinite(_cost(ok, rows.error)) & jnp.all(jnp.isfinite(rows.W))
    return Evaluation(z, response, delta_e, rows, finite, excess)


@eqx.filter_jit
def _posed(problem: Problem, z) -> tuple[Model, ConfigurationArrays]:
    return problem.at(z)


def _end(response: Response) -> tuple[Array, Array | None]:
    return response.equilibrium.displacement, response.displacement


def _known(
    configurations: ConfigurationArrays, solution: EquilibriumSolution
) -> list[Known]:
    """Return the equilibria that were found, with their configurations."""
    u = np.asarray(solution.displacement)
    each = following_each_other([*configurations], u)
    return [
        Known(each[c], jax.device_put(u[c]))
        for c in np.flatnonzero(np.asarray(solution.converged)).tolist()
    ]


class Evaluator:
    """Evaluates a calibration, its configurations as lanes of one program.

    The program does not depend on the number of configurations, on the data, or on how
    the parameters are stepped, so it is compiled once for all of these.

    Attributes:
        problem: The calibration.
        workers: Run the lanes.
        numbered: The calibration without names, for compiled programs.
        shared: What all lanes share, without configurations.
        lanes: The configurations.
    """

    def __init__(self, problem: Problem, workers: Workers):
        """Split the calibration into what all lanes share, and the lanes."""
        self.problem, self.workers = problem, workers
        self.numbered = problem.numbered
        # The number of lanes and what concerns steps alone would each give another
        # program, so both are left out.
        options = {"order": (), "tensor_steps": True, "pin": None}
        options |= {"regions": (), "likeness": None}
        space = replace(self.numbered.space, **options)
        where = lambda p: (p.lanes.arrays, p.space)
        alone = self.numbered.with_noise(None)
        self.shared = eqx.tree_at(where, alone, (None, space))
        self.lanes = list(problem.configurations)
        self._earlier = earlier_lanes(self.lanes)
        of_all = self.shared.model, space, self.shared.newton
        self._program = Program(equilibrium_response, *of_all)

    def with_space(self, space: ParameterSpace) -> "Evaluator":
        """Return an evaluator of the same lanes with another order, chart or pin."""
        other = copy(self)
        other.numbered = replace(self.numbered, space=space)
        return other

    def with_noise(self, noise: CorrelatedNoise | None) -> "Evaluator":
        """Return an evaluator of the same lanes with another noise."""
        other = copy(self)
        other.problem = self.problem.with_noise(noise)
        other.numbered = self.numbered.with_noise(noise)
        return other

    def __call__(
        self,
        z: Float[Array, " n_p"],
        guess: Float[Array, "n_c n_points 3"],
        before: Float[Array, "n_c n_points 3"] | None = None,
        precise: bool | Bool[Array, ""] = False,
    ) -> Evaluation:
        """Compute equilibria, errors and compliances W_ep of all lanes (Eqs. 9, 10).

        Lanes that are not near their guess are solved from there by `equilibria`.

        Args:
            z: Scaled parameters [-].
            guess: Displacements to start from [m].
            before: Equilibria that the guess extrapolates to first order, if any [m].
            precise: Whether the compliances are exact, see `equilibrium_response`.
        """
        every, far = range(len(self.lanes)), list(range(len(self.lanes)))
        responses: dict[int, Response] = {}
        if self.problem.model.solver.counts_negative:
            responses = dict(enumerate(self._near(every, z, guess, before, precise)))
            far = [c for c in every if not responses[c].equilibrium.converged]
        if far:
            far = self.with_earlier(far)
            start = lane_of(guess, np.asarray(far))
            solution = self.equilibria(z, lanes=far, guess=start)
            responses |= zip(far, self.closed(far, z, solution, precise), strict=True)
        return self.weighed(z, stacked([responses[c] for c in every]))

    def weighed(self, z: Float[Array, " n_p"], response: Response) -> Evaluation:
        """Weigh what all lanes respond at scaled parameters [-]."""
        return weighed(self.numbered, z, response)

    def _near(
        self,
        lanes: Sequence[int],
        z: Float[Array, " n_p"],
        guess: Float[Array, "n_lanes n_points 3"],
        before: Float[Array, "n_lanes n_points 3"] | None,
        precise: bool | Bool[Array, ""],
        known: Mapping[int, Response] | None = None,
    ) -> list[Response]:
        both = guess, guess if before is None else before
        states = dict(zip(lanes, zip(*map(unstacked, both), strict=True), strict=True))
        exact, responses = jax.device_put(precise), dict(known or {})
        ends = {c: _end(response) for c, response in responses.items()}
        off = self.problem.deviations  # of the specimen of each lane

        def arguments(c: int) -> tuple:
            lane, slopes = self._following(c, ends)
            at = z if off is None else z + off[c]
            return (at, lane, *states[c], exact, slopes)

        for group in in_order(self._earlier):
            now = [c for c in group if c in states]
            of_now = self.workers.map(self._program, map(arguments, now))
            responses |= zip(now, of_now, strict=True)
            ends |= {c: _end(responses[c]) for c in now}
        return [responses[c] for c in lanes]

    def with_earlier(self, lanes: Sequence[int]) -> list[int]:
        """Add the lanes that these follow."""
        wanted = {*lanes}
        for c in lanes:
            while (p := self._earlier[c]) is not None:
                wanted.add(c := p)
        return sorted(wanted)

    def _following(
        self, c: int, ends: Mapping[int, tuple[Array, Array | None]]
    ) -> tuple[ConfigurationArrays, Float[Array, "n_p n_stages n_points 3"] | None]:
        """Return a lane after the one it follows, and how its stages change with z.

        `ends` are the displacements of lanes before it, and their changes [m].
        """
        lane, p = self.lanes[c], self._earlier[c]
        if p is None:
            return lane, self._no_slopes()
        (before, slopes), (u, moved) = self._following(p, ends), ends[p]
        lane = lane.following(before, np.asarray(u))
        if slopes is None:  # nothing remembers
            return lane, None
        new = np.asarray(slopes), np.asarray(moved)[:, None]
        return jax.device_put((lane, np.concatenate(new, axis=1)[:, 1:]))

    def _no_slopes(self) -> Float[Array, "n_p n_stages n_points 3"] | None:
        stages = self.lanes[0].stages
        if len(stages) == 0:
            return None
        n_p = len(self.problem.space.names)
        return jax.device_put(np.zeros((n_p, *stages.shape)))

    def closed(
        self,
        lanes: Sequence[int],
        z: Float[Array, " n_p"],
        solution: EquilibriumSolution,
        precise: bool | Bool[Array, ""] = False,
        known: Mapping[int, Response] | None = None,
    ) -> list[Response]:
        """Add the compliances to equilibria that were solved.

        `known` are the responses of other lanes, which these may follow.

        They need a factor of the tangent; one more step with it takes the error from
        `rtol` to rounding, so that a fit compares costs of equally exact equilibria.
        """
        responses = []
        steps = self._near(lanes, z, solution.displacement, None, precise, known)
        for k, step in enumerate(steps):
            solved = lane_of(solution, k)
            counts = {name: getattr(solved, name) for name in ("steps", "load_steps")}
            closed = replace(step.equilibrium, **counts)
            closed = closed if closed.converged else solved
            responses.append(step._replace(equilibrium=closed))
        return responses

    def posed(self, z: Float[Array, " n_p"]) -> tuple[Model, ConfigurationArrays]:
        """Return model and configurations with scaled parameters set [-]."""
        return _posed(self.numbered.with_noise(None), z)

    def equilibria(
        self,
        z: Float[Array, " n_p"],
        report: Report | None = None,
        *,
        lanes: Sequence[int] | None = None,
        known: EquilibriumSolution | None = None,
        most: int | None = None,
        **more: Any,
    ) -> EquilibriumSolution:
        """Solve equilibria, by default from rest: see the function of this name.

        `known` are equilibria of the first lanes, at these parameters; `most` is the
        number of iterations after which one is given up, by default as set.
        """
        if self.problem.deviations is not None:
            return self._of_specimens(z, report, lanes, **more)
        (model, configurations), newton = self.posed(z), self.problem.newton
        if most is not None:
            newton = replace(newton, max_steps=min(most, int(newton.max_steps)))
        if known is not None:
            more["known"] = _known(configurations[: len(known.steps)], known)
        if lanes is not None:
            configurations = lane_of(configurations, np.asarray(lanes))
        run = self.workers, model, configurations, newton
        return equilibria(*run, report=report, **more)

    def _of_specimens(
        self,
        z: Float[Array, " n_p"],
        report: Report | None,
        lanes: Sequence[int] | None,
        guess: Float[Array, "n_lanes n_points 3"] | None = None,
    ) -> EquilibriumSolution:
        """Solve the equilibria of each specimen, the least deviating one first.

        Without a guess the others start from its equilibria.
        """
        every = range(len(self.lanes)) if lanes is None else lanes
        off = np.asarray(self.problem.deviations)
        one, solved = copy(self), dict[int, EquilibriumSolution]()
        one.problem = replace(self.problem, deviations=None)
        rows = np.unique(off[[*every]], axis=0)
        first = None
        for row in rows[np.argsort(np.linalg.norm(rows, axis=1))]:
            of_row = [k for k, c in enumerate(every) if np.array_equal(off[c], row)]
            more: Any = {"lanes": [every[k] for k in of_row]}
            if guess is not None:
                more["guess"] = lane_of(guess, np.array(of_row))
            elif first is not None and len(first.displacement) == len(of_row):
                more["guess"] = first.displacement
            solution = one.equilibria(z + row, report, **more)
            first = first or solution
            solved |= {k: lane_of(solution, i) for i, k in enumerate(of_row)}
        return stacked([solved[k] for k in range(len(every))])

    def without_forces(
        self, z: Float[Array, " n_p"], solution: EquilibriumSolution
    ) -> list[tuple[list[int], Float[HostArray, "n_points 3"]]]:
        """Solve lanes in which actuators exert forces as if they did not.

        Lanes that differ in these forces and in what was measured alone are one: their
        indices stand beside the displacement [m]. Those without an equilibrium, with or
        without forces, are left out.
        """
        model, configurations = self.posed(z)
        u = np.asarray(solution.displacement)
        configurations = stacked(following_each_other([*configurations], u))
        acts = np.any(np.asarray(configurations.actuation.forces) != 0.0, axis=1)
        others = lambda c: (c.key, c.effectors.measured, c.effectors.inverse_std)
        alike: dict[str, list[int]] = {}
        for c in np.flatnonzero(acts & np.asarray(solution.converged)).tolist():
            lane = eqx.tree_at(others, configurations[c].without_forces(), (None,) * 3)
            alike.setdefault(digest_of(jax.tree.leaves(lane)), []).append(c)
        bare = [configurations[c].without_forces() for c, *_ in alike.values()]
        if not bare:
            return []
        newton = replace(self.problem.newton, max_steps=MOST_WITHOUT)
        known = _known(configurations, solution)
        solved = equilibria(self.workers, model, bare, newton, known=known)
        states = map(np.asarray, (solved.displacement, solved.converged))
        each = zip(alike.values(), *states, strict=True)
        return [(poses, u) for poses, u, converged in each if converged]

    def effectors(
        self, z: Float[Array, " n_p"], solution: EquilibriumSolution
    ) -> Float[Array, "n_c n_rows 3"]:
        """Compute effector coordinates at these equilibria."""
        return effectors_on_all_cores(self.workers, *self.posed(z), solution)

    def from_rest(
        self,
        z: Float[Array, " n_p"],
        report: Report | None = None,
        solved: Callable[[], None] = lambda: None,
    ) -> Evaluation:
        """Evaluate without a guess from another evaluation, see `equilibria`.

        `solved` is called between the equilibria and their compliances.
        Responses at the last starts are kept for fits that differ in their data alone.
        """
        start = self._without_data(z)
        response = _FROM_REST.pop(start, None)
        if response is None:
            every = range(len(self.lanes))
            rest = jax.device_put(np.zeros((self.problem.model.n_points, 3)))
            no = jax.device_put(np.array(False))
            lane = z, self.lanes[0], rest, rest, no, self._no_slopes()
            self.workers.ahead(lambda: (self._program, [lane]))
            solution = self.equilibria(z, report)
            solved()
            response = stacked(self.closed(every, z, solution))
        _FROM_REST[start] = response
        for oldest in list(_FROM_REST)[:-MOST_KEPT]:
            _FROM_REST.pop(oldest, None)
        return self.weighed(z, response)

    def _without_data(self, z: Float[Array, " n_p"]) -> Hashable:
        """Identify all that a response depends on; arrays count by their digest."""
        solver, lanes = self.shared.model.solver, self.problem.configurations
        if not lanes.effectors.observed:  # functions of users may read the data
            data = lambda c: (c.effectors.measured, c.effectors.inverse_std)
            lanes = eqx.tree_at(data, lanes, (None, None))
        kind = solver.name, solver.sparsity  # without its handle
        shared = eqx.tree_at(lambda p: p.model.solver, self.shared, kind)
        arrays, others = eqx.partition((shared, lanes, z), eqx.is_array_like)
        leaves, tree = jax.tree.flatten(others)
        return digest_of(jax.tree.leaves(arrays)), tuple(leaves), tree

    def energy_compliances(
        self, z: Float[Array, " n_p"], u: Float[Array, "n_c n_points 3"]
    ) -> EnergyCompliance:
        """Compute W_ep and W_pp of all lanes at displacements `u` [m]."""
        program, space = (
            Program(energy_compliance, self.shared.model),
            self.shared.space,
        )
        ends, done = {}, dict[int, EnergyCompliance]()
        for group in in_order(self._earlier):
            lanes = []
            for c in group:
                lane, slopes = self._following(c, ends)
                lanes.append((lane, u[c], space, z, slopes))
            done |= zip(group, self.workers.map(program, lanes), strict=True)
            ends |= {c: (u[c], done[c].displacement) for c in group}
        return stacked([done[c] for c in range(len(self.lanes))])


def evaluate(
    problem: Problem,
    z: Float[Array, " n_p"],
    guess: Float[Array, "n_c n_points 3"] | None = None,
) -> Evaluation:
    """Compute equilibria, stacked errors and W_ep (paper Eqs. 9, 10), on all cores.

    Args:
        problem: The calibration.
        z: Scaled parameters [-].
        guess: Displacements to start from; by default as at the start of a fit [m].
    """
    with Workers(problem.model, problem.configurations.gravity.shape[0]) as workers:
        evaluator = Evaluator(problem, workers)
        return evaluator.from_rest(z) if guess is None else evaluator(z, guess)


ROUNDING = 1e-12
"""Change of a coordinate by a unit of lambda_p, over its size, that is rounding [-]."""


def check_sensitive(problem: Problem, first: Evaluation) -> None:
    """Raise ValueError unless a measured coordinate depends on some parameter.

    A parameter without effect is no error if others have one: the angle of an axis has
    none where the moduli are equal. `first` is the evaluation at the start.
    """
    weight = np.asarray(problem.configurations.effectors.inverse_std)
    effectors = np.abs(np.asarray(first.effectors))
    size = np.max(weight * effectors, initial=0.0)
    W = np.asarray(first.rows.W)[: weight.size]
    if not np.all(np.isfinite(W)) or np.max(np.abs(W)) > ROUNDING * size:
        return
    names = ", ".join(map(repr, problem.space.names))
    raise ValueError(
        f"nothing to learn of {names}: no measured coordinate moves with it at the "
        "start equilibrium. Check that a load, gravity or an actuator deforms the body "
        "where it is measured, and not only parts that are held, or start from another "
        "value."
    )


def check_cost(problem: Problem, first: Evaluation) -> None:
    """Raise ValueError if a standard deviation is so small that the cost overflows."""
    error = np.asarray(first.rows.error)
    with np.errstate(over="ignore", invalid="ignore"):
        if np.isfinite(error @ error):
            return
    weight = np.asarray(problem.configurations.effectors.inverse_std)
    c = int(np.argmax(np.max(weight, axis=(1, 2))))
    raise ValueError(
        "the cost at the start is not finite, since an error is too large beside its "
        f"standard deviation: the smallest is {1.0 / np.max(weight):.3g} in SI units, "
        f"in configuration {problem.names[c]!r}. Check the `std` of effectors and "
        "priors, and their units."
    )
