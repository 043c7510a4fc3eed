"""Forces of a body by FElupe, to check the package's equilibria with.

It shares no code with the package. Elements, quadrature, assembly, mean dilatation and
all laws but two are FElupe's (https://github.com/adtzlr/felupe); those two are written
here from their formulas, as a `Material` of FElupe.
"""

import warnings
from collections.abc import Callable
from typing import Any, NamedTuple

import felupe as fem
import felupe.constitution.tensortrax as autodiff
import numpy as np
import tensortrax.math as tm
from felupe.math import ddot, det, svd
from scipy.sparse import csr_matrix, diags_array
from scipy.sparse.linalg import MatrixRankWarning, spsolve

EPS = float(np.finfo(float).eps)

STEP = 6e-6
"""By which F is changed for the differences of a stress [-], the cube root of EPS."""

_NEAR = (5.0 - np.sqrt(5.0)) / 20.0
RULE = fem.quadrature.Scheme(
    _NEAR + (1.0 - 4.0 * _NEAR) * np.eye(4)[:, 1:], np.full(4, 1.0 / 24.0)
)
"""Four points of a quadratic tet. FElupe's own have eight digits, which forces show."""


class Body(NamedTuple):
    """A body of straight-sided tets.

    Attributes:
        points: Node positions [m].
        tets: Four or ten nodes of each tet.
        law: A key of `LAWS`.
        constants: Its constants by name, one per tet.
        mean_dilatation: Whether each tet has one volume ratio.
        free: Which displacements are free, by node and axis.
        load: External forces on the nodes [N].
    """

    points: np.ndarray
    tets: np.ndarray
    law: str
    constants: dict[str, np.ndarray]
    mean_dilatation: bool
    free: np.ndarray
    load: np.ndarray


class Balance(NamedTuple):
    """Forces at a displacement.

    Attributes:
        internal: Internal forces on the nodes [N]; nan where a tet is inverted.
        rounding: Bound of what rounding does to their sums [N].
        min_det_F: Smallest det F.
    """

    internal: np.ndarray
    rounding: np.ndarray
    min_det_F: float


def _field(points: np.ndarray, tets: np.ndarray) -> fem.Field:
    """The displacement, on four or ten nodes of each tet."""
    if tets.shape[1] == 4:
        return fem.Field(fem.RegionTetra(fem.Mesh(points, tets, "tetra")), dim=3)
    mesh = fem.Mesh(points, tets, "tetra10")
    return fem.Field(fem.Region(mesh, fem.QuadraticTetra(), RULE), dim=3)


def weight(points: np.ndarray, tets: np.ndarray, force: np.ndarray) -> np.ndarray:
    """Forces on the nodes of a force per volume [N/m3]."""
    field = fem.FieldContainer([_field(points, tets)])
    load = fem.SolidBodyForce(field, values=force).assemble.vector()
    return load.toarray().reshape(points.shape)


def _neo_hookean(c):
    lam, mu = _lame(c)
    return fem.NeoHookeCompressible(mu=mu, lmbda=lam)


def _st_venant_kirchhoff(c):
    lam, mu = _lame(c)
    energy = autodiff.models.hyperelastic.saint_venant_kirchhoff
    return autodiff.Hyperelastic(energy, mu=mu, lmbda=lam)


def _lame(c):
    lam = c["E"] * c["nu"] / ((1.0 + c["nu"]) * (1.0 - 2.0 * c["nu"]))
    return lam, 0.5 * c["E"] / (1.0 + c["nu"])


def _corotational(c):
    shear = 0.5 * c["E"] / (1.0 + c["nu"])
    hooke = fem.LinearElasticOrthotropic(
        E=[c["E"]] * 3, nu=[c["nu"]] * 3, G=[shear] * 3
    )
    return _of_stretch(hooke, np.zeros_like(c["E"]))


def _transverse(c):
    """The fibre is the third axis of Hooke's law, phi its angle in the xy plane."""
    E_t, E_l, nu_t, nu_tl = (c[name] for name in ("E_t", "E_l", "nu_t", "nu_tl"))
    hooke = fem.LinearElasticOrthotropic(
        E=[E_t, E_t, E_l],
        nu=[nu_t, nu_tl, nu_tl * E_l / E_t],
        G=[0.5 * E_t / (1.0 + nu_t), c["mu_l"], c["mu_l"]],
    )
    return _of_stretch(hooke, c["phi"])


