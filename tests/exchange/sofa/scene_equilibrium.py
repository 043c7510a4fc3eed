"""The equilibrium of a scene, from what it hands to SOFA and nothing else."""

import numpy as np

from benchmarks import _sofa_tets
from benchmarks._sofa_tets import Piece


def _elasticity(root, X, tets):
    (elastic,) = [
        component
        for name in (
            "TetrahedronFEMForceField",
            "CorotationalFEMForceField",
            "TetrahedronHyperelasticityFEMForceField",
            "TetrahedronAnisotropicForceField",
        )
        for component in root.find(name)
    ]
    data = elastic.data
    if elastic.component == "TetrahedronHyperelasticityFEMForceField":
        return _hyperelastic(X, tets, data["materialName"], *data["ParameterSet"])
    if elastic.component == "TetrahedronAnisotropicForceField":
        assert data["elasticitySymmetry"] == "transverseIsotropic"
        return _sofa_tets.tets(X, tets, _of_plugin(data), "large")
    stress = _sofa_tets.hooke(data["youngModulus"], data["poissonRatio"])
    for field in ("youngModulus", "poissonRatio"):
        assert len(data[field]) in (1, len(tets))
    if elastic.component == "CorotationalFEMForceField":
        assert data["rotationMethod"] == "polar"
        return _sofa_tets.tets(X, tets, stress, "procrustes")
    kind = {"polar": "edge", "large": "large"}[data["method"]]
    return _sofa_tets.tets(X, tets, stress, kind)


def _hyperelastic(X, tets, name, mu, lam):
    """NeoHookean and StVenantKirchhoff of SOFA, by their energies in its sources."""
    rest = np.swapaxes(X[tets][:, 1:] - X[tets][:, :1], 1, 2)
    inner = np.linalg.inv(rest)
    dN = np.concatenate([-inner.sum(axis=1, keepdims=True), inner], axis=1)
    volume = np.linalg.det(rest) / 6

    def force(x):
        F = np.einsum("eai,eaj->eij", x, dN)
        if name == "NeoHookean":
            G = np.swapaxes(np.linalg.inv(F), 1, 2)
            ln_J = np.log(np.linalg.det(F))[:, None, None]
            P = mu * (F - G) + lam * ln_J * G
        else:
            assert name == "StVenantKirchhoff"
            strain = 0.5 * (np.swapaxes(F, 1, 2) @ F - np.eye(3))
            trace = np.einsum("eii->e", strain)[:, None, None]
            P = F @ (lam * trace * np.eye(3) + 2 * mu * strain)
        return np.einsum("e,eij,eaj->eai", volume, P, dN)

    return Piece(tets, force)


def _of_plugin(data):
    """Stress in the axes v1, v2, n of each tet, by the plugin's five stiffnesses."""
    E_t, nu_t = np.array(data["youngModulus"]), np.array(data["poissonRatio"])
    kind, E_l, nu_tl, _ = np.array(data["anisotropyParameters"]).T
    assert np.all(kind == 2)
    nu_lt = nu_tl * E_l / E_t
    gamma = 1 / (1 - nu_t**2 - 2 * nu_lt * nu_tl - 2 * nu_t * nu_lt * nu_tl)
    c11 = E_t * gamma * (1 - nu_lt * nu_tl)
    c12 = E_t * gamma * (nu_t + nu_lt * nu_tl)
    c13 = E_t * gamma * (nu_lt + nu_t * nu_tl)
    c33 = E_l * gamma * (1 - nu_t**2)
    shear = E_t / (1 + nu_t)  # twice the modulus, in all planes
    n = np.array(data["anisotropyDirections"])
    n = n / np.linalg.norm(n, axis=1, keepdims=True)
    other = np.eye(3)[np.argmin(np.abs(n), axis=1)]
    v1 = np.cross(n, other)
    v1 /= np.linalg.norm(v1, axis=1, keepdims=True)
    axes = np.stack([v1, np.cross(n, v1), n], axis=1)

    def stress(strain):
        e = axes @ strain @ np.swapaxes(axes, 1, 2)
        s = shear[:, None, None] * e
        a, b, c = e[:, 0, 0], e[:, 1, 1], e[:, 2, 2]
        s[:, 0, 0] = c11 * a + c12 * b + c13 * c
        s[:, 1, 1] = c12 * a + c11 * b + c13 * c
        s[:, 2, 2] = c13 * (a + b) + c33 * c
        return np.swapaxes(axes, 1, 2) @ s @ axes

    return stress


