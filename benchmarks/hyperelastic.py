"""Laws of rubber and fibres: solved blocks against closed forms, and Treloar's data.

A cube of quadratic tets, nearly incompressible (nu = 0.499, mean dilatation), is pulled
in one and in two directions, in pure and in simple shear; the force on its face over
its area is compared with the stress of the closed form, whose free stretch is solved
for with SciPy. Formulas are those of the authors, in NumPy.

Treloar's rubber (1944) was stretched up to 7.6 times. With Ogden's constants (1972) the
law must be as far from the data as his formula. The other laws are fitted here, to all
three tests at once, each in units of its largest stress.
"""

from collections.abc import Callable, Mapping
from typing import NamedTuple

import jax
import numpy as np
from scipy.optimize import least_squares, root_scalar

from benchmarks._cantilever import equilibrium, first_lane
from benchmarks._problem import Figure, Goal, Options, Outcome, Table
from benchmarks._treloar import MOONEY_RIVLIN_2012, OGDEN_1972, TRELOAR
from softcal_jax import Configuration, Fibre, Support, beam, build_model
from softcal_jax.configurations import configuration_arrays
from softcal_jax.equilibrium import internal_force
from softcal_jax.materials import (
    AbstractLaw,
    FibreReinforced,
    Gent,
    MooneyRivlin,
    Ogden,
    Yeoh,
)
from softcal_jax.mesh import boundary_faces

NU = 0.499
FIBRES = 20e6
"""Modulus of the fibres in the reinforced block, which is pulled along them [Pa]."""

Constants = Mapping[str, float]
Slopes = Callable[[Constants, np.ndarray], np.ndarray]
"""s_i dW/ds_i of principal stretches whose product is one [Pa]."""


def _mooney_rivlin(c: Constants, s: np.ndarray) -> np.ndarray:
    return 2.0 * c["c10"] * s**2 - 2.0 * c["c01"] * s**-2.0


def _yeoh(c: Constants, s: np.ndarray) -> np.ndarray:
    x = np.sum(s**2, axis=-1, keepdims=True) - 3.0
    return 2.0 * s**2 * (c["c10"] + 2.0 * c["c20"] * x + 3.0 * c["c30"] * x**2)


def _ogden(c: Constants, s: np.ndarray) -> np.ndarray:
    terms = [p for p in (1, 2, 3) if f"mu_{p}" in c]
    return np.sum([c[f"mu_{p}"] * s ** c[f"alpha_{p}"] for p in terms], axis=0)


def _gent(c: Constants, s: np.ndarray) -> np.ndarray:
    x = np.sum(s**2, axis=-1, keepdims=True) - 3.0
    return s**2 * c["mu"] * c["J_m"] / (c["J_m"] - x)


class Rubber(NamedTuple):
    """A law, its formula, and constants like those of silicone [SI]."""

    law: Callable[..., AbstractLaw]
    slopes: Slopes
    silicone: dict[str, float]


RUBBERS = {
    "mooney_rivlin": Rubber(MooneyRivlin, _mooney_rivlin, {"c10": 35e3, "c01": 9e3}),
    "yeoh": Rubber(Yeoh, _yeoh, {"c10": 44e3, "c20": -500.0, "c30": 60.0}),
    "ogden_1": Rubber(Ogden, _ogden, {"mu_1": 80e3, "alpha_1": 2.2}),
    "ogden_3": Rubber(
        Ogden,
        _ogden,
        {"mu_1": 63e3, "alpha_1": 1.3, "mu_2": 1.2e3, "alpha_2": 5.0}
        | {"mu_3": -10e3, "alpha_3": -2.0},
    ),
    "gent": Rubber(Gent, _gent, {"mu": 88e3, "J_m": 30.0}),
}

STRETCH, SHEAR = 2.0, 0.8

FREE: dict[str, Callable[[float, float], list[float]]] = {
    "uniaxial": lambda s, b: [s, b, b],
    "equibiaxial": lambda s, b: [s, s, b],
    "pure_shear": lambda s, b: [s, 1.0, b],
}
"""Principal stretches by the stretch s and that of the free faces, b."""


