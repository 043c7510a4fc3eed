"""Forces of a body in plain NumPy, to check the package's equilibria with.

It shares no code with the package: shape functions, quadrature, stresses, assembly and
Newton's method are written here again, from the textbooks' formulas.
"""

import warnings
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.linalg import MatrixRankWarning, spsolve

EDGES = ((0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3))
"""Corners between which the further nodes of a quadratic tet stand, as in VTK."""

EPS = float(np.finfo(float).eps)


class Body(NamedTuple):
    """A body of straight-sided tets.

    Attributes:
        points: Node positions [m].
        tets: Four or ten nodes of each tet.
        law: A key of `STRESSES`.
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
        internal: Internal forces of each tet on its nodes [N].
        rounding: Bound of what rounding does to their sums [N].
        min_det_F: Smallest det F.
    """

    internal: np.ndarray
    rounding: np.ndarray
    min_det_F: float


def shape_gradients(points: np.ndarray, tets: np.ndarray):
    """Gradients at the quadrature points by tet, point, node, axis; and the weights."""
    corners = points[tets[:, :4]]
    sides = corners[:, 1:] - corners[:, :1]
    volume = np.linalg.det(sides) / 6.0
    columns = np.linalg.inv(sides).transpose(0, 2, 1)
    g = np.concatenate([-columns.sum(axis=1, keepdims=True), columns], axis=1)
    if tets.shape[1] == 4:
        return g[:, None], volume[:, None]
    a = 0.13819660112501053
    rule = np.full((4, 4), a) + (1.0 - 4.0 * a) * np.eye(4)
    of_corners = (4.0 * rule[None, :, :, None] - 1.0) * g[:, None]
    of_edges = [
        4.0
        * (
            rule[None, :, i, None] * g[:, None, j]
            + rule[None, :, j, None] * g[:, None, i]
        )
        for i, j in EDGES
    ]
    dN = np.concatenate([of_corners, np.stack(of_edges, axis=2)], axis=2)
    return dN, np.repeat(volume[:, None] / 4.0, 4, axis=1)


def weight(points: np.ndarray, tets: np.ndarray, force: np.ndarray) -> np.ndarray:
    """Forces on the nodes of a force per volume [N/m3], one for each tet."""
    volume = shape_gradients(points, tets)[1].sum(axis=1)
    share = np.full(4, 0.25) if tets.shape[1] == 4 else np.r_[[-0.05] * 4, [0.2] * 6]
    out = np.zeros_like(points)
    np.add.at(out, tets, (volume[:, None] * share)[..., None] * force[:, None])
    return out


def _neo_hookean(F, J, G, c):
    lam, mu = _lame(c)
    return mu * (F - G) + lam * np.log(J) * G


def _st_venant_kirchhoff(F, J, G, c):
    lam, mu = _lame(c)
    strain = 0.5 * (np.swapaxes(F, -1, -2) @ F - np.eye(3))
    return F @ (lam * _trace(strain) * np.eye(3) + 2.0 * mu * strain)


def _corotational(F, J, G, c):
    lam, mu = _lame(c)
    U, s, V = np.linalg.svd(F)  # det F > 0, so that U V is a rotation
    strain = s - 1.0
    P = lam[..., 0] * strain.sum(axis=-1, keepdims=True) + 2.0 * mu[..., 0] * strain
    return (U * P[..., None, :]) @ V


def _transverse(F, J, G, c):
    """The stress of 1/2 e : C : e with the stretch less one, e = V^T s V - I.

    In the principal axes de_ij = (s_i dF_ij + s_j dF_ji) / (s_i + s_j).
    """
    U, s, V = np.linalg.svd(F)
    e = np.swapaxes(V, -1, -2) @ (s[..., None] * V) - np.eye(3)
    inside = V @ _of_fibre(e, c) @ np.swapaxes(V, -1, -2)
    share = 2.0 * s[..., :, None] / (s[..., :, None] + s[..., None, :])
    return U @ (inside * share) @ V


