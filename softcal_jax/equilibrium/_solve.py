"""Static equilibrium of a configuration, differentiable and batched."""

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._lanes import lane_of
from softcal_jax._module import Module
from softcal_jax._process import check_process
from softcal_jax._results import RESULTS
from softcal_jax._typing import Array, Bool, Float, HostArray, Int, is_traced
from softcal_jax.configurations import (
    OTHER_POINTS,
    Configuration,
    ConfigurationArrays,
    configuration_arrays,
)
from softcal_jax.equilibrium._assembly import (
    gravity_load,
    smallest_det_F,
    stiffness_of_laws,
)
from softcal_jax.equilibrium._linearisation import input_rows, linearise, sensitivity
from softcal_jax.equilibrium._load_steps import LoadState, LoadSteps
from softcal_jax.equilibrium._model import Model, Nodal
from softcal_jax.equilibrium._newton import (
    NewtonSettings,
    check_solver,
    iteration_by,
    newton_iteration,
)
from softcal_jax.equilibrium._posed import Posed, one_lane
from softcal_jax.equilibrium._without_derivative import nan_of, without_derivative
from softcal_jax.mesh import place

if TYPE_CHECKING:
    from softcal_jax.equilibrium._newton import Solver


class EquilibriumSolution(Module):
    """Equilibrium of one configuration, or of a batch (leading axis on every field).

    Displacement, multipliers and min_det_F have derivatives. Other numbers have none,
    and say so where they are differentiated.

    Attributes:
        displacement: Displacement u of the nodes of the mesh, then of the four nodes
            of each rigid body's frame [m]; nan where no equilibrium was found.
        multipliers: Forces of the actuators whose displacement is imposed, 0 for the
            others; `actuator_forces` gives those of all.
        result: Outcome; only `RESULTS.converged` is an equilibrium.
        steps: Newton iterations, each on a factor of its own, all load steps together.
        load_steps: Load increments that were taken (1: full load at once).
        load_reached: Share of the load at the last equilibrium [-]; 1 if converged.
        residual: Residual relative to the larger of external and internal force [-].
        rounding: Residual that rounding leaves, estimated from the mean stiffness;
            forces below their own rounding count as large as that [-].
        at_rounding: Whether Newton stopped at rounding, with a residual above `rtol`.
        min_det_F: Smallest det F over all quadrature points [-].
        n_negative: Number of negative eigenvalues of the last tangent, 0 for a stable
            state; at a limit point the fewest of any iterate beyond it; -1 if unknown,
            because the linear solver does not count them or the model is not
            conservative.
        approached: Largest share that was found of the ways from the nearest
            equilibrium; 1 if converged, nan if none was tried [-].
        along_path: Share of the load that its path carries (`trace_equilibria`); 1 if
            converged, nan if none was followed [-].
        touched: Names of all that the body may touch.
        contacts: For each of them, where a solve on the host failed: the middle at rest
            of the face that is pressed most [m], the depth over the scale of contact
            [-], and the share that slides [-]; nan where nothing touches. At the last
            equilibrium of a part of the load or, if nothing touches, the last iterate.
    """

    displacement: Float[Array, "*batch n_points 3"]
    multipliers: Float[Array, "*batch n_a"]
    result: RESULTS
    steps: Int[Array, "*batch"]
    load_steps: Int[Array, "*batch"]
    load_reached: Float[Array, "*batch"]
    residual: Float[Array, "*batch"]
    rounding: Float[Array, "*batch"]
    at_rounding: Bool[Array, "*batch"]
    min_det_F: Float[Array, "*batch"]
    n_negative: Int[Array, "*batch"]
    approached: Float[Array, "*batch"]
    along_path: Float[Array, "*batch"]
    contacts: Float[Array, "*batch n_touched 5"]
    touched: tuple[str, ...] = eqx.field(static=True)

    @property
    def converged(self) -> Bool[Array | HostArray, "*batch"]:
        """Whether each configuration reached a regular equilibrium."""
        (here,), (good,) = map(jax.tree.leaves, (self.result, RESULTS.converged))
        if is_traced(here):
            return self.result == RESULTS.converged
        return np.asarray(np.asarray(here) == np.asarray(good))  # without compiling

    def _words(self) -> str:
        good = np.asarray(self.converged)
        steps, residual = np.max(np.asarray(self.steps)), np.max(self.residual)
        how = f"{steps} Newton steps, residual {residual:.1e}"
        if good.ndim == 0:
            return f"{RESULTS[self.result]}; {how}"
        return f"{good.sum()} of {good.size} converged; at most {how}"