def closed_form(rubber: Rubber, kind: str, s: float, fibres: float = 0.0) -> float:
    """Nominal stress of a nearly incompressible block [Pa].

    The Kirchhoff stresses are the deviator of s dW/ds at the stretches without their
    volume change, and K/2 (J^2 - 1) in all directions.
    """
    c = rubber.silicone
    unit = rubber.slopes(c, np.array([1.0 + 1e-6, 1.0 / (1.0 + 1e-6), 1.0]))
    mu = (unit[0] - unit[1]) / 4e-6  # tau_1 - tau_2 = 2 mu (e_1 - e_2)
    bulk = 2.0 * mu * (1.0 + NU) / (3.0 * (1.0 - 2.0 * NU))

    def tau(stretches: list[float]) -> np.ndarray:
        lam = np.asarray(stretches)
        J = np.prod(lam)
        slopes = rubber.slopes(c, lam * J ** (-1.0 / 3.0))
        return slopes - slopes.mean() + 0.5 * bulk * (J * J - 1.0)

    if kind == "simple_shear":
        stretch = s / 2.0 + np.hypot(1.0, s / 2.0)
        first, second, _ = tau([stretch, 1.0 / stretch, 1.0])
        return float(s * (first - second) / (stretch**2 - stretch**-2))
    of = FREE[kind]
    solution = root_scalar(lambda b: tau(of(s, b))[2], bracket=(0.2, 1.5), xtol=1e-15)
    return float(tau(of(s, solution.root))[0] / s + fibres * (s - 1.0))


def solved(law: AbstractLaw, kind: str, s: float) -> float:
    """Force on the pulled face of a unit cube over its area at rest [Pa]."""
    mesh = beam(1.0, 1.0, 1.0, (2, 2, 2), order=2)
    model = build_model(mesh, law, density=1000.0)
    moved = {axis: (s - 1.0) * np.eye(3)[k] for k, axis in enumerate("xyz")}
    slide = [Support(f"{axis}_min", axis) for axis in "xyz"]
    pull = lambda axis: Support(f"{axis}_max", axis, tuple(moved[axis]))
    supports = {
        "uniaxial": [*slide, pull("x")],
        "equibiaxial": [*slide, pull("x"), pull("y")],
        "pure_shear": [*slide, pull("x"), Support("y_max", "y")],
    }
    if kind == "simple_shear":
        nodes = np.unique(boundary_faces(mesh))
        held = [
            Support(nodes[mesh.points[nodes, 1] == y], "xyz", (s * float(y), 0.0, 0.0))
            for y in np.unique(mesh.points[nodes, 1])
        ]
        supports[kind] = held
    configuration = Configuration(kind, supports[kind], (0.0, 0.0, 0.0))
    lane = first_lane(configuration_arrays(mesh, [configuration]))
    u = equilibrium(model, lane).displacement
    face = "y_max" if kind == "simple_shear" else "x_max"
    nodes = np.unique(mesh.faces(face))
    return float(np.sum(np.asarray(_forces(model, u))[nodes, 0]))


_forces = jax.jit(internal_force)


def nominal(rubber: Rubber, c: Constants, kind: str) -> np.ndarray:
    """Nominal stress at the stretches of a test, of incompressible rubber [Pa]."""
    s = TRELOAR[kind].stretch
    free = {"uniaxial": s**-0.5, "equibiaxial": s**-2.0, "pure shear": 1.0 / s}[kind]
    second = {"uniaxial": free, "equibiaxial": s, "pure shear": np.ones_like(s)}[kind]
    tau = rubber.slopes(c, np.stack([s, second, free], axis=-1))
    return (tau[:, 0] - tau[:, 2]) / s


def _of_law(law: AbstractLaw, kind: str) -> np.ndarray:
    """The same by the law itself, whose pressure is taken off at the free face."""
    s = TRELOAR[kind].stretch
    free = {"uniaxial": s**-0.5, "equibiaxial": s**-2.0, "pure shear": 1.0 / s}[kind]
    second = {"uniaxial": free, "equibiaxial": s, "pure shear": np.ones_like(s)}[kind]
    stretches = np.stack([s, second, free], axis=-1)
    P = np.asarray(_stresses(law, np.einsum("ni,ij->nij", stretches, np.eye(3))))
    return P[:, 0, 0] - P[:, 2, 2] * free / s


_stresses = jax.jit(lambda law, F: jax.vmap(law.stress)(F))


def _rms(stress: np.ndarray, kind: str) -> float:
    return float(np.sqrt(np.mean((stress - TRELOAR[kind].stress) ** 2)))


START = {
    "mooney_rivlin": {"c10": 0.17e6, "c01": 5e3},
    "yeoh": {"c10": 0.17e6, "c20": -1e3, "c30": 30.0},
    "gent": {"mu": 0.3e6, "J_m": 80.0},
}
"""Where the fits to Treloar's data begin [SI]."""


