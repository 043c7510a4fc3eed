"""Equilibria, errors and compliances of a calibration at some parameters."""

from collections.abc import Sequence
from copy import copy
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._lanes import lane_of, stacked
from softcal_jax._module import Module, one_line
from softcal_jax._results import RESULTS
from softcal_jax._typing import Array, Bool, Float, HostArray
from softcal_jax.calibration._noise import CorrelatedNoise
from softcal_jax.calibration._problem import (
    CalibrationProblem,
    linear_model,
    without_names,
)
from softcal_jax.configurations import Configuration, ConfigurationArrays
from softcal_jax.equilibrium import (
    EquilibriumSolution,
    LoadPath,
    Model,
    Program,
    Report,
    Workers,
    as_guess,
    effectors_on_all_cores,
    equilibria,
    solve_equilibrium,
)
from softcal_jax.fields import ParameterSpace, SetupParameter
from softcal_jax.inference import LinearModel, Whitened
from softcal_jax.sensitivity import (
    EnergyCompliance,
    Response,
    energy_compliance,
    equilibrium_response,
)


class Evaluation(Module):
    """Equilibria, errors and compliances of all configurations at one z.

    Attributes:
        response: Equilibria, effectors and W_ep, one lane per configuration.
        delta_e: Simulated minus measured values; 0 where nothing is measured.
        rows: Errors and their derivatives in units of the noise, and those of the
            priors behind: what the QP of Eq. (10) minimises.
        ok: Whether every lane has an equilibrium and a regular tangent, and the cost is
            finite.
    """

    response: Response
    delta_e: Float[Array, "n_c n_rows 3"]
    rows: Whitened
    ok: Bool[Array, ""]

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


@jax.jit
def _cost(ok, error) -> Float[Array, ""]:
    return jnp.where(ok, 0.5 * jnp.sum(error**2), jnp.inf)


def effector_errors(
    problem: CalibrationProblem, e: Float[Array, "n_c n_rows 3"]
) -> Float[Array, "n_c n_rows 3"]:
    """Return Delta_e, simulated minus measured values; 0 where nothing is measured."""
    effectors = problem.configurations.effectors
    return jnp.where(effectors.inverse_std > 0.0, e - effectors.measured, 0.0)


@eqx.filter_jit
def evaluate_lane(
    problem: CalibrationProblem,
    z: Float[Array, " n_p"],
    configuration: ConfigurationArrays,
    guess: Float[Array, "n_points 3"],
    before: Float[Array, "n_points 3"],
    precise: bool | Bool[Array, ""] = False,
) -> Response:
    """Compute equilibrium, effectors and compliances of one configuration.

    Unless `precise`, which takes one more Newton step, the compliances belong to the
    state before the last step.
    """
    return equilibrium_response(
        problem.model,
        configuration,
        guess,
        problem.space,
        z,
        newton=problem.newton,
        before=before,
        precise=precise,
    )


@eqx.filter_jit
def weighed(
    problem: CalibrationProblem, z: Float[Array, " n_p"], response: Response
) -> Evaluation:
    """Weigh the errors and compliances of all lanes, and add those of the priors."""
    delta_e = effector_errors(problem, response.effectors)
    rows = problem.rows(z, delta_e, response.W_ep.reshape(-1, z.shape[0]))
    ok = jnp.all(response.equilibrium.converged) & jnp.all(response.ok)
    # A tiny `std` makes the squares overflow, and an infinite cost never falls.
    finite = jnp.isfinite(_cost(ok, rows.error)) & jnp.all(jnp.isfinite(rows.W))
    return Evaluation(response, delta_e, rows, finite)


def at_rest(problem: CalibrationProblem) -> Float[Array, "n_c n_points 3"]:
    """Return displacements of zero, as a guess [m]."""
    n_c = problem.configurations.gravity.shape[0]
    return jnp.zeros((n_c, problem.model.n_points, 3))


@eqx.filter_jit
def _energy_compliance_lane(
    model: Model,
    space: ParameterSpace,
    z: Float[Array, " n_p"],
    configuration: ConfigurationArrays,
    u: Float[Array, "n_points 3"],
) -> EnergyCompliance:
    return energy_compliance(model, configuration, u, space, z)


