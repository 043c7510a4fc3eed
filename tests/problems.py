"""Reference problems with their sources, and how their meshes and figures are made.

Nothing here calls the physics of the package: numbers come from closed forms, from the
named publications, or from an ordinary differential equation solved by SciPy.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy.integrate import solve_bvp

from softcal_jax.elements import TET_EDGES, shape_functions, shape_gradients, tet_rule
from softcal_jax.mesh import TetMesh, beam, boundary_faces, to_quadratic


class Tip(NamedTuple):
    """Where the tip of a clamped beam of length one goes."""

    down: float
    retract: float


# Inextensible elastica, clamp horizontal: theta'' = -alpha cos theta, theta(0) = 0,
# theta'(1) = 0. Bisshopp and Drucker, Quart. Appl. Math. 3 (1945), recomputed to
# nine digits. alpha = P L^2 / (E I).
ELASTICA_END_LOAD = {
    0.5: Tip(0.162143576, 0.015918962),
    1.0: Tip(0.301720774, 0.056433236),
    2.0: Tip(0.493457480, 0.160641721),
    5.0: Tip(0.713791524, 0.387628361),
}

# The same under its own weight w per length: theta'' = -kappa (1 - s) cos theta,
# kappa = w L^3 / (E I).
ELASTICA_OWN_WEIGHT = {
    0.5: Tip(0.062305768, 0.002221000),
    1.0: Tip(0.123471402, 0.008753605),
    2.0: Tip(0.238506583, 0.033107053),
    5.0: Tip(0.495905045, 0.153342820),
}

# d ln(down) / d ln E and d ln(retract) / d ln E of the elastica under its own weight;
# linear theory knows -1 and -2 only.
ELASTICA_SENSITIVITY = {
    1.0: Tip(-0.97577445, -1.96101527),
    2.0: Tip(-0.91125624, -1.85679732),
    5.0: Tip(-0.64530484, -1.41885948),
}

# Quadratic tets, L/h = 20, 60x2x2 cells of 6 tets, St. Venant-Kirchhoff, nu = 0, own
# weight kappa = 5: computed with another code.
SOLID_KAPPA_5 = Tip(0.497474, 0.154189)

# An upright column buckles under its own weight at this kappa: Greenhill, Proc. Camb.
# Phil. Soc. 4 (1881), first zero of the Bessel function J_{-1/3}.
GREENHILL_KAPPA = 7.8373474

# Compressible neo-Hookean (ln J) bar, E = 1, nu = 0.3: stretch, lateral stretch, P.
NEO_HOOKEAN_UNIAXIAL = [
    (1.3, 0.921999955, 0.248495883),
    (0.7, 1.107934733, -0.405230424),
]

# Cook's membrane, quasi-static finite-strain elasticity of the deal.II code gallery:
# rise of the point (48, 52) mm.
COOK_RISE = 14.74e-3
COOK_MU, COOK_NU = 0.4225e6, 0.3


def shear_beam(kappa: float, slenderness: float, *, kirchhoff: float = 1.0) -> Tip:
    """Tip of a clamped beam under its weight with shear and stretch, for nu = 0.

    Reissner's beam (ZAMP 23, 1972), L = E I = 1, square section of side h: with n the
    force in the section, t and m its normal and its transverse, shear factor 5/6,
    r' = (1 + n.t / EA) t + (n.m / kGA) m and E I theta'' = -(r' x n).

    St. Venant-Kirchhoff fibres have the stress E (e + 3/2 e^2 + e^3 / 2) at the strain
    e = e0 - k y. To second order in k h a section under no axial force has then
    e0 = -(k h)^2 / 8 and the moment E I k (1 - 3/10 (k h)^2); `kirchhoff = 0` leaves
    both out.
    """
    h = 1.0 / slenderness
    EA = 12.0 * slenderness**2
    GA = 5.0 / 6.0 * EA / 2.0

    def rates(s, y):
        theta, M = y[:2]
        t = np.array([np.cos(theta), np.sin(theta)])
        m = np.array([-np.sin(theta), np.cos(theta)])
        n = np.array([np.zeros_like(s), -kappa * (1.0 - s)])
        k = M * (1.0 + 0.3 * kirchhoff * (M * h) ** 2)
        stretch = 1.0 + np.sum(n * t, 0) / EA - kirchhoff * (k * h) ** 2 / 8.0
        r = stretch * t + np.sum(n * m, 0) / GA * m
        return np.array([k, -(r[0] * n[1] - r[1] * n[0]), r[0], r[1]])

    def ends(a, b):
        return np.array([a[0], b[1], a[2], a[3]])

    s = np.linspace(0.0, 1.0, 101)
    solution = solve_bvp(rates, ends, s, np.stack([-0.5 * s, -0.5 + s, s, s]), tol=1e-8)
    assert solution.success
    return Tip(-solution.y[3, -1], 1.0 - solution.y[2, -1])


class Plane(NamedTuple):
    """Where the end of a beam of length one is, in the plane in which it bends."""

    x: float
    z: float
    angle: float


class PulledBeam(NamedTuple):
    """A beam bent by a cable."""

    tip: Plane
    shortening: float


def cable_beam(tension: float, offset: float, slenderness: float) -> PulledBeam:
    """A clamped beam whose tip a cable pulls towards the plane of the clamp.

    Reissner's beam as in `shear_beam`, without weight: the force n in it is that of
    the cable on a guide at `offset` above the tip, of which it knows the direction only
    when it is solved: two parameters of the boundary value problem.
    """
    EA = 12.0 * slenderness**2
    GA = 5.0 / 6.0 * EA / 2.0

    def guide(y):
        return y[2:] + offset * np.array([-np.sin(y[0]), np.cos(y[0])])

    def rates(s, y, n):
        theta, M = y[:2]
        t = np.array([np.cos(theta), np.sin(theta)])
        m = np.array([-np.sin(theta), np.cos(theta)])
        r = (1.0 + n @ t / EA) * t + n @ m / GA * m
        return np.array([M, -(r[0] * n[1] - r[1] * n[0]), r[0], r[1]])

    def ends(a, b, n):
        line = np.array([0.0, offset]) - guide(b)
        arm = guide(b) - b[2:]
        moment = arm[0] * n[1] - arm[1] * n[0]
        pull = tension * line / np.linalg.norm(line)
        return np.array([a[0], b[1] - moment, a[2], a[3], *(pull - n)])

    s = np.linspace(0.0, 1.0, 101)
    start = np.stack([0.0 * s, tension * offset + 0.0 * s, s, 0.0 * s])
    solution = solve_bvp(rates, ends, s, start, p=[-tension, 0.0], tol=1e-8)
    assert solution.success
    end = solution.y[:, -1]
    length = float(np.linalg.norm(guide(end) - np.array([0.0, offset])))
    return PulledBeam(Plane(end[2], end[3], end[0]), 1.0 - length)


class ToggleFrame(NamedTuple):
    """Williams' toggle frame: half of it, its section and its material, in SI units."""

    half_span: float
    rise: float
    width: float
    depth: float
    E: float
    pound: float

    @property
    def length(self) -> float:
        """Length of one member."""
        return float(np.hypot(self.half_span, self.rise))


