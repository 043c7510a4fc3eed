"""Random bodies: laws, elements, solvers, slivers, contrasts, tiny and absurd loads."""

import itertools
import warnings
from typing import NamedTuple

import numpy as np

from benchmarks import _oracle
from softcal_jax.configurations import (
    Configuration,
    ConfigurationArrays,
    NodalForces,
    configuration_arrays,
)
from softcal_jax.equilibrium import Model, build_model
from softcal_jax.materials import (
    AbstractLaw,
    Corotational,
    Fibre,
    Gent,
    Isotropic,
    MooneyRivlin,
    NeoHookean,
    Ogden,
    StVenantKirchhoff,
    TransverseIsotropic,
    Yeoh,
)
from softcal_jax.mesh import MeshWarning, TetMesh, beam, to_quadratic

DENSITY = 1000.0
SIZE = (0.1, 0.02, 0.02)
CELLS = (5, 2, 2)


class Kind(NamedTuple):
    """What a compiled program is made for."""

    law: str
    order: int
    formulation: str
    solver: str


KINDS = [
    Kind(law, order, formulation, solver)
    for law, (order, formulation), solver in itertools.product(
        _oracle.LAWS,
        ((1, "displacement"), (2, "displacement"), (2, "mean-dilatation")),
        ("pardiso", "klu"),
    )
]


class Drawn(NamedTuple):
    """A body as the package has it, and as the oracle has it."""

    model: Model
    configuration: ConfigurationArrays
    body: _oracle.Body


def draw(random: np.random.Generator, kind: Kind) -> Drawn:
    """Draw a body of a kind, with its support and load."""
    mesh = _mesh(random, kind.order)
    constants = _constants(random, kind.law, mesh)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MeshWarning)  # slivers are meant
        model = build_model(
            mesh,
            _law(kind.law, constants),
            density=DENSITY,
            formulation=kind.formulation,  # type: ignore[arg-type]
            solver=kind.solver,
        )
    soft = _softest(constants)
    size = soft * SIZE[1] * SIZE[2] * 10.0 ** random.uniform(-10.0, 0.5)
    push = size * random.normal(size=(1, 3)) * (random.random() < 0.7)
    node = mesh.node_groups["x_max"][[random.integers(len(mesh.node_groups["x_max"]))]]
    gravity = 9.81 * 10.0 ** random.uniform(-6.0, 4.0) * _unit(random)
    pose = Configuration("drawn", ("x_min",), tuple(gravity), NodalForces(node, push))
    load = _oracle.weight(mesh.points, mesh.tets, DENSITY * gravity)
    load[node] += push
    free = np.ones(mesh.points.shape, bool)
    free[mesh.points[:, 0] == 0.0] = False
    lanes = configuration_arrays(mesh, [pose])
    mean = kind.formulation == "mean-dilatation"
    body = _oracle.Body(mesh.points, mesh.tets, kind.law, constants, mean, free, load)
    return Drawn(model, _first(lanes), body)


def _softest(constants: dict[str, np.ndarray]) -> float:
    """The smallest modulus of a body [Pa]."""
    moduli = [constants[name] for name in ("E", "E_t", "E_l") if name in constants]
    return float(np.min(moduli or 3.0 * constants["mu"]))


def _first(lanes: ConfigurationArrays) -> ConfigurationArrays:
    import jax

    return jax.tree.map(lambda leaf: leaf[0], lanes)


def _unit(random: np.random.Generator) -> np.ndarray:
    way = random.normal(size=3)
    return way / np.linalg.norm(way)