@eqx.filter_jit
def _posed(problem: CalibrationProblem, z) -> tuple[Model, ConfigurationArrays]:
    return problem.at(z)


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

    __repr__ = one_line

    def __init__(self, problem: CalibrationProblem, workers: Workers):
        """Split the calibration into what all lanes share, and the lanes."""
        self.problem, self.workers = problem, workers
        self.numbered = without_names(problem)
        # The number of lanes and what concerns steps alone would each give another
        # program, so both are left out.
        space = replace(self.numbered.space, order=(), tensor_steps=True, pin=None)
        where = lambda p: (p.configurations, p.space)
        alone = self.numbered.with_noise(None)
        self.shared = eqx.tree_at(where, alone, (None, space))
        self.lanes = list(problem.configurations)
        self._program = Program(evaluate_lane, self.shared)

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

    def response(
        self,
        z: Float[Array, " n_p"],
        guess: Float[Array, "n_c n_points 3"],
        before: Float[Array, "n_c n_points 3"] | None = None,
        precise: bool | Bool[Array, ""] = False,
    ) -> Response:
        """Compute equilibria and compliances W_ep (paper Eq. 9) of all lanes.

        Args:
            z: Scaled parameters [-].
            guess: Displacements to start from [m].
            before: Equilibria that the guess extrapolates to first order, if any [m].
            precise: Whether the compliances are exact, see `evaluate_lane`.
        """
        before = guess if before is None else before
        lanes = zip(self.lanes, guess, before, strict=True)
        arguments = [(z, *lane, jnp.asarray(precise)) for lane in lanes]
        return stacked(self.workers.map(self._program, arguments))

    def __call__(
        self,
        z: Float[Array, " n_p"],
        guess: Float[Array, "n_c n_points 3"],
        before: Float[Array, "n_c n_points 3"] | None = None,
        precise: bool | Bool[Array, ""] = False,
    ) -> Evaluation:
        """Weigh the errors and compliances of `response` (paper Eqs. 9, 10)."""
        response = self.response(z, guess, before, precise)
        return weighed(self.numbered, z, response)

    def response_of(
        self, lane: int, z: Float[Array, " n_p"], guess: Float[Array, "n_points 3"]
    ) -> Response:
        """Compute equilibrium and compliances of one lane, not `precise`."""
        arguments = (z, self.lanes[lane], guess, guess, jnp.asarray(False))
        return self.workers.map(self._program, [arguments])[0]

    def posed(self, z: Float[Array, " n_p"]) -> tuple[Model, ConfigurationArrays]:
        """Return model and configurations with scaled parameters set [-]."""
        return _posed(self.numbered.with_noise(None), z)

    def equilibria(
        self, z: Float[Array, " n_p"], report: Report | None = None
    ) -> EquilibriumSolution:
        """Solve the equilibria from rest; see the function of this name."""
        posed, newton = self.posed(z), self.problem.newton
        return equilibria(self.workers, *posed, newton, report=report)

    def effectors(
        self, z: Float[Array, " n_p"], solution: EquilibriumSolution
    ) -> Float[Array, "n_c n_rows 3"]:
        """Compute effector coordinates at these equilibria."""
        return effectors_on_all_cores(self.workers, *self.posed(z), solution)

    def from_rest(self, z: Float[Array, " n_p"]) -> Evaluation:
        """Evaluate without a guess from another evaluation, see `solve_from_rest`."""
        guess = at_rest(self.problem)
        if self.problem.model.mechanism.bodies.n_bodies > 0:
            guess = as_guess(self.equilibria(z))
        return self(z, guess)

    def energy_compliances(
        self, z: Float[Array, " n_p"], u: Float[Array, "n_c n_points 3"]
    ) -> EnergyCompliance:
        """Compute W_ep and W_pp of all lanes at displacements `u` [m]."""
        program = Program(_energy_compliance_lane, self.shared.model, self.shared.space)
        lanes = [(z, *lane) for lane in zip(self.lanes, u, strict=True)]
        return stacked(self.workers.map(program, lanes))