_DIAGNOSTICS = "load_reached residual rounding approached along_path contacts".split()


def outcome_words(solution: EquilibriumSolution) -> str:
    """Say how the solve of one lane ended, and what the body touches if it failed."""
    ended, depths = RESULTS[solution.result], solution.contacts[:, 3]
    if np.all(np.isnan(depths)):
        return ended
    k = int(np.nanargmax(depths))
    *at, depth, sliding = np.asarray(solution.contacts[k])
    slides = f", and {100.0 * sliding:.0f} % of the touched area slides"
    return (
        f"{ended}. Where the solve stopped, at {100.0 * solution.load_reached:.3g} % "
        f'of the load, contact is deepest at "{solution.touched[k]}" near '
        f"{place(np.array(at))}, {depth:.2g} times the scale of contact"
        f"{slides if sliding > 0.0 else ''}"
    )


def other_ways(solution: EquilibriumSolution) -> str:
    """Say which ways failed beside load steps from rest, in sentences."""
    way, path = 100.0 * solution.approached, 100.0 * solution.along_path
    said = ""
    if np.isfinite(way):
        said += (
            " The ways from the nearest equilibrium (straight; actuator by actuator, "
            f"where several differ; loads first or last) led at most {way:.3g} % there."
        )
    if np.isfinite(path):
        said += f" Along its path (`trace_equilibria`) it carries at most {path:.3g} %."
    return said


def no_equilibrium(solution: EquilibriumSolution, names: tuple[str, ...]) -> str:
    """Say which lanes of a batch have no equilibrium, and why; empty if none."""
    bad = np.flatnonzero(~np.asarray(solution.converged)).tolist()

    def why(lane):
        one = solution if solution.steps.ndim == 0 else lane_of(solution, lane)
        count = f"{one.n_negative} negative eigenvalue{'s' * int(one.n_negative != 1)}"
        if one.n_negative < 0:  # so a limit point would not be noticed
            count = "negative eigenvalues unknown"
        return (
            f"configuration {names[lane]!r}: {outcome_words(one)} "
            f"({100 * one.load_reached:.3g} % of the load carried, {count}, "
            f"{one.steps} Newton steps, residual {one.residual:.1e} with rounding at "
            f"{one.rounding:.1e}, smallest det F {one.min_det_F:.3g}).{other_ways(one)}"
        )

    return "\n".join(["no equilibrium found.", *map(why, bad)]) if bad else ""


def check_converged(solution: EquilibriumSolution, names: tuple[str, ...]) -> None:
    """Check that all configurations of a batch have an equilibrium.

    Raises:
        RuntimeError: If one has none; the message says which, and why.
    """
    if text := no_equilibrium(solution, names):
        raise RuntimeError(text)


def as_solution(
    state: LoadState, settings: NewtonSettings, touched: tuple[str, ...]
) -> EquilibriumSolution:
    carried, now = state.done & (state.load_ok >= 1.0), state.iterate
    beyond = state.result == RESULTS.limit_point
    # Without an equilibrium, no displacement may be mistaken for one. While it is
    # sought, a nan would only stop programs that are searched for nan.
    sought = ~state.done & (state.step < settings.max_steps)
    or_nan = lambda value: jnp.where(carried | sought, value, jnp.nan)
    return EquilibriumSolution(
        displacement=or_nan(now.point.u),
        multipliers=or_nan(now.lambda_a),
        result=state.result,
        steps=state.step,
        load_steps=state.load_steps,
        load_reached=state.load_ok,
        residual=now.residual.size,
        rounding=now.residual.rounding,
        at_rounding=carried & now.residual.at_rounding(settings.rtol),
        min_det_F=now.point.min_det_F,
        n_negative=jnp.where(beyond, state.limit, now.n_negative),
        approached=or_nan(jnp.ones_like(state.load_ok)),
        along_path=or_nan(jnp.ones_like(state.load_ok)),
        contacts=jnp.full((len(touched), 5), jnp.nan, float),
        touched=touched,
    )


