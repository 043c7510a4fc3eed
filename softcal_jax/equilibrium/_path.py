"""Equilibria along the load, by arc length: past limit points, where load control ends.

The load factor t is an unknown beside the displacement. From one state the path is
followed along its tangent (du/dt, 1), and balance is restored on the plane through the
predicted state and normal to the tangent (Riks, Int. J. Solids Structures 15, 1979;
Keller's pseudo-arclength),

    w <tau_u, u - u_n> + tau_t (t - t_n) = ds.

Each iteration solves K du_1 = -g and K du_2 = -dg/dt on one factorization of the
sparse, bordered system, and takes du = du_1 + dt du_2 with dt from the plane. The
weight w makes a unit of t as long as the displacement that the full load would cause on
the undeformed body if it stayed linear, so that ds has no unit.
"""

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._module import Module
from softcal_jax._process import check_process
from softcal_jax._results import RESULTS
from softcal_jax._typing import Array, Bool, Float, HostArray, Int, is_traced
from softcal_jax.configurations import Configuration, ConfigurationArrays
from softcal_jax.equilibrium._assembly import newton_terms, no_strains, predict
from softcal_jax.equilibrium._balance import (
    Point,
    assemble,
    at_rest,
    evaluate,
    gap,
    merit,
    relative,
    stiffness_of_gaps,
    unbalanced,
)
from softcal_jax.equilibrium._element import Strains
from softcal_jax.equilibrium._model import Model, Nodal
from softcal_jax.equilibrium._newton import NEAR, NewtonSettings
from softcal_jax.equilibrium._posed import Posed, one_lane
from softcal_jax.equilibrium._robot_state import effector_values
from softcal_jax.equilibrium._sparsity import product

MOST_ITERATIONS = 12  # corrections after which a step is halved

WANTED_ITERATIONS = 4
"""Corrections of a step of the right length; the next length is adapted to it."""

SMALLEST = 1e-4  # step, relative to the first, at which the path counts as ended


class LoadPath(Module):
    """How to trace the equilibria of a configuration along its load.

    Attributes:
        states: Most states to find, if the path does not reach the full load.
        first: Load factor of the first state [-].
        largest: Longest step; 1 is the displacement, or the load, that the full load
            would cause on a body that stayed linear [-].
    """

    states: int = 50
    first: float = 0.1
    largest: float = 1.0

    def __check_init__(self):
        if self.states < 1:
            raise ValueError(f"states must be at least 1, got {self.states}.")
        if not 0.0 < self.first <= 1.0:
            raise ValueError(f"first must lie in (0, 1], got {self.first:g}.")
        if not self.largest > 0.0:
            raise ValueError(f"largest must be positive, got {self.largest:g}.")


class EquilibriumPath(Module):
    """Equilibria along the load, the unloaded state first.

    Attributes:
        load: Load factors [-].
        displacement: Displacement u of each state [m].
        multipliers: Forces of the actuators whose displacement is imposed.
        n_negative: Number of negative eigenvalues of each tangent, 0 for a stable
            state; -1 if unknown, because the linear solver does not count them or the
            model is not conservative.
        readings: Effectors of each state, in rows of three.
        result: `converged` if the last state carries the full load; if all states were
            used up, `limit_point` beyond a limit point and `states_used_up` before one;
            otherwise why no further state was found.
    """

    load: Float[HostArray, " n"]
    displacement: Float[HostArray, "n n_points 3"]
    multipliers: Float[HostArray, "n n_a"]
    n_negative: Int[HostArray, " n"]
    readings: Float[HostArray, "n n_rows 3"]
    result: RESULTS


class _State(NamedTuple):
    """A state on the path with its tangent, per unit of load.

    A step takes the `strains` or, if `exact`, those of u. `weight` is w of the module's
    docstring; `n_negative` as in `EquilibriumPath`, `ok` whether the state is in
    equilibrium.
    """

    u: Nodal
    strains: Strains
    exact: Bool[Array, ""]
    lambda_a: Float[Array, " n_a"]
    load: Float[Array, ""]
    du: Nodal
    dx: Float[Array, " n_dof"]
    d_lambda: Float[Array, " n_a"]
    sense: Float[Array, ""]
    weight: Float[Array, ""]
    n_negative: Int[Array, ""]
    readings: Float[Array, "n_rows 3"]
    iterations: Int[Array, ""]
    regular: Bool[Array, ""]
    ok: Bool[Array, ""]

    @property
    def length(self) -> Float[Array, ""]:
        return jnp.sqrt(self.weight * jnp.sum(self.du**2) + 1.0)


