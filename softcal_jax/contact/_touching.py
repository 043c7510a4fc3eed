"""Contact of the body with itself, between surfaces that are named, without friction.

Each quadrature point of a face, with half of its area A at rest, feels the cushion of
the module `_contacts` on the other surface: it adds A E phi(s / 2 - g) to the energy,
with g its distance from there. Both surfaces have points, half each, so that it is the
same which of them is named first (two half passes: Sauer and De Lorenzis, Comput.
Methods Appl. Mech. Eng. 253, 2013). The energy depends on places of nodes against each
other alone: forces come in pairs, equal and opposite on one line.

Which faces can meet is decided at rest, so that one program and one pattern of the
tangent serve every state (`_facing`). Of these, a point looks for the nearest face, and
for its distance from there (`_foot`). Deeper than half of the tet behind a face nothing
is felt, and no step may lead there.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._module import Module
from softcal_jax._typing import Array, Bool, Float, HostArray, Int
from softcal_jax.contact._cushion import cushion, cushion_pressure, mean_over_faces
from softcal_jax.contact._foot import foot, gap_of, placed, polynomial, stiffness_of
from softcal_jax.mesh import TetMesh, face_areas

BLOCK = 8  # faces or points that are looked at together, where one of them touches
_SAMPLES = 8  # states on the way of a step at which points are looked for inside
_NEAREST = 8  # candidates, by distance over size, among which the nearest face is


class _Touch(NamedTuple):
    """What points touch: the number of the pair, or -1; the face, and where in it."""

    pair: Int[Array, "..."]
    partner: Int[Array, "..."]
    foot: Float[Array, "... 2"]


def _balls(X: Float[Array, "n_faces n_fn 3"]):
    """Return centres and radii of balls around the nodes of faces [m]."""
    centre = jnp.mean(X, axis=1)
    return centre, jnp.max(jnp.linalg.norm(X - centre[:, None], axis=2), axis=1)


class Touching(Module):
    """Faces of the body that may touch each other, padded to whole blocks.

    Attributes:
        faces: Nodes of the faces, normals outwards.
        areas: Half of the area of each point at rest [m2].
        limits: Depth below each from which nothing is felt [m].
        partners: Faces that each may touch; itself where there are fewer.
        pairs: Number of the pair that they are; -1 where there are fewer.
        ends: Faces of each pair, the lower index first.
        swapped: Whether the first of them is of the surface that is named second.
        of: Which of the `names` each pair belongs to.
        shape_functions: Those of a face at its points [-].
    """

    faces: Int[HostArray, "n_faces n_fn"]
    areas: Float[HostArray, "n_faces n_qp"]
    limits: Float[HostArray, " n_faces"]
    partners: Int[HostArray, "n_faces n_c"]
    pairs: Int[HostArray, "n_faces n_c"]
    ends: Int[HostArray, "n_pairs 2"]
    swapped: Bool[HostArray, " n_pairs"]
    of: Int[HostArray, " n_pairs"]
    shape_functions: Float[HostArray, "n_qp n_fn"]
    names: tuple[str, ...] = eqx.field(static=True)

    def following(self, mesh: TetMesh) -> "Touching":
        """Return the same of a mesh with other points; depths that are felt stay."""
        areas, _ = face_areas(mesh, self.faces)
        areas = jnp.where(jnp.asarray(self.areas) > 0.0, 0.5 * areas, 0.0)
        return eqx.tree_at(lambda t: t.areas, self, areas)

    def cliques(self) -> Int[HostArray, "n_pairs _"]:
        """List the nodes that each pair couples."""
        return self.faces[self.ends].reshape(len(self.ends), -1).astype(np.int32)

    def _points(self) -> tuple[HostArray, Array]:
        """Return the face and the shape functions of every point."""
        n_faces, n_qp = self.areas.shape
        rows = np.repeat(np.arange(n_faces, dtype=np.int32), n_qp)
        return rows, jnp.tile(jnp.asarray(self.shape_functions), (n_faces, 1))

    def _apart(self, X: Float[Array, "n_faces n_fn 3"]) -> Float[Array, "n_faces n_c"]:
        """Return distances that are surely left between each face and others [m]."""
        (centre, radius), to = _balls(X), jnp.asarray(self.partners)
        way = jnp.linalg.norm(centre[to] - centre[:, None], axis=2)
        # A curved face bulges beyond its nodes.
        apart = way - 1.2 * (radius[:, None] + radius[to])
        return jnp.where(jnp.asarray(self.pairs) >= 0, apart, jnp.inf)

    def _in_blocks(self, flag: Bool[Array, " n_faces"], of_block: Callable, none: Any):
        """Map indices of faces, block by block, where at least one is flagged."""
        rows = jnp.arange(len(self.faces), dtype=jnp.int32).reshape(-1, BLOCK)
        skip = lambda _: none
        one = lambda block: jax.lax.cond(jnp.any(block[0]), of_block, skip, block[1])
        blocks = jax.lax.map(one, (flag.reshape(-1, BLOCK), rows))
        return jax.tree.map(lambda a: a.reshape(-1, *a.shape[2:]), blocks)

    def _at_points(self, X: Float[Array, "n_faces n_fn 3"], of_point: Callable, rows):
        """Compute a function of each point of faces, and of those that may be nearest.

        Its arguments are the shape functions of the point, the number of its face, the
        numbers of other faces, and those of the pairs.
        """
        centre, radius = _balls(X)
        partners, pairs = jnp.asarray(self.partners), jnp.asarray(self.pairs)
        some = min(_NEAREST, pairs.shape[1])

        def chosen(N, row):
            to, x = partners[row], N @ X[row]
            beside = jnp.linalg.norm(centre[to] - x[None], axis=1) / radius[to]
            beside = jnp.where(pairs[row] >= 0, beside, jnp.inf)
            k = jax.lax.top_k(-beside, some)[1]
            return of_point(N, row, to[k], pairs[row, k])

        of_face = jax.vmap(jax.vmap(chosen, (0, None)), (None, 0))
        return of_face(jnp.asarray(self.shape_functions), rows)

    def _touched(self, x: Float[Array, "n_points 3"], s) -> _Touch:
        """Find the face that each point touches at positions x [m]."""
        X, s = jax.lax.stop_gradient((x[self.faces], s))
        limits = jnp.asarray(self.limits)

        def of_point(N, row, partners, pairs):
            x, C = N @ X[row], jax.vmap(polynomial)(X[partners])
            feet = jax.vmap(foot, (0, None))(C, x)
            at = jax.vmap(placed, (0, None, 0, None))(C, x, feet, s)
            felt = (pairs >= 0) & (at.along > -limits[partners])
            # Of faces that share the nearest edge, that which faces the point most.
            k = jnp.argmin(jnp.where(felt, at.away - 1e-6 * jnp.abs(at.along), jnp.inf))
            pair = jnp.where(felt[k] & (at.gap[k] < 0.5 * s), pairs[k], -1)
            return _Touch(pair, partners[k], feet[k])

        no = jnp.zeros((BLOCK, len(self.shape_functions)), jnp.int32)
        none = _Touch(no - 1, no, jnp.zeros((*no.shape, 2)))
        near = jnp.any(self._apart(X) < 0.5 * s, axis=1)
        touch = self._in_blocks(near, partial(self._at_points, X, of_point), none)
        return jax.tree.map(lambda a: a.reshape(-1, *a.shape[2:]), touch)

    def _felt(self, x: Float[Array, "n_points 3"], s, E):
        """Return what points touch, their E A [N], depths [m] and forces on nodes [N].

        Weights and depths are zero where nothing is touched.
        """
        touch, X, (rows, N) = self._touched(x, s), x[self.faces], self._points()
        z = jnp.concatenate([X[rows], X[touch.partner]], axis=1)
        of_point = jax.vmap(jax.value_and_grad(gap_of, 3), (0, None, 0, 0))
        gap, slope = of_point(N, s, touch.foot, z)
        weight = jnp.where(touch.pair >= 0, E * jnp.asarray(self.areas).ravel(), 0.0)
        depth = jnp.where(weight > 0.0, 0.5 * s - gap, 0.0)
        push = (weight * cushion_pressure(depth, s))[:, None, None]
        return touch, weight, depth, -push * slope

    def energy_and_force(self, x: Float[Array, "n_points 3"], s, E):
        """Compute the potential [J], and its gradient by positions x [N]."""
        touch, weight, depth, force = self._felt(x, s, E)
        (rows, _), n, faces = self._points(), self.faces.shape[1], self.faces
        total = jnp.zeros_like(x).at[faces[rows]].add(force[:, :n])
        total = total.at[jnp.asarray(faces)[touch.partner]].add(force[:, n:])
        return jnp.sum(weight * cushion(depth, s)), total

    def add_tangents(
        self,
        x: Float[Array, "n_points 3"],
        s: Float[Array, ""],
        E: Float[Array, ""],
        law: Callable[[Array, Array], Array],
        values: Float[Array, " nnz"],
        add: Callable[..., Float[Array, " nnz"]],
    ) -> Float[Array, " nnz"]:
        """Differentiate the forces, with a law of pressure, by places of nodes [N/m].

        `add` adds matrices of numbered pairs to the values, block by block.
        """
        touch, X, (rows, N) = self._touched(x, s), x[self.faces], self._points()
        n, ends = self.faces.shape[1], jnp.asarray(self.ends)
        points = jnp.asarray(rows), N, E * jnp.asarray(self.areas).ravel()
        # Those that touch come first, so that few blocks have some.
        order = jnp.argsort(touch.pair < 0).reshape(-1, BLOCK)

        def of_block(values, which):
            (pair, to, feet), (row, N, weight) = jax.tree.map(
                lambda a: a[which], (touch, points)
            )
            z = jnp.concatenate([X[row], X[to]], axis=1)
            of_point = jax.vmap(partial(stiffness_of, law), (0, None, 0, 0))
            K = of_point(N, s, feet, z)
            # In the order of the pair.
            turn = (ends[pair, 0] != row)[:, None, None, None, None]
            K = jnp.where(turn, jnp.roll(K, (n, n), (1, 3)), K)
            K = jnp.where(pair >= 0, weight, 0.0)[:, None, None, None, None] * K
            return add(values, K.reshape(BLOCK, 6 * n, -1), jnp.maximum(pair, 0))

        def one(values, which):
            some = jnp.any(touch.pair[which] >= 0)
            return jax.lax.cond(some, of_block, lambda v, _: v, values, which), None

        return jax.lax.scan(one, values, order)[0]

    def passes_through(
        self, before: Float[Array, "n_points 3"], after: Float[Array, "n_points 3"]
    ) -> Bool[Array, ""]:
        """Tell whether a point gets below what it feels of a face on a straight way.

        Points are looked for at few places of the way, and only where the way of two
        faces against each other is more than half of that depth.
        """
        X, way = before[self.faces], (after - before)[self.faces]
        limits, to = jnp.asarray(self.limits), jnp.asarray(self.partners)
        middle = jnp.mean(way, axis=1)
        longest = lambda a: jnp.max(jnp.linalg.norm(a, axis=-1), axis=-1)
        against = longest(way[:, None] - middle[to][:, :, None])
        against = against + longest(way - middle[:, None])[to]
        far = (self._apart(X) < against) & (against > 0.5 * limits[to])

        def above(X, N, row, to):
            C, x = polynomial(X[to]), N @ X[row]
            at = placed(C, x, foot(C, x), jnp.ones(()))
            return at.along > -limits[to], at.inside

        def of_block(rows):
            def falls(share):
                now, last = X + share * way, X + (share - 1.0 / _SAMPLES) * way

                def of_point(N, row, partners, pairs):
                    is_above, inside = jax.vmap(partial(above, now, N, row))(partners)
                    was_above, _ = jax.vmap(partial(above, last, N, row))(partners)
                    return jnp.any((pairs >= 0) & was_above & ~is_above & inside)

                return jnp.any(self._at_points(now, of_point, rows), axis=1)

            shares = jnp.linspace(0.0, 1.0, _SAMPLES + 1)[1:]
            return jnp.any(jax.lax.map(falls, shares), axis=0)

        none, flag = jnp.zeros(BLOCK, bool), jnp.any(far, axis=1)
        return jnp.any(self._in_blocks(flag, of_block, none))

    def states(self, x: Float[Array, "n_points 3"], s, E) -> list[dict[str, Array]]:
        """Compute force [N], moment [N m], area [m2], depth [m] and pressure of each.

        That is the force of the first surface on the second, and the mean pressure on
        the faces of both [Pa].
        """
        touch, weight, depth, force = self._felt(x, s, E)
        (rows, _), n = self._points(), self.faces.shape[1]
        pair = jnp.maximum(touch.pair, 0)
        is_first = jnp.asarray(self.ends)[pair, 0] == rows
        sign = jnp.where(is_first ^ jnp.asarray(self.swapped)[pair], 1.0, -1.0)
        of_nodes = sign[:, None, None] * force[:, :n]
        forces = jnp.sum(of_nodes, axis=1)
        moments = jnp.sum(jnp.cross(x[self.faces[rows]], of_nodes), axis=1)
        area = jnp.where(depth > 0.0, jnp.asarray(self.areas).ravel(), 0.0)
        surface = jnp.asarray(self.of)[pair]
        areas, pressure = jnp.asarray(self.areas), E * cushion_pressure(depth, s)

        def of(k: int) -> dict[str, Array]:
            its = (weight > 0.0) & (surface == k)
            total = lambda a: jnp.sum(jnp.where(its[:, None], a, 0.0), axis=0)
            return {
                "force": total(forces),
                "moment": total(moments),
                "area": jnp.sum(jnp.where(its, area, 0.0)),
                "depth": jnp.max(jnp.where(its, depth - 0.5 * s, 0.0), initial=0.0),
                "pressure": mean_over_faces(
                    jnp.where(its, pressure, 0.0).reshape(areas.shape), areas
                ),
            }

        return [of(k) for k in range(len(self.names))]
