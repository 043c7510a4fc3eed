"""One configuration while it is solved: energy, residual, tangent, Newton direction."""

from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp

from softcal_jax._typing import Array, Bool, Float, HostArray, Int
from softcal_jax.bodies import KINDS
from softcal_jax.configurations import ConfigurationArrays
from softcal_jax.equilibrium import _actuation as actuation
from softcal_jax.equilibrium._assembly import (
    energy_and_force,
    gravity_load,
    mixed_tangent,
    predicted_dilatation,
    tangent_values,
)
from softcal_jax.equilibrium._element import is_mixed
from softcal_jax.equilibrium._model import Model
from softcal_jax.equilibrium._unknowns import Unknowns, body_states

_LARGEST_TURN = 0.5
"""Turn of a body on a hinge beyond which a Newton step says nothing [rad]."""

_TAUT = 1e-6
"""Slack of a cable, in sizes of the mesh, that may still be rounding of a taut one."""


def external_force(
    model: Model, configuration: ConfigurationArrays
) -> Float[Array, "n_points 3"]:
    """Dead loads and weight as nodal forces, f_ext(p) [N]."""
    return configuration.dead_loads + gravity_load(model, configuration.acceleration)


def product(sparsity, values, v):
    """K v, for a K kept as its pattern says."""
    rows, cols = sparsity.rows, sparsity.indices
    if not sparsity.symmetric:
        return jnp.zeros_like(v).at[rows].add(values * v[cols])
    lower = jnp.where(rows == cols, 0.0, values)
    upper = jnp.zeros_like(v).at[rows].add(values * v[cols])
    return upper.at[cols].add(lower * v[rows])


def mask_supports(sparsity, values, fixed):
    """Tangent whose supported rows and columns are those of the identity, scaled."""
    held = fixed[sparsity.rows] | fixed[sparsity.indices]
    diagonal = values[sparsity.diagonal]
    # The mean stiffness, not 1, keeps the matrix well scaled in any unit.
    scale = jnp.mean(jnp.abs(diagonal))
    on_diagonal = jnp.where(fixed, scale, diagonal)
    return jnp.where(held, 0.0, values).at[sparsity.diagonal].set(on_diagonal), scale


class Point(NamedTuple):
    """What is evaluated at a displacement.

    Attributes:
        u: The displacement [m].
        energy: Strain energy [J].
        energy_scale: Sum of its absolute parts, the scale of its rounding [J].
        force: Internal force [N].
        delta_a: Displacements of the actuators.
        min_det_F: Smallest det F [-].
    """

    u: Float[Array, "n_points 3"]
    energy: Float[Array, ""]
    energy_scale: Float[Array, ""]
    force: Float[Array, "n_points 3"]
    delta_a: Float[Array, " n_a"]
    min_det_F: Float[Array, ""]

    @property
    def finite(self) -> Bool[Array, ""]:
        """Whether energy and force are numbers."""
        return jnp.isfinite(self.energy) & jnp.all(jnp.isfinite(self.force))


def evaluate(model: Model, u: Float[Array, "n_points 3"]) -> Point:
    """Energy, force and displacements of the actuators at a displacement."""
    energy, scale, force, det = energy_and_force(model, u)
    return Point(u, energy, scale, force, actuation.displacements(model, u), det)


class Direction(NamedTuple):
    """A Newton step, and what its factorization told.

    Attributes:
        d: Step of the unknowns, held ones included [m].
        lambda_a: Forces before the step of actuators whose displacement is imposed; a
            cable found to be slack has none.
        d_lambda: Their step.
        slope: Out-of-balance force times the step [J].
        moving: Whether something held still has to move.
        reach: Longest share of the step that is worth trying [-].
        stiffness: Mean stiffness of an unknown [N/m].
        gap_stiffness: Force per displacement of each actuator whose displacement is
            imposed.
        n_negative: Negative eigenvalues, see `Bordered`.
        ok: Whether the step exists.
        system: The matrix.
    """

    d: Float[Array, " n_dof"]
    lambda_a: Float[Array, " n_a"]
    d_lambda: Float[Array, " n_a"]
    slope: Float[Array, ""]
    moving: Bool[Array, ""]
    reach: Float[Array, ""]
    stiffness: Float[Array, ""]
    gap_stiffness: Float[Array, " n_a"]
    n_negative: Array
    ok: Bool[Array, ""]
    system: actuation.System


