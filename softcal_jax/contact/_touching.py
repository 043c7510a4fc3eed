"""Contact of the body with itself, between surfaces that are named, without friction.

Each quadrature point of a face, with half of its area A at rest, feels the cushion of
the module `_contacts` on the other surface: it adds A E phi(s / 2 - g) to the energy,
with g its distance from there. Both surfaces have points, half each, so that it is the
same which of them is named first (two half passes: Sauer and De Lorenzis, Comput.
Methods Appl. Mech. Eng. 253, 2013). The energy depends on places of nodes against each
other alone: forces come in pairs, equal and opposite on one line.

Which faces can meet is decided at rest, so that one program and one pattern of the
tangent serve every state. A point x looks for the nearest point y of its candidates.
With the normal n at y and a = (x - y) . n,

    g = a            where y lies inside of its face;
        |x - y|      where y lies on its edge, and x above,
        a + b - a b / s  below, with b = |x - y - a n|,

so that g is continuous where the nearest face changes, and nothing is felt beside a
surface that ends. Deeper than half of the tet behind a face nothing is felt either, and
no step may lead there.
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._module import Module
from softcal_jax._typing import Array, Bool, Float, HostArray, Int
from softcal_jax._units import readable
from softcal_jax.contact._cushion import cushion, cushion_pressure
from softcal_jax.elements import vector_length
from softcal_jax.mesh import (
    TetMesh,
    boundary_faces,
    boundary_tets,
    face_areas,
    face_indices,
    volumes,
)

BLOCK = 8  # faces or points that are looked at together, where one of them touches
_SAMPLES = 8  # states on the way of a step at which points are looked for inside

_NEAREST = 8  # candidates, by distance over size, among which the nearest face is
_GUESSES = 4  # steps to the foot of a point on a curved face, before the exact ones

_SLIDE = 2.0, 0.25
"""Default reach of a face, over its mean size, and over the way to the other [-]."""

MOST_PAIRS = 50_000
"""Pairs of faces; places of their tangents take 2.7 kB each, if quadratic."""

_NODES = ((0, 0), (1, 0), (0, 1), (0.5, 0), (0.5, 0.5), (0, 0.5))


class _Touch(NamedTuple):
    """What points touch: the number of the pair, or -1; the face, and where in it."""

    pair: Int[Array, "..."]
    partner: Int[Array, "..."]
    foot: Float[Array, "... 2"]


def _to_polynomial(n_fn: int) -> Float[HostArray, "6 n_fn"]:
    """Map places of nodes to coefficients of 1, a, b, a^2, a b and b^2 on a face."""
    a, b = np.transpose(_NODES[:n_fn])
    terms = np.stack([np.ones(n_fn), a, b, a * a, a * b, b * b][:n_fn], axis=1)
    return np.pad(np.linalg.inv(terms), ((0, 6 - n_fn), (0, 0)))


def _polynomial(Y: Float[Array, "n_fn 3"]) -> Float[Array, "6 3"]:
    return jnp.asarray(_to_polynomial(len(Y))) @ Y


def _place(C: Float[Array, "6 3"], t: Float[Array, "2"]):
    """Return a place on a face, and its tangents there [m]."""
    a, b = t
    y = C[0] + a * (C[1] + a * C[3] + b * C[4]) + b * (C[2] + b * C[5])
    return y, C[1] + 2.0 * a * C[3] + b * C[4], C[2] + a * C[4] + 2.0 * b * C[5]


def _step(C, x, t, *, exact: bool) -> Float[Array, "2"]:
    """Do a step of Newton's method, or of Gauss and Newton, to the foot of a point."""
    y, p, q = _place(C, t)
    r = x - y
    h, k = jnp.sum(r * p), jnp.sum(r * q)
    pp, pq, qq = jnp.sum(p * p), jnp.sum(p * q), jnp.sum(q * q)
    flat = pp * qq - pq * pq
    if exact:
        bend = jnp.sum(C[3:] * r[None], axis=1)
        a, b, c = pp - 2.0 * bend[0], pq - bend[1], qq - 2.0 * bend[2]
        # Beyond the centre of curvature there is no nearest point.
        near = a * c - b * b > 0.1 * flat
        pp, pq, qq = (jnp.where(near, *both) for both in ((a, pp), (b, pq), (c, qq)))
        flat = pp * qq - pq * pq
    return t + jnp.stack([qq * h - pq * k, pp * k - pq * h]) / flat