def _toggle() -> ToggleFrame:
    inch, pound = 0.0254, 4.4482216152605
    spans = np.array([0.5 * 25.886, 0.386, 0.753, 0.243]) * inch
    return ToggleFrame(*spans.tolist(), E=1.03e7 * pound / inch**2, pound=pound)


# Two members clamped at their outer ends, with a load on the crown; span, rise, width
# and depth [in], E [lb/in2]: Williams, Q. J. Mech. Appl. Math. 17 (1964), 451-469.
TOGGLE = _toggle()


def toggle_loads(deflections: np.ndarray) -> np.ndarray:
    """Loads on the crown of `TOGGLE` at its deflections, from small to large [N].

    Reissner's beam as in `shear_beam`, for nu = 0: a member whose ends keep their slope
    while the crown goes down. The force n in it, half the load and the thrust, is a
    parameter of the boundary value problem.
    """
    length, A = TOGGLE.length, TOGGLE.width * TOGGLE.depth
    EA, EI = TOGGLE.E * A, TOGGLE.E * A * TOGGLE.depth**2 / 12.0
    GA, slope = 5.0 / 6.0 * EA / 2.0, np.arctan2(TOGGLE.rise, TOGGLE.half_span)
    unit = EI / length**2

    def rates(s, y, n):
        theta, M = y[:2]
        t = np.array([np.cos(theta), np.sin(theta)])
        m = np.array([-np.sin(theta), np.cos(theta)])
        r = (1.0 + unit * n @ t / EA) * t + unit * n @ m / GA * m
        return np.array([M, -(r[0] * n[1] - r[1] * n[0]), r[0], r[1]])

    s = np.linspace(0.0, 1.0, 41)
    half, rise = TOGGLE.half_span / length, TOGGLE.rise / length
    state, n = np.stack([slope + 0.0 * s, 0.0 * s, half * s, rise * s]), np.zeros(2)
    loads = []
    for down in deflections / length:
        crown = np.array([half, rise - down])
        ends = lambda a, b, _, crown=crown: np.array(
            [a[0] - slope, a[2], a[3], b[0] - slope, *(b[2:] - crown)]
        )
        solution = solve_bvp(rates, ends, s, state, p=n, tol=1e-8)
        assert solution.success
        state, n = solution.sol(s), solution.p
        loads.append(-2.0 * unit * n[1])
    return np.array(loads)


