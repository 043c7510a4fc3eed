"""A configuration of a model at a share of its load, and its unknowns.

The unknowns are three per node and six per rigid body. A step d of them moves free
nodes by d, the nodes of a body by the exact rigid motion of its twist, and held nodes
and bodies to their imposed positions.
"""

from dataclasses import replace
from operator import attrgetter
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._typing import Array, Bool, Float, is_traced
from softcal_jax.bodies import (
    KINDS,
    BodyStateArrays,
    Frames,
    Mounted,
    rotation_matrix,
    winding,
)
from softcal_jax.configurations import (
    Configuration,
    ConfigurationArrays,
    configuration_arrays,
)
from softcal_jax.contact import Contacts, ContactState, Standing
from softcal_jax.equilibrium._assembly import gravity_load
from softcal_jax.equilibrium._model import Model, Nodal, check_fields
from softcal_jax.equilibrium._sparsity import element_entries, reduce_values
from softcal_jax.equilibrium._without_derivative import refuse_if, without_derivative

_FAR = 1e3
"""Displacement beyond which a body slides away, over the size of the robot [-]."""

_UNMOVED = 1e-12
"""Distance of a held body from its place that is rounding, per frame length [-]."""


_SPREAD = (
    "elastic supports, and loads by area or length, are shared out to the nodes where "
    "lanes are made, and do not follow points that are traced: take NodalForces, or "
    "points that are not traced, and make the lanes of the model that has them."
)


def _body_states(
    model: Model, configuration: ConfigurationArrays, mounted: Mounted
) -> BodyStateArrays:
    """Return how the configuration and its motors constrain the bodies.

    A motor holds its body at an imposed angle; a torque leaves it free on its hinge.
    """
    mechanism = model.mechanism
    state, actuation = configuration.bodies, configuration.actuation
    kind, rotation = jnp.asarray(state.kind), jnp.asarray(state.rotation)
    for a, body in enumerate(mechanism.actuators.motor_body):
        if body >= 0:
            by_angle = actuation.by_displacement[a]
            angle = actuation.value[a] + mechanism.motor_zero[a]
            motor_kind = jnp.where(by_angle, KINDS.index("held"), KINDS.index("hinged"))
            kind = kind.at[body].set(motor_kind.astype(kind.dtype))
            turned = jnp.where(by_angle, angle, 0.0) * mounted.axes[body, 2]
            rotation = rotation.at[body].set(turned)
    return replace(state, kind=kind, rotation=rotation)


def _arms_from_supports(
    model: Model, configuration: ConfigurationArrays, states: BodyStateArrays
) -> Float[Array, "n_b 3"]:
    """Return vectors from where the robot is held to the origins of bodies at rest [m].

    They begin at the mean of the supported nodes or, without any, at the mean of the
    origins of the other held bodies. The arm of a body that a motor turns is zero,
    since its axis stays.
    """
    bodies, points = model.mechanism.bodies, jnp.asarray(model.mechanism.points)
    held = jnp.any(jnp.asarray(configuration.fixed), axis=1)
    if configuration.springs.names:
        area = jnp.asarray(configuration.springs.area)
        held = held | jnp.any(area > 0.0, axis=(0, 2))

    def mean(points, chosen, otherwise):
        n = jnp.sum(chosen, axis=1, keepdims=True, dtype=points.dtype)
        total = jnp.sum(jnp.where(chosen[:, :, None], points[None], 0.0), axis=1)
        return jnp.where(n > 0.0, total / jnp.maximum(n, 1.0), otherwise)

    origin, itself = jnp.asarray(bodies.origin), jnp.eye(bodies.n_bodies, dtype=bool)
    fixed = (states.kind == KINDS.index("held")) & bodies.has_nodes
    others = fixed[None] & ~itself
    base = mean(points, held[None], mean(origin, others, origin))
    return jnp.where(turned_by_motors(model)[:, None], 0.0, origin - base)