@eqx.filter_jit
def begin_newton(
    model: Model,
    settings: NewtonSettings,
    configuration: ConfigurationArrays,
    guess: Nodal | None = None,
) -> LoadState:
    """Return the state before the first iteration, for `continue_newton`.

    At rest there is nothing to evaluate, and little to compile.
    """
    loop = LoadSteps(Posed.of(model.tabulated(), configuration), settings)
    return loop.start(guess)


@eqx.filter_jit
def continue_newton(
    model: Model,
    settings: NewtonSettings,
    steps: Int[Array, ""],
    configuration: ConfigurationArrays,
    state: LoadState,
) -> tuple[LoadState, EquilibriumSolution]:
    """Do some more iterations, for a caller that reports in between.

    The solution counts only if the state is `done` or no iterations are left.
    """
    loop = LoadSteps(Posed.of(model.tabulated(), configuration), settings)
    most = jnp.minimum(state.step + steps, settings.max_steps)
    state = loop.run(state, most)
    return state, as_solution(state, settings, loop.posed.contacts.touched)


_SLIDES = 0.9  # share of the touched area that slides where a body slides away

_GIVES_WAY = 0.25
"""Share of its stiffness at rest under which a law gives way; structures keep more."""


def with_cause(
    model: Model,
    lane: ConfigurationArrays,
    state: LoadState,
    solution: EquilibriumSolution,
) -> EquilibriumSolution:
    """Say of a solve that failed if the body slides, or its law or a chamber gave way.

    A chamber has if its pressure does most of the work of the loads. And say what the
    body touches.
    """
    failed = solution.result
    if failed == RESULTS.converged:
        return solution
    solution = replace(solution, contacts=_last_contacts(model, lane, state))
    if failed == RESULTS.inverted:
        return solution
    if _slides(model, lane, state.stray):
        return replace(solution, result=RESULTS.slides)
    if state.fell:  # where it ended is no state of the load path
        return solution
    u = state.iterate.point.u if failed == RESULTS.unstable else state.stray
    motion = u if failed == RESULTS.unstable else u - state.ok.u
    here, at_rest = stiffness_of_laws(model, u, motion)
    if here < _GIVES_WAY * at_rest:
        return replace(solution, result=RESULTS.law_unstable)
    if failed != RESULTS.limit_point:
        return solution
    works = loads_work(model, lane, u)
    chambers = [kind.noun == "chamber" for kind in model.mechanism.actuators.kinds]
    if 2.0 * np.sum(works[2:][np.array(chambers, bool)]) > np.sum(works):
        return replace(solution, result=RESULTS.largest_pressure)
    return solution


@eqx.filter_jit
def _contact_states(model: Model, lane: ConfigurationArrays, u: Nodal):
    return Posed.of(model, lane).contact_states(u)


def _last_contacts(model: Model, lane: ConfigurationArrays, state: LoadState) -> Array:
    """Compute `contacts` of a solution that failed."""
    contacts, rest = model.mechanism.contacts, np.asarray(model.mechanism.points)
    rows = np.full((len(contacts.touched), 5), np.nan)
    if not contacts.touched:
        return jnp.asarray(rows)
    last = state.stray if state.done else state.iterate.point.u
    for u in (state.ok.u, last) if state.load_ok > 0.0 else (last,):
        if np.all(np.isnan(rows)):
            for row, c in zip(rows, _contact_states(model, lane, u), strict=True):
                if c.area > 0.0:
                    at = rest[contacts.faces_of(c.name)[np.argmax(c.pressure)]]
                    row[:] = *at.mean(axis=0), c.depth / contacts.scale, c.sliding
    return jnp.asarray(rows)


def _slides(model: Model, lane: ConfigurationArrays, u: Nodal) -> bool:
    """Tell whether nothing but obstacles with friction holds the body, and too little.

    A support that holds it along all axes, a spring, or a body that is guided does.
    """
    bodies, contacts = model.mechanism.bodies, model.mechanism.contacts
    guided = np.any(np.asarray(lane.bodies.is_guided)[bodies.owner] & bodies.has_nodes)
    supported = np.all(np.any(np.asarray(lane.fixed), axis=0)) or lane.springs.names
    if guided or supported or not any(contacts.sticks):
        return False
    states = _contact_states(model, lane, u)
    rough = [c for c, sticks in zip(states, contacts.sticks, strict=True) if sticks]
    sliding = [float(c.sliding) for c in rough if c.area > 0.0]
    return bool(sliding) and min(sliding) > _SLIDES