def _springs(X, data):
    nodes, ways = np.array(data["points"])[:, None], np.array(data["activeDirections"])
    k = np.array(data["stiffness"])[:, None, None] * ways
    return Piece(nodes, lambda x: k * (x - X[nodes]))


def _chamber(data, dt):
    """Minus the push of a pressure along the normals of triangles."""
    assert data["valueType"] == "pressure"
    pressure = data["value"][0] / dt

    def force(x):
        normal = np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]) / 2
        return -pressure * np.repeat(normal[:, None] / 3, 3, axis=1)

    return Piece(np.array(data["triangles"]), force)


def _cable(X, tets, points, data, dt):
    """Minus the pull of a tension along a path of points in the tets at rest."""
    assert data["valueType"] == "force"
    tension = data["value"][0] / dt
    nodes, weights = _carried(X, tets, points)
    pulled = data.get("pullPoint", [0.0, 0.0, 0.0])
    fixed = data.get("hasPullPoint", True)

    def force(x):
        path = np.einsum("pk,pki->pi", weights, x[0].reshape(len(points), 4, 3))
        whole = np.vstack([pulled, path]) if fixed else path
        along = np.diff(whole, axis=0)
        along /= np.linalg.norm(along, axis=1, keepdims=True)
        pull = np.zeros_like(whole)
        pull[:-1] += along
        pull[1:] -= along
        pull = pull[1:] if fixed else pull
        return -tension * (weights[:, :, None] * pull[:, None]).reshape(1, -1, 3)

    return Piece(nodes.reshape(1, -1), force)


def _carried(X, tets, points):
    """Nodes and weights of the tets that hold points, as of BarycentricMapping."""
    first = X[tets[:, 0]]
    inverse = np.linalg.inv(np.swapaxes(X[tets][:, 1:] - first[:, None], 1, 2))
    nodes, weights = [], []
    for point in np.array(points):
        inner = np.einsum("eij,ej->ei", inverse, point - first)
        every = np.hstack([1 - inner.sum(axis=1, keepdims=True), inner])
        best = np.argmax(every.min(axis=1))
        assert every[best].min() > -1e-9, f"{point} lies outside the mesh"
        nodes.append(tets[best])
        weights.append(every[best])
    return np.array(nodes), np.array(weights)


def solve(root, load_steps=4):
    """Positions of the nodes at equilibrium, and at rest."""
    (state,) = (
        m for m in root.find("MechanicalObject") if m.data.get("name") == "state"
    )
    (container,) = root.find("TetrahedronSetTopologyContainer")
    X = np.array(state.data["rest_position"])
    tets, dt = np.array(container.data["tetrahedra"]), root.dt.value
    pieces = [_elasticity(root, X, tets)]
    pieces += [_springs(X, s.data) for s in root.find("RestShapeSpringsForceField")]
    pieces += [_chamber(c.data, dt) for c in root.find("SurfacePressureConstraint")]
    for child in root.children[0].children:
        (points,), (cable,) = (
            child.find(name) for name in ("MechanicalObject", "CableConstraint")
        )
        (mapping,) = child.find("BarycentricMapping")
        assert mapping.data["useRestPosition"]
        pieces.append(_cable(X, tets, points.data["position"], cable.data, dt))
    (mass,) = root.find("DiagonalMass")
    load = np.array(mass.data["vertexMass"])[:, None] * np.array(root.gravity.value)
    for force in root.find("ConstantForceField"):
        np.add.at(load, np.array(force.data["indices"]), np.array(force.data["forces"]))
    free = np.ones(X.shape, bool)
    for fix in root.find("FixedProjectiveConstraint"):
        free[fix.data["indices"]] = False
    for fix in root.find("PartialFixedProjectiveConstraint"):
        held = np.ix_(fix.data["indices"], np.flatnonzero(fix.data["fixedDirections"]))
        free[held] = False
    start = np.array(state.data["position"])
    x = _sofa_tets.equilibrium(
        X, pieces, load, free, start=start, load_steps=load_steps
    )
    return x, X
