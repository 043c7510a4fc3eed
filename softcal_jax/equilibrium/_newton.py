"""Newton's method at a fixed load, and solvers of optimistix in its place.

Minimises Pi(x) = sum_e V_e psi(F_e) - t (f_ext . u + lambda_a . delta_a) over the free
unknowns at the share t of the load (paper Eqs. 1-3; equilibrium is a minimum of Pi when
forces are imposed). `LoadSteps` leads to the full load, with either.
"""

from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._module import Module, key
from softcal_jax._typing import Array, Bool, Float, HostArray, Int, check_untraced
from softcal_jax.equilibrium._assembly import no_strains, predict, tangent_values
from softcal_jax.equilibrium._balance import (
    Point,
    Residual,
    assemble,
    deform,
    evaluate,
    gap,
    merit,
    relative,
    taut,
    unbalanced,
)
from softcal_jax.equilibrium._direction import line_search, newton_direction
from softcal_jax.equilibrium._element import Strains
from softcal_jax.equilibrium._model import Model
from softcal_jax.equilibrium._posed import Posed

if TYPE_CHECKING:  # it takes a while to import
    from optimistix import (
        AbstractLeastSquaresSolver,
        AbstractMinimiser,
        AbstractRootFinder,
    )

    Solver = AbstractRootFinder | AbstractLeastSquaresSolver | AbstractMinimiser

NEAR = 1e-3
"""Relative residual below which a step hardly moves the tangent.

Negative eigenvalues of the tangent then tell of stability.
"""

STRAIGHT = 0.1
"""Relative residual below which the next step takes the strains of u.

It hardly turns the body: strains of their own would save no iteration, and an assembly
with them takes half as long again.
"""

_MOST = np.iinfo(np.int32).max  # largest number of iterations that can be counted

Number = float | Float[Array | HostArray, ""]
Count = int | Int[Array | HostArray, ""]


class NewtonSettings(Module):
    """Settings of the equilibrium solve.

    Attributes:
        rtol: Residual at which Newton stops, relative to the larger of external and
            internal force; it also stops where rounding leaves more [-].
        max_steps: Newton iterations for one configuration, all load steps together.
        max_steps_per_load: Newton iterations after which a load step is cut, unless
            the last one reduced the residual tenfold.
        smallest_load_step: Load increment below which load stepping gives up [-].
        strict_below: Load increment below which the line search is strict [-].
        max_backtracks: Halvings of a Newton step before it counts as failed.
    """

    rtol: Number = eqx.field(default=1e-8, metadata=key(""))
    max_steps: Count = 200
    max_steps_per_load: Count = 20
    smallest_load_step: Number = eqx.field(default=1e-3, metadata=key(""))
    strict_below: Number = 0.01
    max_backtracks: Count = 12

    def __check_init__(self):
        check_untraced("a number of NewtonSettings", self, "")
        if not 0.0 < self.rtol < 1.0:
            raise ValueError(f"rtol must lie in (0, 1), got {self.rtol}.")
        for name in ("max_steps", "max_steps_per_load", "max_backtracks"):
            if not 1 <= getattr(self, name) <= _MOST:
                raise ValueError(
                    f"{name} must lie between 1 and {_MOST}, got {getattr(self, name)}."
                )
        for name in ("smallest_load_step", "strict_below"):
            if not 0.0 < getattr(self, name) <= 1.0:
                raise ValueError(
                    f"{name} is a share of the load and must lie in (0, 1], got "
                    f"{getattr(self, name)}."
                )

    def as_arrays(self) -> "NewtonSettings":
        """Return the settings as arrays, so that one compiled program serves all."""
        whole = lambda value: np.issubdtype(np.result_type(value), np.integer)
        kind = lambda value: np.int32 if whole(value) else float
        host = jax.tree.map(lambda value: np.asarray(value, kind(value)), self)
        return jax.device_put(host)


class Iterate(NamedTuple):
    """State of Newton's method at a load.

    `strains` are those of the next step, unless `exact`; everything else, including the
    stopping rule, takes those of u, and so do the first step at a load and the one
    after held bodies moved, since a chord would crush what turns with them. `turned`:
    the last trial step inverted a tet. `merit_before` is the norm of the residual one
    step ago; inf before the first at this load, None if the line search always uses the
    potential. `step` counts those at this load.
    """

    point: Point
    lambda_a: Float[Array, " n_a"]
    strains: Strains
    exact: Bool[Array, ""]
    merit_before: Float[Array, ""] | None
    residual: Residual
    step: Int[Array, ""]
    n_negative: Int[Array, ""]
    singular: Bool[Array, ""]
    turned: Bool[Array, ""]
    converged: Bool[Array, ""]
    failed: Bool[Array, ""]

    def restarted(self, point: Point, lambda_a: Float[Array, " n_a"]) -> "Iterate":
        """Return the state before the first step from a point, at another load."""
        infinite = lambda merit: jnp.full_like(merit, jnp.inf)
        return self._replace(
            point=point,
            lambda_a=lambda_a,
            exact=jnp.ones((), bool),
            merit_before=jax.tree.map(infinite, self.merit_before),
            step=jnp.zeros_like(self.step),
        )