def loads_work(
    model: Model, lane: ConfigurationArrays, u: Nodal
) -> Float[HostArray, " n"]:
    """Compute the work of weight, dead loads, and each imposed force on a motion [J].

    Without its sign; that of an actuator whose displacement is imposed is 0.
    """
    nodal = gravity_load(model, lane.acceleration), lane.dead_loads
    actuation = lane.actuation
    imposed = np.where(actuation.by_displacement, 0.0, actuation.forces)
    of_actuators = imposed * np.asarray(model.displacements(u))
    return np.abs([*(np.sum(forces * u) for forces in nodal), *of_actuators])


def resumed(state: LoadState) -> LoadState:
    """Return a state that gave up its first step, to go on by load steps from rest."""
    beyond = state.result == RESULTS.limit_point
    result = RESULTS.where(beyond, RESULTS.limit_point, RESULTS.max_steps)
    return state._replace(result=result, done=jnp.zeros((), bool))


def _solved(model, configuration, u0, settings, iteration) -> EquilibriumSolution:
    posed = Posed.of(model.tabulated(), configuration)
    loop = LoadSteps(posed, settings, iteration)
    ended = loop.run(loop.start(u0), settings.max_steps)
    return as_solution(ended, settings, posed.contacts.touched)


@eqx.filter_custom_jvp
def _equilibrium(model, configuration, u0, settings, solver):
    # A `vmap` of the loop would run all lanes until the slowest ends. In sequence, each
    # gives what it gives alone, but for rounding, and nothing shared is copied.
    model, rest = eqx.partition(model, eqx.is_array_like)
    iteration = newton_iteration
    if solver is not None:
        iteration = iteration_by(solver, int(settings.max_steps_per_load))

    @jax.custom_batching.sequential_vmap
    def lane(model, configuration, u0, settings):
        model = eqx.combine(model, rest)
        return _solved(model, configuration, u0, settings, iteration)

    return lane(model, configuration, u0, settings)


@_equilibrium.def_jvp
def _equilibrium_jvp(primals, tangents):
    """Differentiate an equilibrium by the implicit function theorem.

    The single input of `sensitivity` is a step along the tangents.
    """
    model, configuration, *others = primals
    t_model, t_configuration, *_ = tangents
    if t_model.mesh.points is not None and t_model.mechanism.points is None:
        raise ValueError(OTHER_POINTS)
    solution = _equilibrium(model, configuration, *others)
    u, lambda_a = solution.displacement, solution.multipliers

    def along(function):
        inputs, t_inputs = (model, configuration), (t_model, t_configuration)
        value, slope = eqx.filter_jvp(function, inputs, t_inputs)
        of = lambda leaf, d: (jnp.zeros_like(leaf) if d is None else d)[None]
        return jax.tree.map(of, value, slope)

    # Without an equilibrium there is no derivative either, and none that reaches what
    # it shares with other lanes: at rest, all that a zero is multiplied with is finite.
    safe = lambda a: jnp.where(solution.converged, a, 0.0)
    or_nan = lambda a: safe(a[0]) + jnp.where(solution.converged, 0.0, jnp.nan)
    lin = linearise(model, configuration, safe(u), safe(lambda_a), differentiable=True)
    d = sensitivity(lin, jax.tree.map(safe, input_rows(lin, along)))
    du, d_lambda = or_nan(d.displacement), or_nan(d.multipliers)
    if not model.moved:  # points without what else is made of them
        for points in jax.tree.leaves((t_model.mesh.points, t_model.mechanism.points)):
            none = jnp.sum(nan_of(points))
            du, d_lambda = du + none, d_lambda + none
    of_tets = (safe(u), model.nodes, model.shape_gradients)
    along_tets = (du, None, t_model.shape_gradients)
    _, d_det = eqx.filter_jvp(smallest_det_F, of_tets, along_tets)
    none = jax.tree.map(lambda _: None, solution)
    return solution, eqx.tree_at(
        lambda s: (s.displacement, s.multipliers, s.min_det_F),
        none,
        (du, d_lambda, d_det),
        is_leaf=lambda leaf: leaf is None,
    )