def _displaced(posed: Posed, u, d, load):
    """Apply a step of the free unknowns, and hold the others as at the new load."""
    loaded = posed.at_load(load)
    held = jnp.where(jnp.asarray(posed.configuration.fixed), loaded.imposed(u), 0.0)
    return loaded.move(u, d.at[: u.size].add(held.ravel()))


def _both_steps(posed: Posed, point: Point, lambda_a, strains, exact):
    """Solve for two rows: the steps that restore balance and that follow the load.

    Also returns the tangent, and the motion of held unknowns per unit of load.
    """
    model, configuration, u = posed.model, posed.configuration, point.u
    to_go, active = gap(posed, point, lambda_a, jnp.ones(()))
    size = merit(posed, point, lambda_a, jnp.zeros_like(lambda_a))
    exact = exact | (relative(posed, point, size, jnp.zeros(())).size <= NEAR)
    mesh, internal = newton_terms(model, u, point.force, strains, exact)
    tangent = assemble(posed, point, lambda_a, mesh=mesh, active=active)

    def at_load(load):
        loaded = posed.at_load(load)
        return loaded.held_at(u), unbalanced(loaded, point, lambda_a)[0]

    one = jnp.ones_like(posed.load)
    _, (held, by_load) = jax.jvp(at_load, (posed.load,), (one,))
    pull = product(model.pattern, tangent.nodal, held.ravel()).reshape(u.shape)
    which = model.with_multiplier
    wanted = jnp.asarray(configuration.actuation.value)[which]
    wanted = wanted - jnp.sum(tangent.H_a * held[None], axis=(1, 2))
    solved = tangent.system.solve(
        model.solver,
        jnp.stack(
            [
                -posed.on_free(u, tangent.g + internal - point.force),
                -posed.on_free(u, by_load + pull),
            ]
        ),
        jnp.stack([to_go[which], jnp.where(active[which], wanted, 0.0)]),
    )
    return tangent, solved, held, exact


def _readings(posed: Posed, u, lambda_a, unbalanced):
    """Read the effectors at this share of the load."""
    where = lambda c: (c.actuation.value, c.springs.rest)
    imposed = where(posed.configuration)
    scaled = tuple(posed.load * jnp.asarray(value) for value in imposed)
    configuration = eqx.tree_at(where, posed.configuration, scaled)
    return effector_values(posed.model, configuration, u, lambda_a, unbalanced)


@eqx.filter_jit
def _step(
    model: Model,
    configuration: ConfigurationArrays,
    old: _State,
    ds: Float[Array, ""],
    to_the_end: Bool[Array, ""],
    settings: NewtonSettings,
) -> _State:
    """Go one step along the path; `to_the_end` ends it at the full load instead."""
    full = Posed.of(model.tabulated(), configuration)
    along = old.sense / old.length
    tau_u, tau_t = along * old.du, along

    def off_plane(u, load):
        on = old.weight * jnp.sum(tau_u * (u - old.u)) + tau_t * (load - old.load)
        return jnp.where(to_the_end, 1.0 - load, ds - on)

    def correct(s: _State) -> _State:
        posed = full.at_load(s.load)
        point = evaluate(posed, s.u)
        tangent, solved, held, exact = _both_steps(
            posed, point, s.lambda_a, s.strains, s.exact
        )
        off = merit(posed, point, s.lambda_a, stiffness_of_gaps(posed, solved.W_aa))
        residual = relative(posed, point, off, tangent.stiffness)
        apart = off_plane(s.u, s.load)
        near = jnp.abs(apart) <= 1e-3 * jnp.maximum(jnp.abs(ds), SMALLEST)
        arrived = residual.settled(settings.rtol) & near & solved.ok
        by_balance = posed.scatter(s.u, solved.x[0])
        du = held + posed.scatter(s.u, solved.x[1])
        slope = tau_t + old.weight * jnp.sum(tau_u * du)
        shift = old.weight * jnp.sum(tau_u * by_balance)
        d_load = jnp.where(to_the_end, apart, (apart - shift) / slope)
        load = s.load + d_load
        u = _displaced(full, s.u, solved.x[0] + d_load * solved.x[1], load)
        strains, sound = predict(model, s.u, u - s.u, s.strains, exact)
        moved = s._replace(
            u=u,
            strains=strains,
            exact=~sound,
            lambda_a=s.lambda_a
            + model.among_all(solved.lambda_a[0] + d_load * solved.lambda_a[1]),
            load=jnp.where(to_the_end, 1.0, load),
            iterations=s.iterations + 1,
            regular=solved.ok & point.finite & (point.min_det_F > 0.0),
        )
        along = old.weight * jnp.sum(tau_u * du) + tau_t
        done = s._replace(
            du=du,
            dx=solved.x[1],
            d_lambda=model.among_all(solved.lambda_a[1]),
            sense=jnp.where(along < 0.0, -1.0, 1.0),
            n_negative=jnp.where(model.conservative, solved.n_negative, -1),
            readings=_readings(posed, s.u, s.lambda_a, tangent.g),
            regular=solved.ok & (point.min_det_F > 0.0),
            ok=point.min_det_F > 0.0,
        )
        return jax.tree.map(lambda a, b: jnp.where(arrived, a, b), done, moved)

    def keep_going(s: _State):
        return ~s.ok & s.regular & (s.iterations < MOST_ITERATIONS)

    share = jnp.where(to_the_end, 1.0 - old.load, ds * along)
    load = jnp.where(to_the_end, 1.0, old.load + share)
    u = _displaced(full, old.u, share * old.dx, load)
    exact = jnp.ones((), bool)
    strains, sound = predict(full.model, old.u, u - old.u, old.strains, exact)
    begun = old._replace(
        u=u,
        strains=strains,
        exact=~sound,
        lambda_a=old.lambda_a + share * old.d_lambda,
        load=load,
        iterations=jnp.zeros_like(old.iterations),
        regular=jnp.ones((), bool),
        ok=jnp.zeros((), bool),
    )
    return jax.lax.while_loop(keep_going, correct, begun)