Iteration = Callable[[Posed, NewtonSettings, Iterate, Bool[Array, ""]], Iterate]
"""Does an iteration at the load of the first argument.

The last argument says whether only steps that lower Pi may be taken.
"""


def first_iterate(
    model: Model, point: Point, lambda_a: Float[Array, " n_a"]
) -> Iterate:
    """Return the state before any step."""
    zero, count, no = jnp.zeros(()), jnp.zeros((), jnp.int32), jnp.zeros((), bool)
    infinite = jnp.full_like(zero, jnp.inf)
    return Iterate(
        point=point,
        lambda_a=lambda_a,
        strains=no_strains(model),
        exact=~no,
        merit_before=_remembered(model, infinite),
        residual=Residual(infinite, zero),
        step=count,
        n_negative=count,
        singular=no,
        turned=no,
        converged=no,
        failed=no,
    )


def _remembered(model: Model, merit: Float[Array, ""]) -> Float[Array, ""] | None:
    if model.conservative and model.with_multiplier.size == 0:
        return None  # the line search uses the potential
    return merit


def _driven(model: Model) -> bool:
    """Tell whether motors drive the robot: then steps always take the strains of u.

    The parallel robot stands at its working point, but buckles on the way there, and
    predicted strains lead some of its poses to no equilibrium.
    """
    return any(body >= 0 for body in model.mechanism.actuators.motor_body)


def _astray(
    model: Model, point: Point, n_negative: Int[Array, ""], strict: Bool[Array, ""]
) -> Bool[Array, ""]:
    """Tell whether full steps may have left the load path, so the load is cut.

    They may have jumped to a saddle, shown by negative eigenvalues, or past an inverted
    tet, which some laws survive.
    """
    jumped = point.min_det_F <= 0.0
    if model.conservative:
        jumped = jumped | ((n_negative > 0) & ~strict)
    return jumped


def newton_iteration(
    posed: Posed, settings: NewtonSettings, s: Iterate, strict: Bool[Array, ""]
) -> Iterate:
    """Do a Newton iteration; `strict`: only steps that lower Pi are taken."""
    model, rtol, driven = posed.model, settings.rtol, _driven(posed.model)
    exact = driven or strict | s.exact
    direction = newton_direction(
        posed,
        s.point,
        s.lambda_a,
        strains=s.strains,
        exact=exact,
        tamed=jnp.where(s.step == 0, 2, (s.residual.size > NEAR).astype(jnp.int32)),
    )
    factor = direction.factor
    downhill = jnp.ones((), bool)
    if model.has_energy:  # otherwise it always descends the residual
        saddle = jnp.any(posed.by_multiplier)
        downhill = direction.moving | (direction.slope <= 0.0) | ~strict | saddle
    before = merit(posed, s.point, direction.step.lambda_a, factor.gap_stiffness)
    larger = jax.tree.map(lambda old: jnp.maximum(old, before), s.merit_before)
    most = settings.max_backtracks
    tried = line_search(
        posed, s.point, direction, strict=strict, reference=larger, backtracks=most
    )
    good = tried.good & factor.ok & downhill
    residual = relative(posed, tried.point, tried.merit, factor.stiffness)
    residual = residual._replace(size=jnp.where(good, residual.size, jnp.inf))
    new = s._replace(
        step=s.step + 1,
        n_negative=factor.n_negative,
        singular=~factor.ok,
        # A singular tangent gives no step; keep the flag of the step before.
        turned=jnp.where(factor.ok, tried.point.min_det_F <= 0.0, s.turned),
    )
    # A single step that converges, as in a strut under an axial force, leaves the
    # tangent of another state: factorize once more at this state without moving.
    near = before <= NEAR * jnp.linalg.norm(tried.point.force)
    near = (near & exact) | (factor.n_negative < 0)
    stay = s.residual.settled(rtol) & (new.step > 1)
    good, near = good | (stay & factor.ok), near | stay
    residual = select(stay, s.residual, residual)
    tried = select(stay, tried._replace(point=s.point, lambda_a=s.lambda_a), tried)
    u = s.point.u
    # Along straight lines, as the step foresaw: bodies turned meanwhile.
    du = posed.scatter(u, tried.share * direction.step.d)
    # Where the next step takes the strains of u, none are predicted.
    exact_next = direction.moving | (residual.size <= STRAIGHT)
    strains, sound = s.strains, jnp.ones((), bool)
    if not driven:
        strains, sound = jax.lax.cond(
            strict | exact_next,
            lambda: (strains, sound),
            lambda: predict(model, u, du, s.strains, s.exact),
        )
    good = good & sound
    moved = new._replace(
        point=tried.point,
        lambda_a=tried.lambda_a,
        merit_before=_remembered(model, before),
        residual=residual,
        strains=strains,
        exact=exact_next | ~sound,
    )
    settled = residual.settled(rtol)
    astray = settled & near & _astray(model, tried.point, factor.n_negative, strict)
    good, converged = good & ~astray, settled & near & ~astray
    # Go on while the residual still falls tenfold.
    closing = residual.size < 0.1 * s.residual.size
    out_of_steps = new.step >= settings.max_steps_per_load
    failed = ~good | (~settled & out_of_steps & ~closing)
    return select(good, moved, new)._replace(converged=converged, failed=failed)