class _Place(NamedTuple):
    """Where a point lies from a face: g, a and |x - y| of the module's docstring [m].

    `inside` tells whether y lies inside of the face.
    """

    gap: Float[Array, ""]
    along: Float[Array, ""]
    away: Float[Array, ""]
    inside: Bool[Array, ""]


def _placed(C, x, t, s: Float[Array, ""]) -> _Place:
    """Tell where a point lies from a face, of which it knows the foot."""
    b = jnp.stack([1.0 - t[0] - t[1], t[0], t[1]])
    inside, within = jnp.all(b >= 0.0), jnp.maximum(b, 0.0)
    y, p, q = _place(C, jnp.where(inside, t, within[1:] / jnp.sum(within)))
    n, r = jnp.cross(p, q), x - y
    n = n / vector_length(n)
    along = jnp.sum(r * n)
    away, beside = vector_length(r), vector_length(r - along * n)
    below = along + beside - along * beside / s
    gap = jnp.where(inside, along, jnp.where(along > 0.0, away, below))
    return _Place(gap, along, away, inside)


def _foot(C, x) -> Float[Array, "2"]:
    # Far from a curved face its map folds: keep near the face.
    nearer = lambda _, t: jnp.clip(_step(C, x, t, exact=False), -1.0, 2.0)
    return jax.lax.fori_loop(0, _GUESSES, nearer, jnp.full(2, 1.0 / 3.0))


def _exact(C, x, t, n_fn: int) -> Float[Array, "2"]:
    """Return a foot that is nearly known, with its derivatives: by Newton's method."""
    for _ in range(1 if n_fn == 3 else 2):
        t = _step(C, x, t, exact=True)
    return t


def _gap(N, s, t, z: Float[Array, "m 3"]) -> Float[Array, ""]:
    """Compute g of a point at the nodes z of its face, then of the other [m]."""
    n = len(N)
    x, C = jnp.sum(N[:, None] * z[:n], axis=0), _polynomial(z[n:])
    return _placed(C, x, _exact(C, x, t, n), s).gap