def _of_fibre(strain, c):
    """The stress of a strain, by its compliance in axes with the fibre last."""
    phi = c["phi"][..., 0, 0]
    along = np.stack([np.cos(phi), np.sin(phi), 0.0 * phi], axis=-1)
    beside = np.stack([-np.sin(phi), np.cos(phi), 0.0 * phi], axis=-1)
    Q = np.stack([beside, np.cross(along, beside), along], axis=-2)
    back = np.swapaxes(Q, -1, -2)
    e = Q @ strain @ back
    E_t, E_l, nu_t, nu_tl = (c[k][..., 0, 0] for k in ("E_t", "E_l", "nu_t", "nu_tl"))
    S = np.zeros((*phi.shape, 3, 3))
    S[..., 0, 0] = S[..., 1, 1] = 1.0 / E_t
    S[..., 0, 1] = S[..., 1, 0] = -nu_t / E_t
    S[..., :2, 2] = S[..., 2, :2] = (-nu_tl / E_t)[..., None]
    S[..., 2, 2] = 1.0 / E_l
    normal = np.diagonal(e, axis1=-2, axis2=-1)[..., None]
    stress = np.zeros_like(e)
    stress[..., range(3), range(3)] = np.linalg.solve(S, normal)[..., 0]
    across, mu_l = E_t / (2.0 * (1.0 + nu_t)), c["mu_l"][..., 0, 0]
    for i, j, mu in ((0, 1, across), (0, 2, mu_l), (1, 2, mu_l)):
        stress[..., i, j] = stress[..., j, i] = 2.0 * mu * e[..., i, j]
    return back @ stress @ Q


def _volume(J, G, c):
    """The stress of K/4 (J^2 - 1 - 2 ln J)."""
    bulk = c["mu"] * 2.0 * (1.0 + c["nu"]) / (3.0 * (1.0 - 2.0 * c["nu"]))
    return 0.5 * bulk * (J * J - 1.0) * G


def _by_invariants(W_1, W_2):
    """The stress of a W by its derivatives by i1 and i2, and of the volume."""

    def stress(F, J, G, c):
        C = np.swapaxes(F, -1, -2) @ F
        I1 = _trace(C)
        I2 = 0.5 * (I1 * I1 - np.sum(C * C, axis=(-1, -2), keepdims=True))
        a, b = np.cbrt(J) ** -2, np.cbrt(J) ** -4
        d1 = 2.0 * a * (F - I1 / 3.0 * G)
        d2 = 2.0 * b * (I1 * F - F @ C - 2.0 / 3.0 * I2 * G)
        return W_1(a * I1 - 3.0, c) * d1 + W_2(c) * d2 + _volume(J, G, c)

    return stress


def _ogden(F, J, G, c):
    U, s, V = np.linalg.svd(F)
    isochoric = s / np.cbrt(J[..., 0])
    along = np.zeros_like(s)
    for p in ("1", "2"):
        power = isochoric ** c[f"alpha_{p}"][..., 0]
        mean = power.mean(axis=-1, keepdims=True)
        along += c[f"mu_{p}"][..., 0] * (power - mean) / s
    return (U * along[..., None, :]) @ V + _volume(J, G, c)


def _yeoh(x, c):
    return c["c10"] + 2.0 * c["c20"] * x + 3.0 * c["c30"] * x * x


def _gent(x, c):
    return np.where(x < c["J_m"], 0.5 * c["mu"] / (1.0 - x / c["J_m"]), np.nan)


STRESSES = {
    "neo-hookean": _neo_hookean,
    "st-venant-kirchhoff": _st_venant_kirchhoff,
    "corotational": _corotational,
    "transverse": _transverse,
    "mooney-rivlin": _by_invariants(lambda x, c: c["c10"], lambda c: c["c01"]),
    "yeoh": _by_invariants(_yeoh, lambda c: 0.0),
    "gent": _by_invariants(_gent, lambda c: 0.0),
    "ogden": _ogden,
}
"""First Piola-Kirchhoff stress of F, J = det F, G = F^-T and the constants [Pa]."""


def _lame(c):
    lam = c["E"] * c["nu"] / ((1.0 + c["nu"]) * (1.0 - 2.0 * c["nu"]))
    return lam, 0.5 * c["E"] / (1.0 + c["nu"])


def _trace(A):
    return np.trace(A, axis1=-2, axis2=-1)[..., None, None]