def _begin(
    model: Model, configuration: ConfigurationArrays, settings: NewtonSettings
) -> _State:
    rest = at_rest(Posed.of(model, configuration))
    n_rows = configuration.effectors.measured.shape[0]
    zero, count = jnp.zeros(()), jnp.zeros((), jnp.int32)
    no = jnp.zeros((), bool)
    state = _State(
        u=rest.u,
        strains=no_strains(model),
        exact=no,
        lambda_a=jnp.zeros(model.mechanism.n_actuators),
        load=zero,
        du=rest.u,
        dx=jnp.zeros(model.n_dof),
        d_lambda=jnp.zeros(model.mechanism.n_actuators),
        sense=jnp.ones(()),
        weight=jnp.ones(()),
        n_negative=count,
        readings=jnp.zeros((n_rows, 3)),
        iterations=count,
        regular=no,
        ok=no,
    )
    state = _step(model, configuration, state, zero, no, settings)
    moved = jnp.sum(state.du**2)
    return state._replace(weight=jnp.where(moved > 0.0, 1.0 / moved, 1.0))


def trace_equilibria(
    model: Model,
    configuration: Configuration | ConfigurationArrays,
    path: LoadPath | None = None,
    *,
    settings: NewtonSettings | None = None,
    check: Callable[[], None] = lambda: None,
) -> EquilibriumPath:
    """Trace all states from rest along the load, also where a body balloons or buckles.

    `check` is called before each state, and may raise to end it; other arguments are
    those of `solve_equilibrium`.

    Raises:
        ValueError: If it is under `jit`, `vmap` or autodiff: how many states a path has
            is only known while it is followed.
    """
    check_process()
    configuration, path = one_lane(model, configuration), path or LoadPath()
    settings = (settings or NewtonSettings()).as_arrays()
    if any(map(is_traced, jax.tree.leaves((model, configuration)))):
        raise ValueError(
            "a path is followed outside of jit, vmap and autodiff: call "
            "trace_equilibria with concrete arrays."
        )
    state = _begin(model, configuration, settings)
    states = [state]
    ds = first = path.first * float(state.length)
    full, result = jnp.asarray(True), RESULTS.states_used_up
    while bool(state.ok) and len(states) <= path.states:
        check()
        length = jnp.asarray(ds, float)  # typed as the first: one program
        new = _step(model, configuration, state, length, ~full, settings)
        last = bool(new.ok) and float(new.load) >= 1.0
        if last:
            new = _step(model, configuration, state, length, full, settings)
        if not bool(new.ok):
            ds *= 0.5
            if ds < SMALLEST * first:
                singular = not bool(new.regular)
                result = RESULTS.singular if singular else RESULTS.load_step_too_small
                break
            continue
        states.append(new)
        state = new
        if last:
            result = RESULTS.converged
            break
        fewer = WANTED_ITERATIONS / max(int(new.iterations), 1)
        ds = min(ds * float(np.clip(np.sqrt(fewer), 0.5, 2.0)), path.largest)
    if not bool(state.ok):
        result = RESULTS.singular
    kept = [(s.load, s.u, s.lambda_a, s.n_negative, s.readings) for s in states]
    load, *others = (np.stack(jax.device_get(each)) for each in zip(*kept, strict=True))
    if result == RESULTS.states_used_up and np.any(np.diff(load) < 0.0):
        result = RESULTS.limit_point
    return EquilibriumPath(load, *others, result=result)