def turned_by_motors(model: Model) -> Bool[Array, " n_b"]:
    mechanism = model.mechanism
    bodies = np.arange(mechanism.bodies.n_bodies)
    return jnp.asarray(np.isin(bodies, mechanism.actuators.motor_body))


class Posed(NamedTuple):
    """One configuration of a model under a share of its load; built by `of`.

    `f_ext` are dead loads and weight at full load [N]. `fixed` flags the unknowns that
    are not free: held, or of nodes that follow a body. Without bodies, their `states`
    (as constrained by configuration and motors), `arms` (for `winding`) [m] and
    `mounted` frames at this load are None. An `anchor` is a stiffness, with which
    every node of the mesh is drawn to a displacement [N/m, m].
    """

    model: Model
    configuration: ConfigurationArrays
    f_ext: Nodal
    fixed: Bool[Array, " n_dof"]
    load: Float[Array, ""]
    states: BodyStateArrays | None = None
    arms: Float[Array, "n_b 3"] | None = None
    mounted: Mounted | None = None
    anchor: tuple[Float[Array, ""], Nodal] | None = None

    @classmethod
    def of(cls, model: Model, configuration: ConfigurationArrays) -> "Posed":
        """Pose a model at full load; friction opposes the configuration's motion."""
        weight = gravity_load(model, configuration.acceleration)
        f_ext = configuration.dead_loads + weight
        if any(model.mechanism.actuators.has_friction):
            actuators = model.mechanism.actuators
            actuators = actuators.moving(configuration.actuation.releasing)
            model = eqx.tree_at(lambda m: m.mechanism.actuators, model, actuators)
        held = jnp.asarray(configuration.fixed)
        load, plan = jnp.ones((), f_ext.dtype), model.reduction
        if plan is None:
            return cls(model, configuration, f_ext, held.ravel(), load)
        frames = model.mechanism.bodies.mounted(load)
        states = _body_states(model, configuration, frames)
        frames = frames._replace(home=frames.home + states.translation_at(load))
        twists = model.mechanism.bodies.blocked(states)
        held = held.at[plan.rigid].set(True)
        fixed = jnp.concatenate([held.ravel(), twists.ravel()])
        arms = _arms_from_supports(model, configuration, states)
        return cls(model, configuration, f_ext, fixed, load, states, arms, frames)

    def at_load(self, load: Float[Array, ""]) -> "Posed":
        """Pose the configuration at another share of the load, on the way to full."""
        if self.states is None or self.arms is None:
            return self._replace(load=load)
        frames = self.model.mechanism.bodies.mounted(load)
        moved = jnp.asarray(self.states.translation)
        turned = jnp.asarray(self.states.rotation)
        wound = jax.vmap(winding, (0, 0, 0, None))(self.arms, moved, turned, load)
        # An obstacle without nodes bends nothing, and moves on a straight way.
        straight = ~self.model.mechanism.bodies.has_nodes[:, None]
        wound = jnp.where(straight, 0.0, wound)
        home = frames.home + self.states.translation_at(load) + wound
        return self._replace(load=load, mounted=frames._replace(home=home))

    @property
    def by_multiplier(self) -> Bool[Array, " n_a"]:
        """Flag the actuators with an imposed displacement, whose force is unknown."""
        model, actuation = self.model, self.configuration.actuation
        may_be = np.isin(np.arange(model.mechanism.n_actuators), model.with_multiplier)
        return jnp.asarray(actuation.by_displacement) & may_be

    def spring_force(self, u: Nodal) -> Nodal:
        """Compute the forces of the nodes on the springs of elastic supports [N]."""
        springs = self.configuration.springs
        if not springs.names:
            return jnp.zeros_like(u)
        stretch = u - self.load * jnp.asarray(springs.rest)
        force = springs.coefficients() * stretch
        if springs.tets.size == 0:
            return force
        nodes = jnp.asarray(self.model.mesh.tets)[jnp.asarray(springs.tets)]
        of_nodes = springs.between_nodes() * stretch[nodes][:, None]
        return force.at[nodes].add(jnp.sum(of_nodes, axis=2))

    def spring_tangent(self, values: Float[Array, " nnz"]) -> Float[Array, " nnz"]:
        """Add the springs to the tangent over all nodes [N/m]."""
        model, springs = self.model, self.configuration.springs
        if not springs.names:
            return values
        on_nodes = springs.coefficients().ravel()
        values = values.at[model.pattern.diagonal].add(on_nodes)
        if springs.tets.size == 0:
            return values
        p, q = element_entries(model.nodes.shape[1], model.pattern.symmetric)
        along = np.flatnonzero(p % 3 == q % 3)
        p, q = p[along], q[along]
        block, tet = jnp.divmod(jnp.asarray(springs.tets), model.nodes.shape[2])
        places = model.destination[block[:, None], along[None], tet[:, None]]
        entries = springs.between_nodes()[:, p // 3, q // 3, p % 3]
        return values.at[places].add(entries)

    def spring_energy(self, u: Nodal) -> Float[Array, ""]:
        stretch = u - self.load * jnp.asarray(self.configuration.springs.rest)
        return 0.5 * jnp.sum(self.spring_force(u) * stretch)

    def anchor_force(self, u: Nodal) -> Nodal:
        """Compute the forces of the nodes on the anchor [N]."""
        if self.anchor is None:
            return jnp.zeros_like(u)
        (stiffness, place), n = self.anchor, self.model.mesh.n_nodes
        return (stiffness * (u - place)).at[n:].set(0.0)

    def anchor_energy(self, u: Nodal) -> Float[Array, ""]:
        if self.anchor is None:
            return jnp.zeros(())
        return 0.5 * jnp.sum(self.anchor_force(u) * (u - self.anchor[1]))

    @property
    def contacts(self) -> Contacts:
        return self.model.mechanism.contacts

    @property
    def standing(self) -> Standing:
        """How the obstacles stand."""
        if self.states is None:
            return Standing(jnp.zeros(0, bool), jnp.zeros((0, 4, 3)))
        earlier = map(self.model.positions, jnp.asarray(self.configuration.stages))
        stages = zip(earlier, jnp.asarray(self.configuration.is_stage), strict=True)
        standing = self.model.mechanism.standing(self.states)
        return standing._replace(stages=tuple(stages))

    def contact(self, u: Nodal) -> tuple[Float[Array, ""], Nodal, Nodal | None]:
        """Compute energy and forces of contact on the nodes, and friction [J, N].

        Friction is among the forces; None without any.
        """
        if not self.contacts.can_touch:
            return jnp.zeros(()), jnp.zeros_like(u), None
        x = self.model.positions(u)
        return self.contacts.energy_and_force(x, self.standing)

    def contact_tangent(
        self, u: Nodal, values: Float[Array, " nnz"], *, tamed
    ) -> Float[Array, " nnz"]:
        """Add contact to the tangent over all nodes, see `Contacts.tangents` [N/m]."""
        if not self.contacts.can_touch:
            return values
        x, symmetric = self.model.positions(u), self.model.pattern.symmetric
        all_at = self.model.contact_at

        def add(values, matrices, places):
            p, q = element_entries(matrices.shape[1] // 3, symmetric)
            return values.at[places].add(matrices[:, p, q].T)

        stiffness = self.contacts.tangents(x, self.standing, tamed=tamed)
        for matrices, at in zip(stiffness, all_at, strict=False):
            values = add(values, matrices, at)
        of_pairs = lambda v, K, which: add(v, K, jnp.asarray(all_at[-1])[:, which])
        return self.contacts.add_touching(x, values, of_pairs, tamed=tamed)

    def contact_states(self, u: Nodal) -> tuple[ContactState, ...]:
        """Compute what each obstacle feels, then each surface that may be touched."""
        if not self.contacts.can_touch:
            return ()
        states = self.contacts.states(self.model.positions(u), self.standing)
        none = lambda c, value: without_derivative(value, jnp.sum(c.force))
        return tuple(
            replace(c, area=none(c, c.area), sliding=none(c, c.sliding)) for c in states
        )

    def passes_through(self, before: Nodal, after: Nodal) -> Bool[Array, ""]:
        """Tell whether the surface comes too deep into what it meets on its way."""
        if not self.contacts.can_touch:
            return jnp.zeros((), bool)
        x, y = self.model.positions(before), self.model.positions(after)
        return self.contacts.passes_through(x, y, self.standing)

    def is_lost(self, u: Nodal) -> Bool[Array, ""]:
        """Tell whether a body slid so far away that rounding lets it balance."""
        if not any(self.contacts.sticks) and self.anchor is None:
            return jnp.zeros((), bool)
        return jnp.max(jnp.abs(u)) > _FAR * self.model.mechanism.bodies.length

    def gather(self, u: Nodal, forces: Nodal) -> Float[Array, " n_dof"]:
        """Gather forces on all nodes at u into forces on the unknowns, G^T f [N].

        Nodes that follow a body keep their forces too, although they are no unknowns.
        """
        plan = self.model.reduction
        if plan is None:
            return forces.ravel()
        on_bodies = jnp.sum(self._follow(u) * forces[plan.rigid][:, :, None], axis=1)
        n_b = self.model.mechanism.bodies.n_bodies
        wrench = jax.ops.segment_sum(on_bodies, jnp.asarray(plan.owner), n_b)
        return jnp.concatenate([forces.ravel(), wrench.ravel()])

    def on_free(self, u: Nodal, forces: Nodal) -> Float[Array, " n_dof"]:
        return jnp.where(self.fixed, 0.0, self.gather(u, forces))

    def scatter(self, u: Nodal, d: Float[Array, " n_dof"]) -> Nodal:
        """Spread a small step of the unknowns over all nodes, G d [m]."""
        plan = self.model.reduction
        if plan is None:
            return d.reshape(u.shape)
        free, twists = d[: u.size].reshape(u.shape), d[u.size :].reshape(-1, 6)
        along = jnp.sum(self._follow(u) * twists[plan.owner][:, None, :], axis=2)
        return free.at[plan.rigid].set(along, unique_indices=True)

    def rigid(self, u: Nodal) -> Nodal:
        """Make every body of a guess rigid again, as its frame is placed [m]."""
        if self.model.reduction is None:
            return u
        return self._with_bodies(u, self.model.frames(u))

    def move(self, u: Nodal, d: Float[Array, " n_dof"]) -> Nodal:
        """Apply a step of the unknowns to a displacement; bodies move rigidly [m].

        Held bodies go to their imposed pose at this load; the step of supported nodes
        is already part of d.
        """
        if self.states is None or self.mounted is None:
            return u + d.reshape(u.shape)
        bodies = self.model.mechanism.bodies
        twists = d[u.size :].reshape(-1, 6)
        frames = bodies.place(self.states, self.mounted, self.model.frames(u), twists)
        return self._with_bodies(u + d[: u.size].reshape(u.shape), frames)

    def swing(self, u: Nodal, d: Float[Array, " n_dof"]) -> Nodal:
        """Do as `move`, but rotate a robot that only hangs on one hinge as a whole.

        In `move`, free nodes follow a rotation of the hinge along straight lines, which
        costs stiff parts far more energy than weight and torque supply.
        """
        if self.states is None or self.mounted is None:
            return self.move(u, d)
        bodies, points = self.model.mechanism.bodies, self.model.mechanism.points
        kind = self.states.kind
        untied = bodies.owner == jnp.arange(bodies.n_bodies, dtype=jnp.int32)
        hinged = untied & (kind == KINDS.index("hinged"))
        held = jnp.any(untied & (kind == KINDS.index("held")))
        alone = (jnp.sum(hinged) == 1) & ~held & ~jnp.any(self.configuration.fixed)
        alone = alone & ~jnp.any(jnp.asarray(self.configuration.springs.area) > 0.0)
        k = jnp.argmax(hinged)
        axes, origins = self.mounted.axes, self.model.frames(u).origin
        twists = d[u.size :].reshape(-1, 6)
        turn = jnp.where(alone, twists[k, 5] / bodies.length, 0.0) * axes[k, 2]
        along = lambda v: jnp.sum(axes * v[:, None], axis=2)
        of_bodies = along(jnp.cross(turn[None], origins - origins[k][None]))
        angles = bodies.length * along(jnp.broadcast_to(turn[None], origins.shape))
        turned = jnp.concatenate([of_bodies, angles], axis=1)
        straight = jnp.cross(turn[None], points + u - origins[k][None])
        rest = jnp.concatenate([straight.ravel(), turned.ravel()])
        v = self.move(u, d - rest)
        arms = points + v
        centre = arms[self.model.mesh.n_nodes + 4 * k][None]
        around = centre + (arms - centre) @ rotation_matrix(turn).T - points
        return jnp.where(alone, around, v)

    def imposed(self, u: Nodal) -> Nodal:
        """Return the remaining motion of held nodes to their imposed positions [m]."""
        return self.motion(u, self.held_at(u))

    def motion(self, u: Nodal, target: Nodal) -> Nodal:
        """Return target - u, without the rounding of nodes that follow a body [m]."""
        gap, plan = target - u, self.model.reduction
        if plan is None:
            return gap
        far = gap[plan.rigid]
        rounding = _UNMOVED * self.model.mechanism.bodies.length
        return gap.at[plan.rigid].set(jnp.where(jnp.abs(far) > rounding, far, 0.0))

    def held_at(self, u: Nodal) -> Nodal:
        """Move held nodes and bodies to their imposed positions, no others [m]."""
        held = jnp.asarray(self.configuration.fixed)
        target = self.load * jnp.asarray(self.configuration.imposed)
        placed = jnp.where(held, target, u)
        if self.model.reduction is None:
            return placed
        return self.move(placed, jnp.zeros(u.size + 6 * self._n_bodies))

    def reduce(
        self, u: Nodal, values: Float[Array, " nnz"], unbalanced: Nodal
    ) -> Float[Array, " nnz_reduced"]:
        """Reduce the tangent over all nodes to the unknowns [N/m].

        The out-of-balance forces on the nodes of a body keep their direction as it
        rotates, so their moment changes.
        """
        plan = self.model.reduction
        if plan is None:
            return values
        turning = self._geometric(u, unbalanced)
        return reduce_values(plan, values, self._follow(u), turning)

    @property
    def _n_bodies(self) -> int:
        return self.model.mechanism.bodies.n_bodies

    def _with_bodies(self, u: Nodal, frames: Frames):
        bodies, n_nodes = self.model.mechanism.bodies, self.model.mesh.n_nodes
        points = jnp.asarray(self.model.mechanism.points)
        ends = bodies.frame_nodes(frames)
        attached = jnp.sum(bodies.weights[:, :, None] * ends[bodies.body], axis=1)
        u = jnp.concatenate([u[:n_nodes], ends.reshape(-1, 3) - points[n_nodes:]])
        moved = attached - points[bodies.attached]
        return u.at[bodies.attached].set(moved, unique_indices=True)

    def _arms(self, u: Nodal) -> Float[Array, "n_rigid 3"]:
        """Return the vectors from the owning body's origin to each rigid node [m]."""
        plan = self.model.reduction
        assert plan is not None
        x = self.model.positions(u)
        origins = x[self.model.mesh.n_nodes :: 4]
        return x[plan.rigid] - origins[plan.owner]

    def _follow(self, u: Nodal) -> Float[Array, "n_rigid 3 6"]:
        """Return G: motion of rigid nodes per unit twist of their bodies [-]."""
        plan, bodies = self.model.reduction, self.model.mechanism.bodies
        assert plan is not None
        assert self.mounted is not None
        axes = self.mounted.axes[plan.owner]
        arms = self._arms(u) / bodies.length
        # w x r for the three axes w.
        turns = jnp.cross(axes, jnp.broadcast_to(arms[:, None], axes.shape))
        return jnp.swapaxes(jnp.concatenate([axes, turns], axis=1), 1, 2)

    def _geometric(self, u, unbalanced) -> Float[Array, "n_b 6 6"]:
        """Return second derivatives of the forces' work by the twists.

        For x(w) = exp(hat(w)) r and a force g: sym(g r^T) - (g . r) I at w = 0.
        """
        plan, bodies = self.model.reduction, self.model.mechanism.bodies
        assert plan is not None
        assert self.mounted is not None
        r, g = self._arms(u), unbalanced[plan.rigid]
        both = 0.5 * (g[:, :, None] * r[:, None] + r[:, :, None] * g[:, None])
        work = jnp.sum(g * r, axis=1)
        blocks = both - work[:, None, None] * jnp.eye(3)[None]
        total = jax.ops.segment_sum(blocks, jnp.asarray(plan.owner), self._n_bodies)
        B = self.mounted.axes / bodies.length
        turned = jnp.einsum("bij,bjk,blk->bil", B, total, B)
        return jnp.zeros((self._n_bodies, 6, 6)).at[:, 3:, 3:].set(turned)


def check_lane(model: Model, lane: ConfigurationArrays) -> None:
    """Raise ValueError unless actuators and shapes are those of the model."""
    names, ours = lane.actuation.names, model.mechanism.actuators.names
    if names != ours:
        raise ValueError(
            f"the configuration is of a model with the actuators {list(names)}; this "
            f"one has {list(ours)}. Make it by lanes(model, poses) of this model."
        )
    n, of_bodies = (model.n_points, 3), (model.mechanism.bodies.n_bodies, 3)
    shapes = dict.fromkeys(("bodies.translation", "bodies.rotation"), of_bodies)
    shapes |= {"imposed": n, "loads.force": (len(lane.loads.names), *n)}
    shapes |= {"springs.rest": n, "gravity": (3,), "actuation.value": (len(ours),)}
    for leaf, shape in shapes.items():
        if (got := np.shape(attrgetter(leaf)(lane))) != shape:
            raise ValueError(
                f"{leaf} of the configuration has the shape {got}; expected {shape}, "
                "as lanes(model, poses) makes it."
            )
    check_fields(model.law, model.n_tets, model.density)


def one_lane(model: Model, configuration: Any) -> ConfigurationArrays:
    """Return the arrays of one configuration of this model, or raise ValueError."""
    model.mechanism.check_on(model.mesh)
    if isinstance(configuration, Configuration):
        of_mesh = model.mesh, [configuration], model.mechanism
        return configuration_arrays(*of_mesh)[0]
    if not isinstance(configuration, ConfigurationArrays):
        raise ValueError(
            f"expected one Configuration or a lane of lanes(model, poses), got a "
            f"{type(configuration).__name__}."
        )
    if configuration.is_batch:
        raise ValueError(
            f"this is a batch of {len(configuration)} configurations, and one is "
            "wanted: take one, batch[0], or all of them by "
            "jax.vmap(lambda lane: ...)(batch)."
        )
    if (n := len(configuration.fixed)) != model.n_points:
        raise ValueError(
            f"the configuration is of a mesh with {n} nodes, those of the frames of "
            f"rigid bodies included; the model has {model.n_points}. Make it by "
            "lanes(model, poses)."
        )
    check_lane(model, configuration)
    if not is_traced(configuration.after) and np.asarray(configuration.after):
        raise ValueError(
            "the configuration comes after another one, whose equilibrium is not "
            "known here: solve that first, and make this one by "
            "lane.following(earlier_lane, solution.displacement)."
        )
    if not model.moved:
        return configuration
    return refuse_if(configuration, configuration.is_spread, _SPREAD)
