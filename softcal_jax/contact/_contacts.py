"""Contact of the surface of the body with obstacles, which slides or sticks.

Each quadrature point of the faces of the body, with the area A at rest and the distance
g from an obstacle, adds A E phi(d) to the potential energy, where d = s / 2 - g is how
far it has come into a cushion on the obstacle. With the scale s,

    phi(d) = d^3 / (12 s^2)                      where 0 < d < 2 s,
             d^2 / (2 s) - d + 2 s / 3           where d >= 2 s,

and p = E phi'(d) is the pressure: E / 16 where surfaces coincide, 0.56 E at the depth
s. It is a penalty that is linear in depth, with a smooth onset so that the tangent is
continuous (compare Wriggers, Computational Contact Mechanics, 2006, ch. 6 and 10). The
usual pressures of soft bodies are about that at g = 0, and the error is in proportion
to s. Sticking friction holds points by springs along the surface that are as stiff,
from where they came in touch. That place follows the state, so that there is an energy:
the springs are softer the smaller the share of a point's way since it came in touch.
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
from softcal_jax.contact._shapes import AbstractShape
from softcal_jax.mesh import TetMesh, boundary_faces, face_areas

BLOCK = 16  # faces whose tangents are computed together, where one of them is touched

_SAMPLES = 8  # states on the way of a step at which points are looked for inside

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
    """

    present: Bool[Array, " n_obstacles"]
    start: Float[Array, "n_obstacles 4 3"]


class ContactState(Module):
    """What an obstacle feels in a state of the robot.

    Area and sliding share count whole quadrature points, so their derivative is zero.

    Attributes:
        force: Force of the robot on it [N].
        moment: Its moment about the origin of the frame of the obstacle [N m].
        area: Area at rest of the surface that presses on it [m2].
        depth: How deep the surface lies in it at most [m].
        sliding: Share of the area where friction could not hold what sticks [-].
    """

    name: str = eqx.field(static=True)
    force: Float[Array | HostArray, "3"]
    moment: Float[Array | HostArray, "3"]
    area: float | Float[Array, ""]
    depth: float | Float[Array, ""]
    sliding: float | Float[Array, ""]


def _cushion(d: Float[Array, "..."], s: Float[Array, ""]) -> Float[Array, "..."]:
    """Compute phi of the module's docstring [m]."""
    near = jnp.clip(d, 0.0, 2.0 * s)
    far = jnp.maximum(d / s, 2.0)
    deep = s * (0.5 * far**2 - far + 2.0 / 3.0)
    return jnp.where(d < 2.0 * s, near**3 / (12.0 * s**2), deep)


def _pressure(d: Float[Array, "..."], s: Float[Array, ""]) -> Float[Array, "..."]:
    """Compute phi'(d) [-]."""
    near = jnp.clip(d, 0.0, 2.0 * s)
    return jnp.where(d < 2.0 * s, near**2 / (4.0 * s**2), d / s - 1.0)


def _expanded(
    most: Float[Array, ""], d: Float[Array, "..."], s: Float[Array, ""]
) -> Float[Array, "..."]:
    """Return an energy with the second derivatives of phi, for pressures up to `most`.

    Beyond, the curvature of the obstacle counts as if p = E most.
    """
    still = jax.lax.stop_gradient
    slope = jnp.minimum(_pressure(d, s), most)
    curvature = jnp.clip(d / (2.0 * s), 0.0, 1.0) / s
    return still(slope) * d + 0.5 * still(curvature) * (d - still(d)) ** 2


def _grip(d: Float[Array, "..."], s: Float[Array, ""]) -> Float[Array, "..."]:
    """Compute the share of a point that the obstacle has taken hold of [-]."""
    q = jnp.clip(d / (2.0 * s), 0.0, 1.0)
    return q**2 * (3.0 - 2.0 * q)