def _of_stretch(hooke: fem.LinearElasticOrthotropic, phi: np.ndarray) -> fem.Material:
    """The law 1/2 e : C : e of the stretch less one, e = V s V^T - 1 with F = U s V^T.

    In the principal axes de_ij = (s_i dF_ij + s_j dF_ji) / (s_i + s_j). FElupe's own
    law of this strain splits equal stretches by 1e-8, which small strains would show.
    """
    sin, cos, nil = np.sin(phi), np.cos(phi), np.zeros_like(phi)
    axes = np.array([[-sin, cos, nil], [nil, nil, nil + 1.0], [cos, sin, nil]])
    (C,) = hooke.hessian(shape=(1, len(phi)))

    def stress(F):
        U, s, Vt = svd(F)
        e = np.einsum("ai...,a...,aj...->ij...", Vt, s - 1.0, Vt)
        Q = np.broadcast_to(axes[:, :, None], F.shape)
        along = ddot(C, np.einsum("ai...,ij...,bj...->ab...", Q, e, Q), mode=(4, 2))
        S = np.einsum("ai...,ab...,bj...->ij...", Q, along, Q)
        S = np.einsum("ai...,ij...,bj...->ab...", Vt, S, Vt)
        share = 2.0 * s[:, None] / (s[:, None] + s[None])
        return np.einsum("ia...,ab...,bj...->ij...", U, S * share, Vt)

    return _by_differences(stress)


def _by_differences(stress: Callable[[np.ndarray], np.ndarray]) -> fem.Material:
    """A law by its first Piola-Kirchhoff stress P(F) [Pa] alone."""

    def hessian(x):
        F = x[0]
        A = np.empty((3, 3, *F.shape))
        for k, m in np.ndindex(3, 3):
            dF = np.zeros_like(F)
            dF[k, m] = STEP
            A[:, :, k, m] = (stress(F + dF) - stress(F - dF)) / (2.0 * STEP)
        return [A]

    return fem.Material(lambda x: [stress(x[0]), x[-1]], hessian)


def _ogden(c):
    """Terms mu_p / alpha_p (sum_i s_i^alpha_p - 3) of the isochoric stretches.

    FElupe's own Ogden law splits equal stretches by 1e-8, which small strains would
    show.
    """
    half_bulk = 0.5 * _bulk(c)

    def stress(F):
        U, s, Vt = svd(F)
        J = s.prod(axis=0)
        P = half_bulk * (J * J - 1.0) / s
        for p in ("1", "2"):
            power = (s / np.cbrt(J)) ** c[f"alpha_{p}"]
            P += c[f"mu_{p}"] * (power - power.mean(axis=0)) / s
        return np.einsum("ia...,a...,aj...->ij...", U, P, Vt)

    return _by_differences(stress)


def _bulk(c):
    return c["mu"] * 2.0 * (1.0 + c["nu"]) / (3.0 * (1.0 - 2.0 * c["nu"]))


def _rubber(distortion: Callable[..., Any]) -> Callable[..., fem.Material]:
    """The law of an energy of distortion, and K/4 (J^2 - 1 - 2 ln J)."""

    def energy(C, c):
        det_C = tm.linalg.det(C)
        return distortion(C, c) + 0.25 * _bulk(c) * (det_C - 1.0 - tm.log(det_C))

    return lambda c: autodiff.Hyperelastic(energy, c=c)


def _mooney_rivlin(C, c):
    return autodiff.models.hyperelastic.mooney_rivlin(C, c["c10"], c["c01"])


def _yeoh(C, c):
    return autodiff.models.hyperelastic.yeoh(C, c["c10"], c["c20"], c["c30"])


def _gent(C, c):
    """-mu J_m / 2 ln(1 - i1 / J_m), its root taken so that it ends in nan at J_m."""
    i1 = tm.linalg.det(C) ** (-1 / 3) * tm.trace(C) - 3.0
    return -c["mu"] * c["J_m"] * tm.log(tm.sqrt(1.0 - i1 / c["J_m"]))


LAWS: dict[str, Callable[[dict[str, np.ndarray]], Any]] = {
    "neo-hookean": _neo_hookean,
    "st-venant-kirchhoff": _st_venant_kirchhoff,
    "corotational": _corotational,
    "transverse": _transverse,
    "mooney-rivlin": _rubber(_mooney_rivlin),
    "yeoh": _rubber(_yeoh),
    "gent": _rubber(_gent),
    "ogden": _ogden,
}
"""FElupe's laws of constants that are given for each tet."""


_QUIETLY = np.errstate(invalid="ignore", over="ignore", divide="ignore")
"""What is inverted or torn apart has nan for forces, and that says it."""