def _stiffness(law, N, s, t, z) -> Float[Array, "m 3 m 3"]:
    """Differentiate the push of `Touching._felt`, with a law of pressure.

    Its foot follows from h = 0. Instead of the second derivatives of the foot, those of
    the Lagrangian g + mu . h are taken along its first ones.
    """
    n = len(N)
    x, C = jnp.sum(N[:, None] * z[:n], axis=0), _polynomial(z[n:])
    t = _exact(C, x, t, n)
    v = jnp.concatenate([x, C.ravel(), t])
    cut = lambda v: (v[3:21].reshape(6, 3), v[:3], v[21:])

    def h(v):
        C, x, t = cut(v)
        y, *tangents = _place(C, t)
        return jnp.stack([jnp.sum(tangent * (x - y)) for tangent in tangents])

    gap = lambda v: _placed(*cut(v), s).gap
    g, slope = jax.value_and_grad(gap)(v)
    of_h = jax.jacfwd(h)(v)
    (a, b), (c, d) = of_h[:, 21:]
    inverse = jnp.stack([jnp.stack([d, -b]), jnp.stack([-c, a])]) / (a * d - b * c)
    follows = -jnp.sum(inverse[:, :, None] * of_h[None, :, :21], axis=1)
    mu = -jnp.sum(slope[21:, None] * inverse, axis=0)
    bend = jax.hessian(lambda v: gap(v) + jnp.sum(mu * h(v)))(v)
    P = jnp.concatenate([jnp.eye(21), follows])
    slope, bend = slope @ P, P.T @ bend @ P
    p, dp = jax.value_and_grad(law)(0.5 * s - g, s)
    K = (dp * slope[:, None] * slope[None] - p * bend).reshape(7, 3, 7, 3)
    none = np.zeros((6, n))
    of_face = jnp.concatenate([N, jnp.zeros(n)])[None]
    B = jnp.concatenate([of_face, np.hstack([none, _to_polynomial(n)])])
    return jnp.einsum("ra,rich,cb->aibh", B, K, B)


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
            x, C = N @ X[row], jax.vmap(_polynomial)(X[partners])
            feet = jax.vmap(_foot, (0, None))(C, x)
            at = jax.vmap(_placed, (0, None, 0, None))(C, x, feet, s)
            felt = (pairs >= 0) & (at.along > -limits[partners])
            # Of faces that share the nearest edge, the one that lies below the point.
            k = jnp.argmin(jnp.where(felt, at.away - 1e-6 * at.along, jnp.inf))
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
        of_point = jax.vmap(jax.value_and_grad(_gap, 3), (0, None, 0, 0))
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
            of_point = jax.vmap(partial(_stiffness, law), (0, None, 0, 0))
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
            C, x = _polynomial(X[to]), N @ X[row]
            at = _placed(C, x, _foot(C, x), jnp.ones(()))
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
        """Compute force [N], moment [N m], area [m2] and depth [m] of each pair.

        That is the force of the first surface on the second.
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

        def of(k: int) -> dict[str, Array]:
            its = (weight > 0.0) & (surface == k)
            total = lambda a: jnp.sum(jnp.where(its[:, None], a, 0.0), axis=0)
            return {
                "force": total(forces),
                "moment": total(moments),
                "area": jnp.sum(jnp.where(its, area, 0.0)),
                "depth": jnp.max(jnp.where(its, depth - 0.5 * s, 0.0), initial=0.0),
            }

        return [of(k) for k in range(len(self.names))]


def face_size(mesh: TetMesh) -> float:
    """Return the mean size of the faces of a body [m]."""
    areas, _ = face_areas(mesh, boundary_faces(mesh))
    return float(np.sqrt(2.0 * areas.sum() / len(areas)))


def build_touching(
    mesh: TetMesh,
    stated: Sequence[tuple[str, str]],
    *,
    carrier: Int[HostArray, " n_nodes"],
    reach: float | None,
) -> Touching | None:
    """Find the pairs of faces that can meet; None if no surfaces are stated.

    A face can meet those of the other surface that lie across from it, as if a mirror
    stood between them: a mirror image that lies up to `reach` beside counts [m].
    `carrier` is the rigid body of each node, negative for none.

    Raises:
        ValueError: If there is no such surface, no pair, or too many of them.
    """
    if not stated:
        return None
    surface, tets = boundary_faces(mesh), boundary_tets(mesh)
    corners = mesh.points[surface[:, :3]]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    areas, N = face_areas(mesh, surface)
    size = face_size(mesh)
    found, of = [], []
    for k, names in enumerate(stated):
        first, second = (face_indices(mesh.faces(name), surface) for name in names)
        across = np.concatenate(
            [
                _across(corners.mean(axis=1), normal, some, second, reach, size)
                for some in np.array_split(first, 1 + len(first) // 100)
            ]
        )
        if names[0] == names[1]:
            across = across[_faces(corners.mean(axis=1), normal, across)]
        across = across[_can_meet(surface, carrier, across)]
        if not len(across):
            raise ValueError(
                f"no face of {names[0]!r} can meet one of {names[1]!r} in touching: "
                "none lies across from it at rest, shares no node with it and is not "
                "held by the same rigid body. Name other surfaces, or state a larger "
                "touching_reach."
            )
        found.append(across)
        of.append(np.full(len(across), k))
    both = np.concatenate(found)
    ends, once = np.unique(np.sort(both, axis=1), axis=0, return_index=True)
    if len(ends) > MOST_PAIRS:
        raise ValueError(
            f"touching has {len(ends)} pairs of faces that can meet, expected at most "
            f"{MOST_PAIRS}: name smaller surfaces, or state a touching_reach below "
            f"{readable(size * _SLIDE[0], 'm')}."
        )
    used, ends = np.unique(ends, return_inverse=True)
    ends = ends.reshape(-1, 2)
    n, pad = len(used), -len(used) % BLOCK
    counts = np.bincount(ends.ravel(), minlength=n)
    # Pairs of each face, one after the other.
    owner = ends.T.ravel()
    order = np.argsort(owner, kind="stable")
    place = np.arange(owner.size) - np.repeat(np.cumsum(counts) - counts, counts)
    pairs = np.full((n + pad, counts.max()), -1, np.int32)
    partners = np.repeat(np.arange(n + pad)[:, None], counts.max(), axis=1)
    pairs[owner[order], place] = np.tile(np.arange(len(ends)), 2)[order]
    partners[owner[order], place] = ends[:, ::-1].T.ravel()[order]
    padded = np.concatenate([used, np.repeat(used[:1], pad)])
    heights = 3.0 * volumes(mesh)[tets] / areas.sum(axis=1)
    return Touching(
        faces=surface[padded],
        areas=np.pad(0.5 * areas[used], ((0, pad), (0, 0))),
        limits=0.5 * heights[padded],
        partners=partners.astype(np.int32),
        pairs=pairs,
        ends=ends.astype(np.int32),
        swapped=both[once, 0] > both[once, 1],
        of=np.concatenate(of)[once].astype(np.int32),
        shape_functions=N,
        names=tuple(f"{first} on {second}" for first, second in stated),
    )


def _across(centre, normal, first, second, reach, size) -> Int[HostArray, "n 2"]:
    """List pairs of faces of which one is nearly the mirror image of the other."""
    way = centre[second][None] - centre[first][:, None]
    apart, far = normal[first][:, None] - normal[second][None], (way**2).sum(axis=2)
    along = [(normal[of] * way).sum(axis=2) for of in (first[:, None], second[None])]
    # Half of |way| |n - m| for the image n of the one normal, and the other, m.
    beside = far * (apart**2).sum(axis=2) + 4.0 * along[0] * along[1]
    beside = 0.5 * np.sqrt(np.maximum(beside, 0.0))
    slide = _SLIDE[0] * size + _SLIDE[1] * np.sqrt(far) if reach is None else reach
    i, j = np.nonzero((beside <= slide) & (first[:, None] != second[None]))
    return np.stack([first[i], second[j]], axis=1)


def _faces(centre, normal, pairs) -> Bool[HostArray, " n"]:
    """Tell which pairs of one surface see each other at rest, or lie on each other."""
    (i, j), least = pairs.T, 1e-9 * np.ptp(centre)
    way = centre[j] - centre[i]
    sees = (normal[i] * way).sum(axis=1) >= -least
    sees &= (normal[j] * way).sum(axis=1) <= least
    return sees & ((normal[i] * normal[j]).sum(axis=1) < 0.5)


def _can_meet(surface, carrier, pairs) -> Bool[HostArray, " n"]:
    """Tell which pairs share no node, and are not held together by a rigid body."""
    nodes = surface[pairs]
    apart = (nodes[:, 0, :, None] != nodes[:, 1, None]).all(axis=(1, 2))
    of = carrier[nodes]
    whole = np.where((of == of[:, :, :1]).all(axis=2), of[:, :, 0], -1)
    for a, b in ((0, 1), (1, 0)):
        same = (of[:, b] == whole[:, a, None]).any(axis=1)
        apart &= ~same | (whole[:, a] < 0)
    return apart