def _cushion_and_slip(shape: AbstractShape, s, y, start) -> tuple[Array, Array]:
    """Return how far a point has come into the cushion, and moved along it since [m].

    Points are in the frame of the obstacle, and the way there is straight.
    """
    gap, normal = jax.value_and_grad(shape.distance)(y)
    cushion = 0.5 * s - gap
    # How far it was outside of the cushion at the start, and how far it is inside.
    outside = jnp.maximum(shape.distance(start) - 0.5 * s, 0.0)
    inside = jnp.maximum(cushion, 1e-9 * s)
    way = inside / (outside + inside) * (y - start)
    return cushion, way - normal * jnp.sum(normal * way)


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
        friction: Coefficient of friction up to which points stick to each [-].
        sticks: Whether it has friction; else points slide.
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
    body: tuple[int, ...] = eqx.field(static=True)
    sticks: tuple[bool, ...] = eqx.field(static=True)
    names: tuple[str, ...] = eqx.field(static=True)

    @property
    def n_obstacles(self) -> int:
        return len(self.body)

    def following(self, mesh: TetMesh, points: Float[Array, "n_points 3"]):
        """Return the contacts of a mesh with other points; their scale stays [m]."""
        areas, _ = face_areas(mesh, self.faces)
        areas = jnp.where(jnp.asarray(self.areas) > 0.0, areas[None], 0.0)
        return eqx.tree_at(lambda c: (c.areas, c.rest), self, (areas, points))

    def cliques(self) -> tuple[Int[HostArray, "n_faces _"], ...]:
        """List the nodes that each obstacle couples: those of a face and its frame."""
        spread = lambda nodes: np.broadcast_to(nodes, (len(self.faces), 4))
        return tuple(
            np.concatenate([self.faces, spread(nodes)], axis=1).astype(np.int32)
            for nodes in self.frames
        )

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

    def _face_energy(
        self,
        k: int,
        z: Float[Array, "m 3"],
        area: Float[Array, " n_qp"],
        start: Float[Array, "m 3"],
        cushion: Callable[[Array, Array], Array] = _cushion,
    ) -> Float[Array, ""]:
        """Compute the energy between a face and the obstacle `k` [J].

        `start` are the positions before the load.
        """
        s = self.scale
        if not self.sticks[k]:
            energy = cushion(0.5 * s - self._gaps(k, z), s)
        else:
            at = jax.vmap(partial(_cushion_and_slip, self.shapes[k], s))
            d, slip = at(self._local(z), self._local(start))
            energy = cushion(d, s) + 0.5 / s * _grip(d, s) * jnp.sum(slip**2, axis=1)
        return self.stiffness * jnp.sum(area * energy)

    def _positions(self, k: int, x, standing: Standing):
        """Return the positions, areas and starts of all faces with an obstacle [m]."""
        faces = jnp.asarray(self.faces)
        spread = lambda frame: jnp.broadcast_to(frame, (len(faces), 4, 3))
        both = lambda nodes, frame: jnp.concatenate(
            [nodes[faces], spread(frame)], axis=1
        )
        rest = jnp.asarray(self.rest)
        area = jnp.where(standing.present[k], jnp.asarray(self.areas)[k], 0.0)
        return both(x, x[self.frames[k]]), area, both(rest, standing.start[k])

    def energy_and_force(
        self, x: Float[Array, "n_points 3"], standing: Standing
    ) -> tuple[Float[Array, ""], Float[Array, "n_points 3"]]:
        """Compute the potential [J] and its gradient at positions of all nodes [N]."""
        energy, force = jnp.zeros(()), jnp.zeros_like(x)
        for k in range(self.n_obstacles):
            of_face = jax.vmap(jax.value_and_grad(partial(self._face_energy, k)))
            energies, parts = of_face(*self._positions(k, x, standing))
            energy = energy + jnp.sum(energies)
            force = force.at[self.faces].add(parts[:, :-4])
            force = force.at[self.frames[k]].add(jnp.sum(parts[:, -4:], axis=0))
        return energy, force

    def tangents(
        self,
        x: Float[Array, "n_points 3"],
        standing: Standing,
        *,
        tamed: bool | Bool[Array, ""] = False,
    ) -> tuple[Float[Array, "n_faces _ _"], ...]:
        """Differentiate the force of each clique by the positions of its nodes [N/m].

        It is exact unless `tamed`: then the curvature of obstacles counts as if no
        pressure were above E. Newton's method comes across such pressures while an
        obstacle moves in, and with them the tangent would be far from positive
        definite.
        """
        cushion = partial(_expanded, jnp.where(tamed, 1.0, jnp.inf))
        return tuple(
            self._stiffness_of(k, x, standing, cushion) for k in range(self.n_obstacles)
        )

    def _stiffness_of(self, k: int, x, standing: Standing, cushion):
        z, area, start = self._positions(k, x, standing)
        m, n_blocks = z.shape[1], len(z) // BLOCK
        gap = jax.vmap(lambda z: self._gaps(k, z))(z)
        near = jnp.any((gap < 0.5 * self.scale) & (area > 0.0), axis=1)

        def of_face(z, area, start):
            energy = partial(self._face_energy, k)
            force = lambda z: jax.grad(energy)(z, area, start, cushion)
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
        """Tell whether a point comes too deep into an obstacle on a straight way.

        Points are looked for at few places of the way. A distance changes by at most
        the way, so that half the way between two places counts as depth.
        """
        through = jnp.zeros((), bool)
        for k in range(self.n_obstacles):
            z, area, _ = self._positions(k, before, standing)
            to, *_ = self._positions(k, after, standing)
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
        """Compute what each obstacle feels at positions of all nodes [m]."""
        states = []
        for k in range(self.n_obstacles):
            z, area, start = self._positions(k, x, standing)
            of_face = jax.vmap(jax.grad(partial(self._face_energy, k)))
            on_frame = -jnp.sum(of_face(z, area, start)[:, -4:], axis=0)
            arms = x[self.frames[k]] - x[self.frames[k][0]][None]
            s, local = self.scale, jax.vmap(self._local)
            at = partial(_cushion_and_slip, self.shapes[k], s)
            d, slip = jax.vmap(jax.vmap(at))(local(z), local(start))
            pressed = jnp.where(d > 0.0, area, 0.0)
            along = _grip(d, s) / s * jnp.linalg.norm(slip, axis=2)
            most = jnp.asarray(self.friction)[k] * _pressure(d, s)
            slides = (along > most) & self.sticks[k]
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
                )
            )
        return tuple(states)

    @eqx.filter_jit
    def depths_at_start(self, standing: Standing) -> Float[Array, " n_obstacles"]:
        """Compute how deep the body at rest lies in obstacles before the load [m]."""
        x, depths = jnp.asarray(self.rest), jnp.zeros(self.n_obstacles)
        for k, frame in enumerate(self.frames):
            x = x.at[frame].set(standing.start[k])
            z, area, _ = self._positions(k, x, standing)
            gap = jax.vmap(partial(self._gaps, k))(z)
            depths = depths.at[k].set(jnp.max(jnp.where(area > 0.0, -gap, 0.0)))
        return depths


def build_contacts(
    mesh: TetMesh,
    points: Float[HostArray, "n_points 3"],
    obstacles: Sequence[Obstacle],
    *,
    length: Float[HostArray, ""],
    scale: float | None,
) -> Contacts:
    """Collect the faces of a mesh and the obstacles; arrays are empty without any.

    Its stiffness is one until the law is known. The scale is by default `FINE` of the
    mean size of a face [m].
    """
    n_obstacles = len(obstacles)
    none = np.zeros((0, 3 if mesh.order == 1 else 6), np.int32)
    faces = boundary_faces(mesh) if obstacles else none
    areas, N = face_areas(mesh, faces)
    if scale is None:
        mean = np.sqrt(2.0 * areas.sum() / max(1, len(faces)))
        scale = FINE * float(mean) if obstacles else 1.0
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
        sticks=tuple(o.friction > 0.0 for o in obstacles),
        names=tuple(o.name for o in obstacles),
    )
