"""Contact of the surface of the body with obstacles and itself, with friction.

Each quadrature point of the faces of the body, with the area A at rest and the distance
g from an obstacle, adds A E phi(d) to the potential energy, where d = s / 2 - g is how
far it has come into a cushion on the obstacle. With the scale s,

    phi(d) = d^3 / (12 s^2)                      where 0 < d < 2 s,
             d^2 / (2 s) - d + 2 s / 3           where d >= 2 s,

and p = E phi'(d) is the pressure: E / 16 where surfaces coincide, 0.56 E at the depth
s. It is a penalty that is linear in depth, with a smooth onset so that the tangent is
continuous (compare Wriggers, Computational Contact Mechanics, 2006, ch. 6 and 10). The
usual pressures of soft bodies are about that at g = 0, and the error is in proportion
to s. Friction adds a shear along the surface against the slip w, the way along it
since the point came in touch:

    tau = mu p h(x) w / |w|,  x = |w| / (c mu s),
    h(x) = x - x^2 / 4 where x < 2, and 1 where x >= 2.

So a point sticks, up to a slip of 2 c mu s with c = `STICK`, and slides where that does
not hold it (the smooth step of Li and others, ACM Trans. Graph. 39, 2020, over the slip
in place of its rate). Shear has no potential, so that a model with friction is not
`conservative`. Slip is counted once for the whole load, along a straight way in the
frame of the obstacle, and its shear by the pressure at the end. A configuration that
begins where another ends keeps what that left: a point in touch counts its slip from
where it stuck last, so that its shear is that of before (the return mapping of
Wriggers, ch. 10, with one step from an equilibrium to the next). What reverses or
turns far within such a step is not followed.
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._module import Module
from softcal_jax._typing import Array, Bool, Float, HostArray, Int
from softcal_jax.contact._cushion import (
    cushion,
    cushion_pressure,
    mean_over_faces,
    tamed_pressure,
)
from softcal_jax.contact._facing import face_size
from softcal_jax.contact._shapes import AbstractShape
from softcal_jax.contact._touching import Touching
from softcal_jax.elements import vector_length
from softcal_jax.mesh import TetMesh, boundary_faces, face_areas

BLOCK = 16  # faces whose tangents are computed together, where one of them is touched

_SAMPLES = 8  # states on the way of a step at which points are looked for inside

STICK = 1.0 / 3.0
"""Slip at which friction would balance the pressure if it went on growing, over the
scale of contact and the coefficient of friction [-]."""

FINE = 0.005
"""Scale of contact, relative to the mean size of the faces of the body [-]."""


class Obstacle(NamedTuple):
    """What is needed of a rigid body with a shape: see `bodies.RigidBody`."""

    body: int
    name: str
    shape: AbstractShape
    friction: float
    nodes: Int[HostArray, " n"]


class Standing(NamedTuple):
    """How the obstacles of a configuration stand.

    Attributes:
        present: Which obstacles are there.
        start: Nodes of the frame of each before the load [m].
        stages: Positions of all nodes at earlier equilibria, in order [m], and whether
            each of them was there.
    """

    present: Bool[Array, " n_obstacles"]
    start: Float[Array, "n_obstacles 4 3"]
    stages: tuple[tuple[Float[Array, "n_points 3"], Bool[Array, ""]], ...] = ()


class ContactState(Module):
    """What an obstacle feels, or a surface of the body of another that it touches.

    Area and sliding share count whole quadrature points: their derivative is nan.

    Attributes:
        force: Force of the robot on it [N].
        moment: Its moment about the origin of the frame of the obstacle, or of the
            mesh [N m].
        area: Area at rest of the surface that presses on it [m2].
        depth: How deep the surface lies in it at most [m].
        sliding: Share of the area that slides against friction [-].
        pressure: Mean pressure on each of `Contacts.faces_of` it, by area at rest [Pa].
    """

    name: str = eqx.field(static=True)
    force: Float[Array | HostArray, "3"]
    moment: Float[Array | HostArray, "3"]
    area: float | Float[Array, ""]
    depth: float | Float[Array, ""]
    sliding: float | Float[Array, ""]
    pressure: Float[Array | HostArray, " n_faces"]


def _pressure_of(tamed: int | Int[Array, ""]) -> Callable[[Array, Array], Array]:
    if isinstance(tamed, int) and tamed == 0:
        return cushion_pressure  # which has a derivative by the scale, too
    return partial(tamed_pressure, jnp.where(jnp.asarray(tamed) > 0, 1.0, jnp.inf))


class _Touch(NamedTuple):
    """How points touch an obstacle, in its frame.

    `depth` is how far they have come into the cushion [m], and `slip` how far they
    slip, where they slide from 2 on [-]. `push` is the gradient of the potential by
    their place, over A E, and `shear` what friction adds to it [-].
    """

    depth: Float[Array, ""]
    slip: Float[Array, ""]
    push: Float[Array, "3"]
    shear: Float[Array, "3"]


class Contacts(Module):
    """The faces of the body, and the obstacles that they may touch.

    Points of a face are its quadrature points. Faces are padded to whole blocks.

    Attributes:
        faces: Nodes of the faces; only there if there are obstacles.
        areas: Area of each point at rest; zero where an obstacle holds the face [m2].
        shape_functions: Those of a face at its points [-].
        rest: Positions of all nodes at rest [m].
        frames: Nodes of the frame of each obstacle.
        length: Length of its axes [m].
        depth: How deep a point may come into each obstacle [m].
        stiffness: The modulus E of the pressure [Pa].
        scale: The length s; surfaces feel each other at half of it [m].
        body: Index of the rigid body of each of them.
        friction: Coefficient of friction of each [-].
        sticks: Whether it has friction; else points slide freely.
        touching: Surfaces of the body that may touch each other; None without any.
    """

    faces: Int[HostArray, "n_faces n_fn"]
    areas: Float[HostArray, "n_obstacles n_faces n_qp"]
    shape_functions: Float[HostArray, "n_qp n_fn"]
    rest: Float[HostArray, "n_points 3"]
    frames: Int[HostArray, "n_obstacles 4"]
    length: Float[HostArray, ""]
    depth: Float[HostArray, " n_obstacles"]
    stiffness: Float[Array, ""]
    scale: Float[Array, ""]
    shapes: tuple[AbstractShape, ...]
    friction: Float[HostArray, " n_obstacles"]
    touching: Touching | None
    body: tuple[int, ...] = eqx.field(static=True)
    sticks: tuple[bool, ...] = eqx.field(static=True)
    names: tuple[str, ...] = eqx.field(static=True)

    @property
    def n_obstacles(self) -> int:
        return len(self.body)

    @property
    def can_touch(self) -> bool:
        """Whether there is anything that the body may touch."""
        return self.n_obstacles > 0 or self.touching is not None

    @property
    def touched(self) -> tuple[str, ...]:
        """The names of obstacles, then those of surfaces on each other."""
        return self.names + (() if self.touching is None else self.touching.names)

    def faces_of(self, name: str) -> Int[HostArray, "n_faces n_fn"]:
        """List the nodes of faces of the body that feel one of `touched`."""
        if self.touching is not None and name in self.touching.names:
            return self.touching.faces
        return self.faces

    def following(self, mesh: TetMesh, points: Float[Array, "n_points 3"]):
        """Return the contacts of a mesh with other points; their scale stays [m]."""
        areas, _ = face_areas(mesh, self.faces)
        areas = jnp.where(jnp.asarray(self.areas) > 0.0, areas[None], 0.0)
        new = eqx.tree_at(lambda c: (c.areas, c.rest), self, (areas, points))
        if self.touching is None:
            return new
        return eqx.tree_at(lambda c: c.touching, new, self.touching.following(mesh))

    def cliques(self) -> tuple[Int[HostArray, "_ _"], ...]:
        """List the nodes that each obstacle couples: those of a face and its frame.

        Then those that each pair of faces that may touch couples.
        """
        spread = lambda nodes: np.broadcast_to(nodes, (len(self.faces), 4))
        cliques = tuple(
            np.concatenate([self.faces, spread(nodes)], axis=1).astype(np.int32)
            for nodes in self.frames
        )
        return cliques + (() if self.touching is None else (self.touching.cliques(),))

    def _local(self, z: Float[Array, "m 3"]) -> Float[Array, "n_qp 3"]:
        """Return the points of a face in the frame of an obstacle [m].

        `z` are the positions of the nodes of the face, then of the four of the frame.
        """
        N = jnp.asarray(self.shape_functions)
        x, (origin, *ends) = jnp.sum(N[:, :, None] * z[None, :-4], axis=1), z[-4:]
        axes = (jnp.stack(ends) - origin[None]) / self.length
        return jnp.sum((x - origin[None])[:, None] * axes[None], axis=2)

    def _gaps(self, k: int, z: Float[Array, "m 3"]) -> Float[Array, " n_qp"]:
        return jax.vmap(self.shapes[k].distance)(self._local(z))

    def _touch(self, k: int, tamed, y, start) -> _Touch:
        """Compute how a point at `y` touches the obstacle `k`; it came from `start`."""
        depth, normal = self._depth(k, y)
        p = _pressure_of(tamed)(depth, self.scale)
        if not self.sticks[k]:
            return _Touch(depth, jnp.zeros(()), -p * normal, jnp.zeros(3))
        way = self._way(k, y, start, depth, normal)
        mu, stick = jnp.asarray(self.friction)[k], STICK * self.scale
        slip, reach, least = vector_length(way), mu * stick, 1e-12 * stick
        x = slip / jnp.maximum(reach, least)  # finite where mu and the slip are 0
        sticks = slip < 2.0 * reach
        held = 1.0 - 0.25 * slip / jnp.where(sticks, reach, stick)
        shear = jnp.where(sticks, held / stick, mu / jnp.maximum(slip, least))
        secant = jnp.asarray(tamed) > 1
        shear = jnp.where(secant, jax.lax.stop_gradient(shear), shear)
        return _Touch(depth, x, -p * normal, p * shear * way)

    def _depth(self, k: int, y) -> tuple[Float[Array, ""], Float[Array, "3"]]:
        """Return how far a point has come into the cushion [m], and the normal."""
        gap, normal = jax.value_and_grad(self.shapes[k].distance)(y)
        return 0.5 * self.scale - gap, normal

    def _way(self, k: int, y, start, depth, normal) -> Float[Array, "3"]:
        """Return the way of a point along the surface since it came in touch [m]."""
        outside = jnp.maximum(-self._depth(k, start)[0], 0.0)
        inside = jnp.maximum(depth, 1e-9 * self.scale)
        way = inside / (outside + inside) * (y - start)
        return way - normal * jnp.sum(normal * way)

    def _left_at(self, k: int, y, start) -> Float[Array, "3"]:
        """Return from where the slip of a point counts after an equilibrium [m].

        That is where it is unless it touches; then it is where it stuck last, which a
        point that slides draws along behind it.
        """
        depth, normal = self._depth(k, y)
        way = self._way(k, y, start, depth, normal)
        reach = 2.0 * jnp.asarray(self.friction)[k] * STICK * self.scale
        slip = jnp.maximum(vector_length(way), 1e-12 * self.scale)
        stuck = y - jnp.minimum(reach / slip, 1.0) * way
        before, _ = self._depth(k, stuck)
        stuck = stuck - normal * jnp.maximum(-before, 0.0)  # on a curved obstacle
        return jnp.where(depth > 0.0, stuck, y)

    def _starts(self, k: int, standing: Standing) -> Float[Array, "n_faces n_qp 3"]:
        """Return from where slip counts, of all points in an obstacle's frame [m]."""
        if not self.sticks[k]:  # slip does not matter
            return jnp.zeros((len(self.faces), len(self.shape_functions), 3))
        of_faces = jax.vmap(self._local)
        start = of_faces(self._nodes(k, jnp.asarray(self.rest), standing.start[k]))
        left_at = jax.vmap(jax.vmap(partial(self._left_at, k)))
        for x, is_stage in standing.stages:
            y = of_faces(self._nodes(k, x, x[self.frames[k]]))
            start = jnp.where(is_stage, left_at(y, start), start)
        return start

    def _face(
        self,
        k: int,
        z: Float[Array, "m 3"],
        area: Float[Array, " n_qp"],
        start: Float[Array, "n_qp 3"],
        tamed: int | Int[Array, ""] = 0,
    ) -> tuple[Float[Array, "m 3"], Float[Array, "m 3"], _Touch]:
        """Compute the force of a face on the obstacle `k` at the nodes `z` [N].

        With the friction in it; slip counts from `start`, in the obstacle's frame.
        """
        y, on_nodes = jax.vjp(self._local, z)
        touches = jax.vmap(partial(self._touch, k, tamed))(y, start)
        weight = self.stiffness * area[:, None]
        (force,) = on_nodes(weight * touches.push)
        if not self.sticks[k]:
            return force, jnp.zeros_like(force), touches
        (friction,) = on_nodes(weight * touches.shear)
        return force + friction, friction, touches

    def _nodes(self, k: int, x, frame) -> Float[Array, "n_faces m 3"]:
        """Return the positions of nodes: of each face, and the obstacle's frame [m]."""
        faces = jnp.asarray(self.faces)
        frames = jnp.broadcast_to(frame, (len(faces), 4, 3))
        return jnp.concatenate([x[faces], frames], axis=1)

    def _positions(self, k: int, x, standing: Standing):
        """Return the positions and areas of all faces with an obstacle [m]."""
        area = jnp.where(standing.present[k], jnp.asarray(self.areas)[k], 0.0)
        return self._nodes(k, x, x[self.frames[k]]), area

    def energy_and_force(
        self, x: Float[Array, "n_points 3"], standing: Standing
    ) -> tuple[Array, Array, Array | None]:
        """Compute potential [J], forces and friction of contact at positions x [m].

        Forces are the gradient of the potential and friction, which has none [N];
        without any, it is None.
        """
        energy, force = jnp.zeros(()), jnp.zeros_like(x)
        if self.touching is not None:
            by = self.scale, self.stiffness
            energy, force = self.touching.energy_and_force(x, *by)
        friction = jnp.zeros_like(x) if any(self.sticks) else None
        for k in range(self.n_obstacles):
            z, area = self._positions(k, x, standing)
            start = self._starts(k, standing)
            parts, along, touches = jax.vmap(partial(self._face, k))(z, area, start)
            stored = jnp.sum(area * cushion(touches.depth, self.scale))
            energy = energy + self.stiffness * stored
            force = self._added(k, force, parts)
            if friction is not None and self.sticks[k]:
                friction = self._added(k, friction, along)
        return energy, force, friction

    def _added(self, k: int, force, parts):
        """Add the forces of all faces on an obstacle to those of nodes [N]."""
        force = force.at[self.faces].add(parts[:, :-4])
        return force.at[self.frames[k]].add(jnp.sum(parts[:, -4:], axis=0))

    def tangents(
        self,
        x: Float[Array, "n_points 3"],
        standing: Standing,
        *,
        tamed: int | Int[Array, ""] = 0,
    ) -> tuple[Float[Array, "n_faces _ _"], ...]:
        """Differentiate the forces on obstacles by the nodes of each clique [N/m].

        It is exact unless `tamed`: then curvature counts as if no pressure were above
        E. Newton's method comes across such pressures while an obstacle moves in, and
        with them the tangent would be far from positive definite. If it is 2, friction
        counts by its secant: the slope is zero where all of it slides, and would not
        foresee that it sticks when it turns back.
        """
        return tuple(
            self._stiffness_of(k, x, standing, tamed) for k in range(self.n_obstacles)
        )

    def add_touching(
        self,
        x: Float[Array, "n_points 3"],
        values: Float[Array, " nnz"],
        add: Callable[[Array, Array, Array], Array],
        *,
        tamed: int | Int[Array, ""] = 0,
    ) -> Float[Array, " nnz"]:
        """Add to values what `tangents` are to obstacles, of surfaces that touch [N/m].

        `add` adds matrices of cliques of the last kind in `cliques`, and their numbers.
        """
        if self.touching is None:
            return values
        of_contact = self.scale, self.stiffness, _pressure_of(tamed)
        return self.touching.add_tangents(x, *of_contact, values, add)

    def _stiffness_of(self, k: int, x, standing: Standing, tamed):
        (z, area), start = self._positions(k, x, standing), self._starts(k, standing)
        m, n_blocks = z.shape[1], len(z) // BLOCK
        gap = jax.vmap(lambda z: self._gaps(k, z))(z)
        near = jnp.any((gap < 0.5 * self.scale) & (area > 0.0), axis=1)

        def of_face(z, area, start):
            force = lambda z: self._face(k, z, area, start, tamed)[0]
            return jax.jacfwd(force)(z).reshape(3 * m, 3 * m)

        def of_block(block):
            near, *faces = block
            none = lambda *_: jnp.zeros((BLOCK, 3 * m, 3 * m))
            return jax.lax.cond(jnp.any(near), jax.vmap(of_face), none, *faces)

        cut = lambda a: a.reshape(n_blocks, BLOCK, *a.shape[1:])
        blocks = jax.lax.map(of_block, tuple(map(cut, (near, z, area, start))))
        return blocks.reshape(-1, 3 * m, 3 * m)

    def passes_through(
        self,
        before: Float[Array, "n_points 3"],
        after: Float[Array, "n_points 3"],
        standing: Standing,
    ) -> Bool[Array, ""]:
        """Tell whether a point comes too deep into what it meets on a straight way.

        Points are looked for at few places of the way. A distance changes by at most
        the way, so that half the way between two places counts as depth.
        """
        through = jnp.zeros((), bool)
        if self.touching is not None:
            through = self.touching.passes_through(before, after)
        for k in range(self.n_obstacles):
            z, area = self._positions(k, before, standing)
            to, _ = self._positions(k, after, standing)
            lowest = jax.vmap(partial(self._lowest_gaps, k))(z, to)
            too_deep = lowest < -jnp.asarray(self.depth)[k]
            through = through | jnp.any(too_deep & (area > 0.0))
        return through

    def _lowest_gaps(self, k: int, before, after) -> Float[Array, " n_qp"]:
        first, last = self._local(before), self._local(after)
        gaps = jax.vmap(self.shapes[k].distance)
        places = jnp.linspace(0.0, 1.0, _SAMPLES + 1)
        on_way = jax.lax.map(lambda t: gaps(first + t * (last - first)), places)
        way = jnp.linalg.norm(last - first, axis=1)
        return jnp.min(on_way, axis=0) - 0.5 / _SAMPLES * way

    def states(
        self, x: Float[Array, "n_points 3"], standing: Standing
    ) -> tuple[ContactState, ...]:
        """Compute what each obstacle, and each surface, feels at positions x [m]."""
        states = []
        for k in range(self.n_obstacles):
            z, area = self._positions(k, x, standing)
            start = self._starts(k, standing)
            forces, _, touches = jax.vmap(partial(self._face, k))(z, area, start)
            on_frame = -jnp.sum(forces[:, -4:], axis=0)
            arms = x[self.frames[k]] - x[self.frames[k][0]][None]
            s, d = self.scale, touches.depth
            pressed = jnp.where(d > 0.0, area, 0.0)
            slides = touches.slip >= 2.0
            total = jnp.sum(pressed)
            states.append(
                ContactState(
                    name=self.names[k],
                    force=jnp.sum(on_frame, axis=0),
                    moment=jnp.sum(jnp.cross(arms, on_frame), axis=0),
                    area=total,
                    depth=jnp.max(jnp.where(area > 0.0, d - 0.5 * s, 0.0), initial=0.0),
                    sliding=jnp.sum(jnp.where(slides, pressed, 0.0))
                    / jnp.where(total > 0.0, total, 1.0),
                    pressure=self.stiffness
                    * mean_over_faces(cushion_pressure(d, s), area),
                )
            )
        if self.touching is not None:
            felt = self.touching.states(x, self.scale, self.stiffness)
            no = jnp.zeros(())
            for name, values in zip(self.touching.names, felt, strict=True):
                states.append(ContactState(name=name, sliding=no, **values))
        return tuple(states)

    @eqx.filter_jit
    def depths_at_start(self, standing: Standing) -> Float[Array, " n"]:
        """Compute how deep the body at rest lies in what it may touch [m].

        That is before the load, in the order of `touched`.
        """
        x, depths = jnp.asarray(self.rest), jnp.zeros(self.n_obstacles)
        for k, frame in enumerate(self.frames):
            x = x.at[frame].set(standing.start[k])
            z, area = self._positions(k, x, standing)
            gap = jax.vmap(partial(self._gaps, k))(z)
            depths = depths.at[k].set(jnp.max(jnp.where(area > 0.0, -gap, 0.0)))
        if self.touching is None:
            return depths
        felt = self.touching.states(x, self.scale, self.stiffness)
        return jnp.concatenate([depths, jnp.stack([of["depth"] for of in felt])])