class Shell(NamedTuple):
    """Radial displacements of the surfaces of a sphere, inner radius 1 and outer 2."""

    inner: float
    outer: float


def lame_sphere(p: float, E: float, nu: float) -> Shell:
    """Thick sphere under a small inner pressure: Lame (Timoshenko and Goodier, 1970).

    u = p a^3 / (E (b^3 - a^3)) [(1 - 2 nu) r + (1 + nu) b^3 / 2 r^2].
    """
    a, b = 1.0, 2.0
    factor = p * a**3 / (E * (b**3 - a**3))
    u = lambda r: factor * ((1 - 2 * nu) * r + (1 + nu) * b**3 / (2 * r**2))
    return Shell(u(a), u(b))


class Balloon(NamedTuple):
    """A thick incompressible sphere, inner radius 1 and outer 2."""

    pressure: float
    outer_stretch: float


def neo_hookean_sphere(stretch: float) -> Balloon:
    """Inner pressure, in shear moduli, at a stretch of the inner surface.

    Incompressible neo-Hookean solid (Green and Zerna, Theoretical Elasticity; Ogden,
    Non-Linear Elastic Deformations, sec. 5.3): p / mu = g(l_b) - g(l_a) with g(l) =
    2 / l + 1 / 2 l^4, and b^3 (l_b^3 - 1) = a^3 (l_a^3 - 1).
    """
    outer = (1.0 + (stretch**3 - 1.0) / 8.0) ** (1 / 3)
    g = lambda stretch: 2.0 / stretch + 0.5 / stretch**4
    return Balloon(g(outer) - g(stretch), outer)


def irregular_cube(cells: int, order: int, *, seed: int = 0) -> TetMesh:
    """Unit cube whose inner nodes are moved by up to a sixth of a cell."""
    mesh = beam(1.0, 1.0, 1.0, (cells, cells, cells))
    move = np.random.default_rng(seed).uniform(-1.0, 1.0, mesh.points.shape)
    move[np.unique(boundary_faces(mesh))] = 0.0
    moved = TetMesh(mesh.points + move / (6.0 * cells), mesh.tets)
    return moved if order == 1 else to_quadratic(moved)


def cook_mesh(cells: int) -> TetMesh:
    """Cook's membrane, quadratic tets: (0,0) (48,44) (48,60) (0,44) mm, thickness 1."""
    box = beam(1.0, 1.0, 1.0, (cells, cells, 1), order=2)
    s, t, z = box.points.T
    lower, upper = 44.0 * s, 44.0 + 16.0 * s
    points = 1e-3 * np.stack([48.0 * s, lower + t * (upper - lower), z], axis=1)
    return TetMesh(points, box.tets, box.node_groups, box.surface_groups)


def boundary_nodes(mesh: TetMesh) -> np.ndarray:
    """All nodes of the boundary, once each."""
    return np.unique(boundary_faces(mesh))


def nearest_node(mesh: TetMesh, point: tuple[float, float, float]) -> int:
    """The node that stands at a point; fails where there is none."""
    distance = np.linalg.norm(mesh.points - np.array(point), axis=1)
    assert distance.min() < 1e-9 * mesh.size
    return int(np.argmin(distance))


class Quadrature(NamedTuple):
    """Points of integration of a whole mesh, of degree 4."""

    points: np.ndarray
    weights: np.ndarray
    values: np.ndarray

    @classmethod
    def of(cls, mesh: TetMesh) -> "Quadrature":
        rule, n_en = tet_rule(4), mesh.tets.shape[1]
        N = shape_functions(rule.barycentric, n_en)
        dN = shape_gradients(rule.barycentric, n_en)
        X = mesh.points[mesh.tets]
        det = np.linalg.det(np.einsum("tai,qaj->tqij", X, dN))
        return cls(np.einsum("qa,tai->tqi", N, X), det / 6.0 * rule.weights, N)


def manufactured_displacement(X, amplitude=0.05):
    """u = A sin(pi x) sin(pi y) sin(pi z) (1, 2, -1), zero on the unit cube's sides."""
    wave = jnp.prod(jnp.sin(jnp.pi * X))
    return amplitude * wave * jnp.array([1.0, 2.0, -1.0])