@dataclass(frozen=True, eq=False)  # JAX caches its methods by identity
class EquilibriumProblem:
    """One configuration while it is solved: the parts of a Newton iteration.

    Attributes:
        model: The model.
        configuration: The configuration.
        f_ext: Its external forces [N].
        rtol: Relative residual at which Newton stops [-].
    """

    model: Model
    configuration: ConfigurationArrays
    f_ext: Float[Array, "n_points 3"]
    rtol: float

    @property
    def mixed(self) -> bool:
        """Whether the volume ratios are unknowns of the Newton step."""
        return is_mixed(self.model.formulation, self.model.weights.shape[1])

    @property
    def has_multipliers(self) -> bool:
        """Whether forces of actuators may have to be solved for."""
        return self.with_multiplier.size > 0

    @property
    def with_multiplier(self) -> Int[HostArray, " n_m"]:
        """Numbers of these actuators."""
        return actuation.with_multiplier(self.model)

    def by_multiplier(self) -> Bool[Array, " n_a"]:
        """Which actuators have a displacement imposed, and their force solved for."""
        return actuation.by_multiplier(self.model, self.configuration.actuation)

    def unknowns(self, load: Float[Array, ""]) -> Unknowns:
        """The unknowns at a share of the load."""
        return Unknowns(self.model, self.configuration, load)

    def all_forces(self, lambda_a, load) -> Float[Array, " n_a"]:
        """Forces of all actuators at a share of the load."""
        imposed = self.configuration.actuation.forces
        return jnp.where(self.by_multiplier(), lambda_a, load * imposed)

    def dilatation(self, theta, u, du):
        """Volume ratios after a step; nothing to do in the displacement formulation."""
        return predicted_dilatation(self.model, u, du) if self.mixed else theta

    def unbalanced(self, at: Point, lambda_a, load):
        """Out-of-balance forces g on all nodes, and rows H_a of the actuators [N]."""
        rows = actuation.rows(self.model, at.u)
        forces = self.all_forces(lambda_a, load)
        g = at.force - load * self.f_ext
        if len(forces) > 0:
            g = g - jnp.sum(forces[:, None, None] * rows, axis=0)
        return g, rows

    def on_unknowns(self, u, load, forces):
        """Forces on the unknowns that are free, 0 on the others [N]."""
        unknowns = self.unknowns(load)
        return jnp.where(unknowns.fixed(), 0.0, unknowns.gather(u, forces))

    def rows_on_unknowns(self, u, load, rows):
        """H_a on the free unknowns."""
        n_dof = self.model.n_dof
        if rows.shape[0] == 0:
            return jnp.zeros((0, n_dof), rows.dtype)
        return jax.vmap(lambda row: self.on_unknowns(u, load, row))(rows)

    def gap(self, at: Point, lambda_a, load, stiffness):
        """How far imposed displacements have to go, 0 where a cable is slack.

        Args:
            at: The point.
            lambda_a: Forces of the actuators.
            load: Share of the load [-].
            stiffness: Force that a unit of gap is worth, to tell slack from taut.

        Returns:
            The gaps, and which actuators act.
        """
        wanted = load * jnp.asarray(self.configuration.actuation.value)
        gap = wanted - at.delta_a
        unilateral = jnp.asarray(self.model.mechanism.actuators.unilateral)
        taut = lambda_a + stiffness * gap > 0.0
        active = self.by_multiplier() & (taut | ~unilateral)
        return jnp.where(active, gap, 0.0), active

    def direction(
        self, at: Point, theta, lambda_a, load, strict, before=None
    ) -> Direction:
        """Newton step at a share of the load.

        Args:
            at: The point.
            theta: Volume ratios in the mixed formulation.
            lambda_a: Forces of the actuators.
            load: Share of the load [-].
            strict: Whether only steps that lower the potential are taken.
            before: Displacement where a step to the point began, if its tangent shall
                have the stress that the step foresaw; see `tangent_values` [m].
        """
        model, u = self.model, at.u
        unknowns = self.unknowns(load)
        fixed = unknowns.fixed()
        held_step = unknowns.imposed(u)
        moving = jnp.any(held_step != 0.0)
        gap, active = self.gap(at, lambda_a, load, jnp.ones(()))
        # The force of a slack cable is gone before the step.
        lambda_a = jnp.where(active, lambda_a, 0.0)
        if self.mixed:
            at_u = self.dilatation(theta, u, jnp.zeros_like(u))
            theta = jnp.where(strict, at_u, theta)
            values, force = mixed_tangent(model, u, theta)
        else:
            values, force = tangent_values(model, u, before), at.force
        g, rows = self.unbalanced(at, lambda_a, load)
        values = actuation.add_curvature(
            model, values, u, self.all_forces(lambda_a, load)
        )
        # What is held and still has to move pulls on the rest: - K du_held.
        pull = jax.lax.cond(
            moving,
            lambda: product(model.pattern, values, held_step.ravel()),
            lambda: jnp.zeros_like(held_step.ravel()),
        )
        reduced = unknowns.reduce(u, values, g)
        masked, stiffness = mask_supports(model.solver.sparsity, reduced, fixed)
        g_newton = g + (force - at.force)
        rhs = -unknowns.gather(u, g_newton + pull.reshape(u.shape))
        which = self.with_multiplier
        H_a = self.rows_on_unknowns(u, load, rows[which])
        on_held = jnp.sum(rows[which] * held_step[None], axis=(1, 2))
        system = actuation.System(masked, H_a, active[which])
        rhs = jnp.where(fixed, 0.0, rhs)
        solved = system.solve(model, rhs[None], (gap[which] - on_held)[None])
        d = solved.x[0]
        slope = jnp.sum(self.on_unknowns(u, load, g) * d)
        supports = jnp.where(jnp.asarray(self.configuration.fixed), held_step, 0.0)
        sign, reach = self._on_hinges(d[u.size :], slope, moving)
        d = (sign * d).at[: u.size].add(supports.ravel())
        compliance = jnp.abs(jnp.diag(solved.W_aa))
        tiny = jnp.finfo(u.dtype).tiny
        # Of slack cables, too: a step that tightens one leaves a gap to close.
        stiff = actuation.among_all(model, 1.0 / jnp.maximum(compliance, tiny))
        gap_stiffness = jnp.where(self.by_multiplier(), stiff, 0.0)
        return Direction(
            d,
            lambda_a,
            sign * actuation.among_all(model, solved.lambda_a[0]),
            sign * slope,
            moving,
            reach,
            stiffness,
            gap_stiffness,
            solved.n_negative,
            solved.ok,
            system,
        )

    def _on_hinges(self, twists, slope, moving):
        """Sign of a step, and its reach, where a body turns freely on a hinge.

        Nothing but weight and a torque may hold it: what is stiff against its turn is
        next to nothing at rest, and of either sign. Newton's step then turns it many
        times round, or up to where it balances on its head.
        """
        one = jnp.ones(())
        if self.model.reduction is None:
            return one, one
        bodies = self.model.mechanism.bodies
        kind = body_states(self.model, self.configuration).kind
        hinged = (kind == KINDS.index("hinged")) & ~moving
        turns = jnp.abs(twists.reshape(-1, 6)[:, 5]) / bodies.length
        largest = jnp.max(jnp.where(hinged, turns, 0.0))
        uphill = jnp.any(hinged) & (slope > 0.0) & ~jnp.any(self.by_multiplier())
        uphill = uphill & self.model.conservative
        reach = _LARGEST_TURN / jnp.maximum(largest, _LARGEST_TURN)
        return jnp.where(uphill, -one, one), reach

    def taut(self, at: Point, load) -> Bool[Array, " n_a"]:
        """Which imposed displacements act at an equilibrium: all but slack cables'."""
        actuators = self.model.mechanism.actuators
        wanted = load * jnp.asarray(self.configuration.actuation.value)
        short = wanted - at.delta_a >= -_TAUT * self.model.mechanism.bodies.length
        return self.by_multiplier() & (short | ~jnp.asarray(actuators.unilateral))

    def estimated_forces(self, at: Point, load) -> Float[Array, " n_a"]:
        """Forces of actuators whose displacement is imposed, from the balance of all.

        Exact at equilibrium, where a slack cable has none.
        """
        g, rows = self.unbalanced(at, jnp.zeros_like(at.delta_a), load)
        return actuation.estimated_forces(
            self.rows_on_unknowns(at.u, load, rows),
            self.taut(at, load),
            self.on_unknowns(at.u, load, g),
        )

    def merit(self, at: Point, lambda_a, load, gap_stiffness) -> Float[Array, ""]:
        """Norm of the out-of-balance forces, gaps by the force they need [N]."""
        g, _ = self.unbalanced(at, lambda_a, load)
        g = self.on_unknowns(at.u, load, g)
        gap, _ = self.gap(at, lambda_a, load, gap_stiffness)
        return jnp.sqrt(jnp.sum(g**2) + jnp.sum((gap_stiffness * gap) ** 2))

    def relative(self, merit, at: Point, lambda_a, load, stiffness):
        """A merit relative to the largest of external, internal and actuator force."""
        points = jnp.asarray(self.model.mechanism.points)
        size = jnp.maximum(jnp.max(jnp.ptp(points, axis=0)), jnp.max(jnp.abs(at.u)))
        norm = jnp.linalg.norm
        scale = jnp.maximum(norm(load * self.f_ext), norm(at.force))
        # Without any load, what remains is the rounding of each unknown's displacement,
        # which a robot that is turned as a whole has, too.
        eps = jnp.finfo(points.dtype).eps
        n_dof = self.model.n_dof
        rounding = eps / self.rtol * stiffness * size * n_dof**0.5
        return merit / jnp.maximum(scale, rounding)