class Assembly:
    """The forces and the tangent of a body at any displacement."""

    def __init__(self, body: Body):
        """Take what does not depend on the displacement."""
        self.body = body
        self.dN, self.w = shape_gradients(body.points, body.tets)
        self.constants = {k: v[:, None, None, None] for k, v in body.constants.items()}
        n = body.points.size
        dofs = (3 * body.tets[..., None] + np.arange(3)).reshape(len(body.tets), -1)
        self._rows = np.repeat(dofs, dofs.shape[1], axis=1).ravel()
        self._columns = np.tile(dofs, dofs.shape[1]).ravel()
        self._shape = (n, n)

    def element_forces(self, of_tets: np.ndarray):
        """Forces of each tet on its nodes at its own displacements [N], and det F."""
        w, c = self.w, self.constants
        relative = of_tets - of_tets[:, :1]
        F = np.eye(3) + np.einsum("tni,tqnj->tqij", relative, self.dN)
        if not np.isfinite(F).all():
            return np.full_like(of_tets, np.nan), np.full((1,), np.nan)
        J = np.linalg.det(F)[..., None, None]
        if not np.all(J > 0.0):
            return np.full_like(of_tets, np.nan), J
        G = np.linalg.inv(F).transpose(0, 1, 3, 2)
        stress = STRESSES[self.body.law]
        if not self.body.mean_dilatation:
            P = stress(F, J, G, c)
        else:
            P = self._mean(stress, F, J, G)
        return np.einsum("tq,tqij,tqnj->tni", w, P, self.dN), J

    def _mean(self, stress, F, J, G):
        """The stress of a tet whose volume ratio is the same at all points.

        The energy of F_bar = (J_bar / J)^(1/3) F, J_bar = <J>, differentiated by F.
        """
        w = self.w[..., None, None]
        volume = w.sum(axis=1, keepdims=True)
        J_bar = (w * J).sum(axis=1, keepdims=True) / volume
        s = np.cbrt(J_bar / J)
        F_bar, mean = s * F, np.broadcast_to(J_bar, J.shape)
        P_bar = stress(F_bar, mean, G / s, self.constants)
        pressure = np.sum(P_bar * F_bar, axis=(-1, -2), keepdims=True) / 3.0
        common = (w * pressure).sum(axis=1, keepdims=True) / (J_bar * volume)
        return s * P_bar + (common * J - pressure) * G

    def balance(self, u: np.ndarray) -> Balance:
        """Internal forces at a displacement [m]."""
        f, J = self.element_forces(u[self.body.tets])
        F = np.sqrt(3.0) + np.abs(
            np.einsum("tni,tqnj->tqij", np.abs(u[self.body.tets]), np.abs(self.dN))
        ).max(axis=(-1, -2))
        stiff = self._stiffest()[:, None] * self.w * F**2
        each = 8.0 * EPS * np.einsum("tq,tqnj->tn", stiff, np.abs(self.dN))
        rounding = np.zeros(len(u))
        np.add.at(rounding, self.body.tets, each)
        out = np.zeros_like(u)
        np.add.at(out, self.body.tets, f)
        return Balance(out, rounding, float(J.min()))

    def _stiffest(self) -> np.ndarray:
        """The largest modulus of each tet, against change of volume [Pa]."""
        c = self.body.constants
        if "E_t" in c:
            return 10.0 * np.maximum(c["E_t"], c["E_l"])
        if "E" in c:
            return c["E"] * (1.0 + 1.0 / (1.0 - 2.0 * c["nu"]))
        return c["mu"] * (4.0 + 2.0 / (1.0 - 2.0 * c["nu"]))

    def tangent(self, u: np.ndarray) -> csr_matrix:
        """Central differences of the forces of all tets at once [N/m]."""
        of_tets = u[self.body.tets]
        # The height over the largest face bounds what a step may change.
        h = 6e-6 / np.abs(self.dN).max(axis=(1, 2, 3))
        columns = []
        for node, axis in np.ndindex(of_tets.shape[1:]):
            ends = []
            for sign in (1.0, -1.0):
                moved = of_tets.copy()
                moved[:, node, axis] += sign * h
                ends.append(self.element_forces(moved)[0])
            columns.append((ends[0] - ends[1]) / (2.0 * h)[:, None, None])
        K = np.stack(columns, axis=-1).reshape(len(of_tets), -1)
        full = csr_matrix((K.ravel(), (self._rows, self._columns)), self._shape)
        return (0.5 * (full + full.T)).tocsr()

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


def equilibrium(assembly: Assembly, most: int = 400) -> np.ndarray | None:
    """Displacement under the full load, by load steps from rest; None if not found."""
    body, u, done, step = assembly.body, np.zeros_like(assembly.body.points), 0.0, 1.0
    spent = 0
    while done < 1.0 and step > 1e-4 and spent < most:
        load = min(1.0, done + step)
        found, used = _newton(assembly, u, load * body.load)
        spent += used
        if found is None:
            step /= 2.0
        else:
            u, done, step = found, load, 2.0 * step
    return u if done >= 1.0 else None


def _newton(assembly: Assembly, u: np.ndarray, load: np.ndarray):
    free, used = assembly.body.free, 0
    last = np.inf
    for used in range(1, 31):
        now = assembly.balance(u)
        g = np.where(free, now.internal - load, 0.0)
        size = float(np.linalg.norm(g))
        scale = max(np.linalg.norm(load), np.linalg.norm(now.internal))
        if not np.isfinite(size) or size > 1e3 * last:
            return None, used
        if size <= 1e-9 * scale + np.linalg.norm(now.rounding):
            return u, used
        last = size
        du = np.zeros(free.shape)
        du[free] = -solved(assembly.on_free(u), g[free])
        if not np.isfinite(du).all():
            return None, used
        share = 1.0
        while share > 1e-3 and not assembly.balance(u + share * du).min_det_F > 0.0:
            share /= 2.0
        u = u + share * du
    return None, used