@jax.jit
def manufactured_body_force(X):
    """b = -Div P of the neo-Hookean (ln J) solid with E = 1 and nu = 0.3, at points X.

    The stress is written with the inverse of F, independently of the package.
    """
    E, nu = 1.0, 0.3
    lam, mu = E * nu / ((1 + nu) * (1 - 2 * nu)), E / (2 * (1 + nu))

    def stress(X):
        F = jnp.eye(3) + jax.jacfwd(manufactured_displacement)(X)
        inverse = jnp.linalg.inv(F)
        return mu * (F - inverse.T) + lam * jnp.log(jnp.linalg.det(F)) * inverse.T

    def force(X):
        return -jnp.trace(jax.jacfwd(stress)(X), axis1=1, axis2=2)

    return jax.vmap(force)(X)


def central_difference(function, x, tangent, h):
    """(f(x + h t) - f(x - h t)) / 2h along a tangent."""
    plus = function(jax.tree.map(lambda a, t: a + h * t, x, tangent))
    minus = function(jax.tree.map(lambda a, t: a - h * t, x, tangent))
    return jax.tree.map(lambda p, m: (p - m) / (2.0 * h), plus, minus)


def assert_second_order(function, x, tangent, derivative, steps, rtol=0.05):
    """Fail unless central differences miss a derivative by an error of second order.

    That of two steps then is as their squares, up to terms of fourth order.
    """
    coarse, fine = (
        np.max(np.abs(central_difference(function, x, tangent, h) - derivative))
        for h in steps
    )
    np.testing.assert_allclose(coarse / fine, (steps[0] / steps[1]) ** 2, rtol=rtol)


class BothWays(NamedTuple):
    """A function's value, its derivative along a tangent, and its pull-back."""

    value: Any
    forward: Any
    reverse: Any


def both_ways(function):
    """Make one program of a function and its derivatives, forward and reverse.

    Each of the three alone would compile the solves in the function once more.

    Args:
        function: Takes `x` and any other arrays, which are held.

    Returns:
        A compiled function of (x, tangent, cotangent, *others).
    """

    @jax.jit
    def of(x, tangent, cotangent, *others):
        value, along = jax.linearize(lambda x: function(x, *others), x)
        (reverse,) = jax.linear_transpose(along, x)(cotangent)
        return BothWays(value, along(tangent), reverse)

    return of


def lane_of(lanes, index=0):
    """One lane of a batch.

    Sliced on the host: on the device, each shape of an array compiles two programs.
    """
    return jax.device_put(jax.tree.map(lambda leaf: np.asarray(leaf)[index], lanes))


def straight_mid_nodes(mesh: TetMesh) -> np.ndarray:
    """Positions of the mid nodes of straight edges, tet by tet."""
    return mesh.points[mesh.tets][:, np.array(TET_EDGES)].mean(axis=2)


# Young's modulus of the reduced transversely isotropic set with (E_t, E_l) = (1000,
# 250), load and fibre at an angle in degrees, any nu: E(theta) = 1 / (cos^2 / sqrt(E_l)
# + sin^2 / sqrt(E_t))^2, evaluated by hand.
REDUCED_OFF_AXIS = [(0.0, 250.0), (30.0, 326.530612), (45.0, 444.444444), (90.0, 1e3)]


class Foam(NamedTuple):
    """Transversely isotropic foam: moduli in kPa, fibre along the soft axis."""

    E_t: float
    E_l: float
    nu_t: float
    nu_tl: float
    mu_l: float


# Published homogenised foam of the parallel robot of the paper's Sec. VI.
FOAM_OF_THE_ROBOT = Foam(1390.0, 94.22, 0.26162, 0.4161, 16.28)


class OrthotropicFoam(NamedTuple):
    """Published homogenised foam over the solid's moduli; x is the soft axis."""

    Ex: float
    Ey: float
    Ez: float
    nu_zx: float
    nu_yz: float
    Gzx: float
    Gxy: float


# Young's and shear modulus of the solid TPU [kPa], and foams of density .0918 to .3422.
FOAM_SOLID_MODULI = (12e3, 4615.0)
ORTHOTROPIC_FOAM = [
    OrthotropicFoam(
        7.19095e-3, 0.0677105, 0.0618133, 0.38956, 0.24037, 2.8035e-3, 2.7014e-3
    ),
    OrthotropicFoam(
        8.23011e-3, 0.1462979, 0.1372145, 0.42970, 0.27253, 4.0740e-3, 3.8334e-3
    ),
    OrthotropicFoam(
        9.43911e-3, 0.2214149, 0.2104164, 0.47179, 0.27893, 5.4764e-3, 5.1390e-3
    ),
    OrthotropicFoam(
        1.094113e-2, 0.2942527, 0.2842800, 0.50585, 0.28156, 7.1086e-3, 6.6729e-3
    ),
]