class Assembly:
    """The forces and the tangent of a body at any displacement."""

    def __init__(self, body: Body):
        """Take what does not depend on the displacement.

        With mean dilatation a pressure and a volume ratio stand in each tet.
        """
        self.body = body
        u = _field(body.points, body.tets)
        self.region, fields = u.region, [u]
        self.volume = self.region.dV.sum(axis=0)
        law = LAWS[body.law](body.constants)
        if body.mean_dilatation:
            law = fem.ThreeFieldVariation(law)
            constant = fem.Region(
                self.region.mesh.dual(points_per_cell=1),
                fem.ConstantHexahedron(),  # one shape function, which is one
                self.region.quadrature,
                grad=False,
            )
            fields += [fem.Field(constant), fem.Field(constant)]
        self.field = fem.FieldContainer(fields)
        self.solid = fem.SolidBody(law, self.field)

    def _move(self, u: np.ndarray) -> float:
        """Set the fields at a displacement, and return the smallest det F.

        The volume ratio of a tet is the mean of det F, its pressure the mean of what
        the law says without one.
        """
        self.field[0].values[:] = u
        J = det(self.field.extract()[0])
        if self.body.mean_dilatation and np.all(J > 0.0):
            mean = lambda x: (x * self.region.dV).sum(axis=0) / self.volume
            pressure, ratio = (field.values[:, 0] for field in self.field[1:])
            pressure[:], ratio[:] = 0.0, mean(J)
            pressure[:] = mean(self.solid.evaluate.gradient(self.field)[2][0])
        return float(J.min())

    @_QUIETLY
    def balance(self, u: np.ndarray) -> Balance:
        """Internal forces at a displacement [m]."""
        min_det_F = self._move(u)
        internal = np.full(u.shape, np.nan)
        if min_det_F > 0.0:
            force = self.solid.assemble.vector(self.field)
            internal = force.toarray()[: u.size, 0].reshape(u.shape)
        return Balance(internal, self._rounding(u), min_det_F)

    def _rounding(self, u: np.ndarray) -> np.ndarray:
        """Bound of what rounding does to the forces on the nodes [N]."""
        tets, dN = self.body.tets, np.abs(self.region.dhdX)
        F = np.sqrt(3.0) + np.einsum("cai,ajqc->ijqc", np.abs(u[tets]), dN).max(
            axis=(0, 1)
        )
        stiff = self._stiffest() * self.region.dV * F**2
        each = 8.0 * EPS * np.einsum("qc,ajqc->ca", stiff, dN)
        rounding = np.zeros(len(u))
        np.add.at(rounding, tets, each)
        return rounding

    def _stiffest(self) -> np.ndarray:
        """The largest modulus of each tet, against change of volume [Pa]."""
        c = self.body.constants
        if "E_t" in c:
            return 10.0 * np.maximum(c["E_t"], c["E_l"])
        if "E" in c:
            return c["E"] * (1.0 + 1.0 / (1.0 - 2.0 * c["nu"]))
        return c["mu"] * (4.0 + 2.0 / (1.0 - 2.0 * c["nu"]))

    @_QUIETLY
    def tangent(self, u: np.ndarray) -> csr_matrix:
        """Derivative of the forces [N/m], without pressures and volume ratios."""
        self._move(u)
        K, *more = self.solid.assemble.matrix(self.field, block=False)
        if more:
            K_p, K_J, _, _, H = more
            by_volume = diags_array(1.0 / self.volume)
            both = K_p @ by_volume @ K_J.T
            K = K + both + both.T + K_p @ by_volume @ H @ by_volume @ K_p.T
        return csr_matrix(0.5 * (K + K.T))

    def on_free(self, u: np.ndarray) -> csr_matrix:
        """The tangent of the free displacements."""
        free = np.flatnonzero(self.body.free.ravel())
        return self.tangent(u)[free][:, free]


def solved(K: csr_matrix, g: np.ndarray) -> np.ndarray:
    """Displacements under forces; nan where the tangent is singular."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MatrixRankWarning)
        return np.asarray(spsolve(K, g))


def lowest_eigenvalue(K: csr_matrix) -> float:
    """Smallest eigenvalue of a tangent whose diagonal is scaled to one."""
    dense = K.toarray()
    scale = 1.0 / np.sqrt(np.maximum(np.abs(np.diag(dense)), 1e-300))
    return float(np.linalg.eigvalsh(dense * scale * scale[:, None])[0])


def equilibrium(assembly: Assembly, most: int = 40) -> np.ndarray | None:
    """Displacement under the full load, by load steps from rest; None if not found.

    Args:
        assembly: The body.
        most: Load steps that are tried, those that fail among them.
    """
    body, u, done, step = assembly.body, np.zeros_like(assembly.body.points), 0.0, 1.0
    for _ in range(most):
        load = min(1.0, done + step)
        try:
            u = _newton(assembly, u, load * body.load)
        except fem.tools.NewtonConvergenceError:
            step /= 2.0
            continue
        done, step = load, 2.0 * step
        if done >= 1.0:
            return u
    return None


def _newton(assembly: Assembly, u: np.ndarray, load: np.ndarray) -> np.ndarray:
    """FElupe's Newton method, with steps short enough that no tet is inverted."""
    free = assembly.body.free

    def moved(x):
        at = u.copy()
        at[free] = x
        return at

    def check(dx, x, f, **_):
        now = assembly.balance(moved(x))
        scale = max(np.linalg.norm(load), np.linalg.norm(now.internal))
        size = np.linalg.norm(f)
        small = size <= 1e-9 * scale + np.linalg.norm(now.rounding)
        return np.linalg.norm(dx), size, small

    solution = fem.newtonraphson(
        x0=u[free],
        fun=lambda x: (assembly.balance(moved(x)).internal - load)[free],
        jac=lambda x: assembly.on_free(moved(x)),
        solve=solved,
        check=check,
        maxiter=30,
        verbose=0,
        plugins=[fem.LinesearchPlugin(admissible=False, residual=False)],
    )
    return moved(solution.x)