def build_contacts(
    mesh: TetMesh,
    points: Float[HostArray, "n_points 3"],
    obstacles: Sequence[Obstacle],
    *,
    length: Float[HostArray, ""],
    scale: float | None,
    touching: Touching | None = None,
) -> Contacts:
    """Collect the faces of a mesh and the obstacles; arrays are empty without any.

    Its stiffness is one until the law is known. The scale is by default `FINE` of the
    mean size of a face [m]; for the rest see `Touching`.
    """
    n_obstacles = len(obstacles)
    none = np.zeros((0, 3 if mesh.order == 1 else 6), np.int32)
    faces = boundary_faces(mesh) if obstacles else none
    areas, N = face_areas(mesh, faces)
    if scale is None:
        scale = FINE * face_size(mesh) if obstacles or touching is not None else 1.0
    pad = -len(faces) % BLOCK
    apart = [~np.isin(faces, o.nodes).all(axis=1) for o in obstacles]
    of_each = np.reshape(apart, (n_obstacles, len(faces), 1)) * areas
    to_array = lambda leaf: jnp.asarray(leaf, float)
    return Contacts(
        faces=np.concatenate([faces, np.repeat(faces[:1], pad, axis=0)]),
        areas=np.pad(of_each, ((0, 0), (0, pad), (0, 0))),
        shape_functions=N,
        rest=points,
        frames=np.reshape(
            [mesh.n_nodes + 4 * o.body + np.arange(4) for o in obstacles], (-1, 4)
        ).astype(np.int32),
        length=length,
        depth=np.array([o.shape.depth for o in obstacles], float),
        stiffness=jax.device_put(np.ones(())),
        scale=jax.device_put(np.asarray(scale, float)),
        shapes=tuple(jax.tree.map(to_array, o.shape) for o in obstacles),
        body=tuple(o.body for o in obstacles),
        friction=np.array([o.friction for o in obstacles], float),
        touching=touching,
        sticks=tuple(o.friction > 0.0 for o in obstacles),
        names=tuple(o.name for o in obstacles),
    )