def iteration_by(solver: "Solver", most: int) -> Iteration:
    """Return an iteration that finds the balance at a load by a solver of optimistix.

    It takes `most` steps to the root of the out-of-balance force, in units of the
    forces at its start, over the free unknowns, in units of the robot's size. What it
    finds counts by the rule of Newton's method, as an equilibrium or not, but it never
    counts if it is unstable: no such solver promises to lower Pi.
    """
    from optimistix import root_find

    def iteration(posed, settings, s, _):
        model, which = posed.model, posed.model.with_multiplier
        start, norm = posed.held_at(s.point.u), jnp.linalg.norm
        here, size = deform(posed, start), model.mechanism.bodies.length
        tangent = assemble(
            posed,
            here,
            s.lambda_a,
            mesh=tangent_values(model, start),
            active=taut(posed, here),
        )
        unit = jnp.maximum(norm(posed.load * posed.f_ext), norm(here.force))
        unit = jnp.maximum(unit, norm(tangent.g))
        unit = jnp.where(unit > 0.0, unit, tangent.stiffness * size)
        # Forces of actuators, and gaps, in the same units.
        row = norm(tangent.H_a, axis=(1, 2))
        row = jnp.maximum(row, jnp.finfo(row.dtype).tiny)
        stiffness = model.among_all(unit / size / row**2)

        def state(y):
            d = jnp.where(posed.fixed, 0.0, size * y[0])
            point = deform(posed, posed.swing(start, d))
            lambda_a = model.among_all(unit / row * y[1])
            to_go, active = gap(posed, point, lambda_a, stiffness)
            return point, jnp.where(active, lambda_a, 0.0), to_go, active

        def out_of_balance(y, _):
            point, lambda_a, to_go, active = state(y)
            g = posed.on_free(point.u, unbalanced(posed, point, lambda_a)[0]) / unit
            gaps = jnp.where(active[which], to_go[which] / size / row, y[1])
            return jnp.where(posed.fixed, y[0], g), gaps

        y = jnp.zeros(posed.fixed.shape), row / unit * s.lambda_a[which]
        root = root_find(out_of_balance, solver, y, max_steps=most, throw=False)
        (u, *_), lambda_a, *_ = state(root.value)
        point = evaluate(posed, u)
        factor = newton_direction(
            posed, point, lambda_a, strains=s.strains, exact=True, placed=True
        ).factor
        off = merit(posed, point, lambda_a, factor.gap_stiffness)
        residual = relative(posed, point, off, factor.stiffness)
        settled = residual.settled(settings.rtol) & point.finite & factor.ok
        good = settled & ~posed.passes_through(s.point.u, u) & ~posed.is_lost(u)
        no = jnp.zeros((), bool)
        good = good & ~_astray(model, point, factor.n_negative, strict=no)
        steps = jnp.asarray(root.stats["num_steps"], s.step.dtype)
        new = s._replace(
            step=s.step + steps,
            # Where it strayed, these tell of nothing.
            n_negative=jnp.where(settled, factor.n_negative, 0),
            singular=~factor.ok & point.finite,
            turned=point.min_det_F <= 0.0,
        )
        moved = new._replace(point=point, lambda_a=lambda_a, residual=residual)
        return select(good, moved, new)._replace(converged=good, failed=~good)

    return iteration


def check_solver(model: Model, solver: object) -> None:
    """Raise ValueError unless a solver can take the place of Newton's method."""
    import optimistix as optx

    kinds = optx.AbstractRootFinder, optx.AbstractLeastSquaresSolver
    if not isinstance(solver, (*kinds, optx.AbstractMinimiser)):
        raise ValueError(
            f"the solver is {solver!r}; expected one of optimistix, like "
            "optimistix.Newton(1e-10, 1e-10). (The sparse linear solver is an argument "
            "of build_model.)"
        )
    if model.conservative and not model.solver.counts_negative:
        raise ValueError(
            "a solver of optimistix may end in an unstable state, which "
            f"{model.solver.name} does not tell from a stable one: build the model "
            'with solver="pardiso", or leave the solver out.'
        )


def select(flag, new, old):
    return jax.tree.map(lambda a, b: jnp.where(flag, a, b), new, old)