def _mesh(random: np.random.Generator, order: int) -> TetMesh:
    """A beam whose inner nodes are moved, one of them until a tet is nearly flat."""
    mesh = beam(*SIZE, CELLS)
    points, tets = mesh.points.copy(), mesh.tets
    inside = np.flatnonzero(
        ((points > 1e-9) & (points < np.array(SIZE) - 1e-9)).all(axis=1)
    )
    cell = np.array(SIZE) / CELLS
    points[inside] += random.uniform(-0.3, 0.3, (len(inside), 3)) * cell
    if random.random() < 0.5:
        node = random.choice(inside)
        tet = random.choice(np.flatnonzero((tets == node).any(axis=1)))
        face = points[[n for n in tets[tet] if n != node]]
        normal = np.cross(face[1] - face[0], face[2] - face[0])
        normal /= np.linalg.norm(normal)
        height = (points[node] - face[0]) @ normal
        flat = points.copy()
        flat[node] -= (1.0 - 10.0 ** random.uniform(-4.0, -1.0)) * height * normal
        if (_volumes(flat, tets) > 0.0).all():
            points = flat
    moved = TetMesh(points, tets, mesh.node_groups, mesh.surface_groups)
    return moved if order == 1 else to_quadratic(moved)


def _volumes(points: np.ndarray, tets: np.ndarray) -> np.ndarray:
    corners = points[tets]
    return np.linalg.det(corners[:, 1:] - corners[:, :1])


def _constants(
    random: np.random.Generator, law: str, mesh: TetMesh
) -> dict[str, np.ndarray]:
    """Constants of each tet, with two regions that differ by up to a million."""
    n = mesh.n_tets
    contrast = 10.0 ** random.uniform(0.0, 6.0)
    one = random.random(n) < 0.5
    if random.random() < 0.5:
        one = mesh.centroids[:, 0] < random.uniform(0.0, SIZE[0])
    level = 10.0 ** random.uniform(3.0, 8.0) * np.where(one, contrast, 1.0)
    full = lambda value: np.full(n, value)
    if law in ("neo-hookean", "st-venant-kirchhoff", "corotational"):
        nu = random.choice([0.0, 0.3, 0.45, 0.499])
        return {"E": level, "nu": full(nu)}
    if law == "transverse":
        stiffer, nu_t = 10.0 ** random.uniform(-1.0, 1.0), random.uniform(0.0, 0.45)
        most = np.sqrt((1.0 - nu_t) / (2.0 * stiffer))
        return {
            "E_t": level,
            "E_l": stiffer * level,
            "nu_t": full(nu_t),
            "nu_tl": full(random.uniform(-0.9, 0.9) * most),
            "mu_l": random.uniform(0.1, 1.0) * level,
            "phi": random.uniform(0.0, np.pi, n),
        }
    nu = full(random.choice([0.45, 0.49, 0.499]))
    if law == "gent":
        return {"mu": level, "J_m": full(random.uniform(3.0, 100.0)), "nu": nu}
    if law == "mooney-rivlin":
        c01 = random.uniform(0.0, 0.5)
        return {
            "c10": level,
            "c01": c01 * level,
            "mu": 2.0 * (1.0 + c01) * level,
            "nu": nu,
        }
    if law == "yeoh":
        c30 = random.uniform(0.0, 0.01)
        more = {"c20": full(0.0), "c30": c30 * level, "mu": 2.0 * level}
        return {"c10": level, **more, "nu": nu}
    terms = {"mu_1": level, "alpha_1": full(1.3), "mu_2": 0.01 * level}
    mu = 0.5 * level * (1.3 + 0.05)
    return {**terms, "alpha_2": full(5.0), "mu": mu, "nu": nu}


_LAWS: dict[str, type[AbstractLaw]] = {
    "neo-hookean": NeoHookean,
    "mooney-rivlin": MooneyRivlin,
    "yeoh": Yeoh,
    "gent": Gent,
    "ogden": Ogden,
}


def _law(name: str, constants: dict[str, np.ndarray]) -> AbstractLaw:
    if name == "corotational":
        return Corotational(Isotropic(**constants))
    if name == "st-venant-kirchhoff":
        return StVenantKirchhoff(Isotropic(**constants))
    if name == "transverse":
        arguments = {k: v for k, v in constants.items() if k != "phi"}
        fibre = Fibre(constants["phi"], plane="xy")
        return Corotational(TransverseIsotropic(**arguments, fibre=fibre))
    law = _LAWS[name]
    # The oracle has the shear modulus of every rubber, also where it follows.
    arguments = {k: v for k, v in constants.items() if k in law.__dataclass_fields__}
    return law(**arguments)