def fit(rubber: Rubber, start: Constants) -> dict[str, float]:
    """Fit constants to all tests, each in units of its largest stress."""
    names, scale = list(start), np.abs(list(start.values()))

    def residual(x: np.ndarray) -> np.ndarray:
        c = dict(zip(names, x * scale, strict=True))
        parts = [
            (nominal(rubber, c, kind) - test.stress) / test.stress.max()
            for kind, test in TRELOAR.items()
        ]
        return np.concatenate(parts)

    lower = [0.7 if name == "J_m" else -np.inf for name in names]
    solution = least_squares(
        residual,
        np.array(list(start.values())) / scale,
        bounds=(lower, np.inf),
        xtol=1e-14,
        ftol=1e-14,
    )
    return dict(zip(names, (float(v) for v in solution.x * scale), strict=True))


def run(options: Options) -> Outcome:
    """All blocks, then all fits."""
    figures: dict[str, Figure] = {}
    goals: dict[str, Goal] = {}
    rows = []

    def compare(name: str, kind: str, value: float, expected: float) -> None:
        key = f"{name}_{kind}_relative_error"
        figures[key] = abs(value / expected - 1.0)
        goals[key] = Goal("at most", 1e-8)
        rows.append([name, kind, f"{expected:.6g}", f"{figures[key]:.1e}"])

    for name, rubber in RUBBERS.items():
        options.say(f"blocks of {name}")
        law = rubber.law(**rubber.silicone, nu=NU)
        for kind in (*FREE, "simple_shear"):
            s = SHEAR if kind == "simple_shear" else STRETCH
            compare(name, kind, solved(law, kind, s), closed_form(rubber, kind, s))
    options.say("a block with fibres")
    rubber = RUBBERS["mooney_rivlin"]
    matrix = rubber.law(**rubber.silicone, nu=NU)
    for name, only in (("fibres", False), ("threads", True)):
        law = FibreReinforced(matrix, FIBRES, Fibre(0.0), tension_only=only)
        expected = closed_form(rubber, "uniaxial", STRETCH, FIBRES)
        compare(name, "uniaxial", solved(law, "uniaxial", STRETCH), expected)
    slack = FibreReinforced(matrix, FIBRES, Fibre(0.0), tension_only=True)
    # What is left of the push of a thread is 1e-4 of its modulus.
    expected = closed_form(rubber, "uniaxial", 0.8) - 1e-4 * FIBRES
    compare("threads", "compressed", solved(slack, "uniaxial", 0.8), expected)
    blocks = Table(
        "Blocks: stress of the closed form, error of the solved one",
        ["law", "test", "stress [Pa]", "relative error"],
        rows,
    )
    return Outcome(figures, goals=goals, tables=[blocks, _treloar(figures, goals)])


def _treloar(figures: dict[str, Figure], goals: dict[str, Goal]) -> Table:
    """Distances from Treloar's data, by law and test."""
    rows = []

    def against(name: str, rubber: Rubber, by_test: Mapping[str, Constants]) -> None:
        row = [name]
        for kind, c in by_test.items():
            rms = _rms(_of_law(rubber.law(**c), kind), kind)
            formula = _rms(nominal(rubber, c, kind), kind)
            key = f"{name}_treloar_{kind.replace(' ', '_')}"
            figures[f"{key}_rms_kpa"] = 1e-3 * rms
            figures[f"{key}_rms_off_formula"] = abs(rms / formula - 1.0)
            goals[f"{key}_rms_off_formula"] = Goal("at most", 1e-8)
            share = rms / TRELOAR[kind].stress.max()
            row.append(f"{1e-3 * rms:.1f} ({100.0 * share:.1f} %)")
        rows.append(row)

    ogden = RUBBERS["ogden_3"]
    against("ogden_published", ogden, dict.fromkeys(TRELOAR, OGDEN_1972))
    mooney = RUBBERS["mooney_rivlin"]
    against("mooney_rivlin_published", mooney, MOONEY_RIVLIN_2012)
    for name, start in START.items():
        c = fit(RUBBERS[name], start)
        figures |= {f"{name}_fitted_{key}": value for key, value in c.items()}
        against(f"{name}_fitted", RUBBERS[name], dict.fromkeys(TRELOAR, c))
    title = "Distance from Treloar's data, rms [kPa] (share of the largest stress)"
    return Table(title, ["constants", *TRELOAR], rows)