def evaluate(
    problem: CalibrationProblem,
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


def linearised(
    problem: CalibrationProblem,
    configurations: Sequence[Configuration],
    z: Float[Array, " n_p"],
    evaluation: Evaluation,
    **more: Any,
) -> LinearModel:
    """Make the linear model of an evaluation; `more` is handed to `linear_model`."""
    return linear_model(
        problem,
        configurations,
        z=z,
        W_ep=evaluation.response.W_ep,
        ok=evaluation.response.ok,
        delta_e=evaluation.delta_e,
        rows=evaluation.rows,
        **more,
    )


class HeldOut(NamedTuple):
    """Held-out configurations with the calibrated parameters; `before` by the start.

    `before` are effectors, nan without an equilibrium; `notes` say which have none.
    """

    before: Float[HostArray, "n_c n_rows 3"]
    response: Response
    notes: tuple[str, ...]
    interrupted: bool


class _Chain(NamedTuple):
    """Held-out configurations at some parameters: how each responds, once solved.

    `before` is the equilibrium of a configuration that was fitted, with the same
    parameters [m].
    """

    z: Float[Array, " n_p"]
    before: Float[Array, "n_points 3"]
    solved: list[Response]

    @classmethod
    def of(cls, z: Float[Array, " n_p"], fitted: Response, n: int) -> "_Chain":
        """Begin with `n` that have no equilibrium, beside a fitted one."""
        zeros = jax.tree.map(lambda leaf: np.zeros_like(np.asarray(leaf)), fitted)
        where = lambda response: response.equilibrium.result
        none = eqx.tree_at(where, zeros, RESULTS.max_steps)
        return cls(z, fitted.equilibrium.displacement, [none] * n)


def held_out_responses(
    evaluate: Evaluator,
    configurations: Sequence[Configuration],
    *,
    start: tuple[Float[Array, " n_p"], Response],
    end: tuple[Float[Array, " n_p"], Response],
    report: Report,
) -> HeldOut:
    """Solve held-out configurations with the parameters at the end and at the start.

    Both come with the response of a configuration that was fitted, whose equilibrium
    robots with rigid bodies begin from. Near a limit point an equilibrium need not be
    found from rest: there the path of the configuration is followed by arc length, and
    its end is where the search begins anew. A configuration without equilibrium is left
    out with a note, as it must neither count as a prediction nor cost the user the fit;
    so are those that Ctrl-C cuts off. `report` is called as by `equilibria`, with the
    parameters at the end.
    """
    n = len(configurations)
    last, first = _Chain.of(*end, n), _Chain.of(*start, n)
    bodies = evaluate.problem.model.mechanism.bodies.n_bodies > 0
    groups = [range(n)] if bodies else [range(i, i + 1) for i in range(n)]
    carried: dict[int, float] = {}
    interrupted = False
    try:
        evaluate.workers.side_by_side(
            partial(_solve_group, evaluate, chain, group, told)
            for chain, told in ((last, report), (first, lambda *_: None))
            for group in groups
        )
        _follow_paths(evaluate, last, carried)
    except KeyboardInterrupt:
        interrupted = True
    response, before = stacked(last.solved), stacked(first.solved)
    converged = np.asarray(response.equilibrium.converged)
    notes = []
    for i in np.flatnonzero(~converged).tolist():
        why = "with the calibrated parameters it has no equilibrium"
        if i in carried:
            share = f"{100.0 * carried[i]:.3g} % of its load"
            why += f". Along its path (`LoadPath`) it carries at most {share}"
        elif interrupted:
            why = "this was interrupted"
        notes.append(f"{configurations[i].name} is not predicted: {why}.")
    notes += unscoped_notes(evaluate.problem.space, configurations)
    # A pose that only the start parameters cannot hold has no "before".
    held = np.asarray(before.equilibrium.converged)[:, None, None]
    effectors = np.where(held, np.asarray(before.effectors), np.nan)
    return HeldOut(effectors, response, tuple(notes), interrupted)


def _solve_group(
    evaluate: Evaluator, chain: _Chain, group: Sequence[int], report: Report
) -> None:
    """Solve configurations from rest; rigid bodies go on from the one before."""
    model, lanes = evaluate.posed(chain.z)
    bodies, settings = model.mechanism.bodies.n_bodies > 0, evaluate.problem.newton
    guess = chain.before if bodies else jnp.zeros_like(chain.before)
    for i in group:
        solution = equilibria(
            evaluate.workers,
            model,
            lane_of(lanes, slice(i, i + 1)),
            settings,
            guess=guess[None],
            report=lambda _, load, steps, i=i: report(i, load, steps),
        )
        if solution.converged[0]:
            guess = solution.displacement[0]
            chain.solved[i] = evaluate.response_of(i, chain.z, guess)


def _follow_paths(
    evaluate: Evaluator, chain: _Chain, carried: dict[int, float]
) -> None:
    """Follow what is not in equilibrium from rest along its load.

    `carried` gets the largest share of its load that each of these carries.
    """
    model, lanes = evaluate.posed(chain.z)
    for i, response in enumerate(chain.solved):
        if response.equilibrium.converged:
            continue
        path = solve_equilibrium(
            model, lane_of(lanes, i), settings=evaluate.problem.newton, path=LoadPath()
        )
        share = min(float(np.max(path.load)), 1.0)
        if share == 1.0:
            guess = jax.device_put(path.displacement[-1])
            chain.solved[i] = evaluate.response_of(i, chain.z, guess)
        carried[i] = share


def unscoped_notes(
    space: ParameterSpace, held_out: Sequence[Configuration]
) -> list[str]:
    """Say which held-out configurations have no unknown of their own."""
    return [
        f"{c.name} is predicted without {entry.noun}, which {entry.by}s that were "
        "fitted have of their own: it counts as stated."
        for entry in space.entries
        if isinstance(entry, SetupParameter) and entry.each
        for c in held_out
        if entry.member(c) not in entry.each
    ]