# Differentiated eagerly too, an equilibrium is compiled once for each set of shapes.
_compiled_equilibrium = eqx.filter_jit(_equilibrium)


def lanes(
    model: Model, poses: Configuration | Sequence[Configuration]
) -> ConfigurationArrays:
    """Return configurations as a batch of arrays, to be solved under `vmap`.

    `lanes(model, poses)[0]` is the first of them. They share one compiled program.

    Raises:
        ValueError: If there is none, names repeat, one is not held or refers to unknown
            names, a body has held nodes, or a marker stands too far from the mesh.
    """
    several = [poses] if isinstance(poses, Configuration) else poses
    return configuration_arrays(model.mesh, several, model.mechanism)


def solve_equilibrium(
    model: Model,
    configuration: Configuration | ConfigurationArrays,
    *,
    guess: Nodal | None = None,
    settings: NewtonSettings | None = None,
    solver: "Solver | None" = None,
) -> EquilibriumSolution:
    """Solve for the static equilibrium of one configuration.

    Works under `jit`, `vmap` and autodiff. Derivatives by model and configuration
    (forward and reverse) are implicit: Newton iterations are not differentiated.

    Args:
        model: The model.
        configuration: One configuration, with supports and loads, or one of `lanes`.
        guess: Displacement to start from [m]; rest by default.
        settings: Settings of Newton's method.
        solver: What finds the balance at each load in place of Newton's method: a root
            finder, least-squares solver or minimiser of optimistix, such as
            `optimistix.Dogleg(1e-10, 1e-10)`. Its tolerances are relative to the size
            of the robot and to the forces on it, and its steps count as iterations:
            `max_steps_per_load` and `max_steps` of the settings. With its own linear
            solver it works on a dense Jacobian, so take a small mesh. Load steps, the
            rule that tells an equilibrium, and derivatives stay; why there is none is
            told with less detail.

    Returns:
        The solution with its outcome, which `check_converged` raises.

    Raises:
        ValueError: If the configuration is a batch or of another model, the guess has
            another shape or is not float64, float64 is off in JAX, or the solver is
            none of optimistix, or of a model whose stability it cannot tell.
        RuntimeError: If this process was forked from one that had computed.
    """
    check_process()
    configuration = one_lane(model, configuration)
    rest = jnp.zeros((model.n_points, 3))
    u0 = rest if guess is None else jnp.asarray(guess)
    if u0.shape != (model.n_points, 3) or u0.dtype != jnp.float64:
        raise ValueError(
            f"the guess is {u0.dtype} of shape {u0.shape}; expected float64 of shape "
            f"({model.n_points}, 3), a displacement of each node [m]."
        )
    if solver is not None:
        check_solver(model, solver)
    settings, bare = settings or NewtonSettings(), without_readings(configuration)
    inside = rest, model, bare, u0, settings  # `rest` is traced in any trace
    if solver is not None or any(map(is_traced, jax.tree.leaves(inside))):
        solution = _compiled_equilibrium(model, bare, u0, settings, solver)
        # An error would be a callback, which keeps programs out of JAX's cache.
        off = model.mechanism.is_off(model.mesh)
        result = RESULTS.where(off, RESULTS.other_points, solution.result)
        solution = replace(solution, result=result)
        by = solution.min_det_F
        guarded = lambda name: without_derivative(getattr(solution, name), by, name)
        return replace(solution, **{name: guarded(name) for name in _DIAGNOSTICS})
    numbers, most = settings.as_arrays(), jnp.asarray(settings.max_steps)
    state = begin_newton(model, numbers, bare, None if guess is None else u0)
    return with_cause(model, bare, *continue_newton(model, numbers, most, bare, state))


def without_readings(configuration: ConfigurationArrays) -> ConfigurationArrays:
    """Leave out the effectors: whatever is read later, the program is the same."""
    return eqx.tree_at(lambda c: c.effectors, configuration, None)
