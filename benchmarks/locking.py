"""Which element when: the error of each, from nu = 0.3 to the incompressible limit.

A silicone cantilever, 100 x 30 x 30 mm, under its own weight. The error is that of the
displacement of the free face's centre. The reference is independent: 27-node hexahedra
of FElupe in the three-field form, three meshes that each halve the cells of the one
before, extrapolated (Aitken). Our own solutions, extrapolated in the same way (`..._
extrapolated_off_percent`), say how far it can be trusted.

The error budget estimates the error on the mesh itself, from stresses that are
recovered as a continuous field; `estimate_over_error` says how well, over all elements,
meshes and Poisson's ratios.
"""

import math

import equinox as eqx
import numpy as np

from benchmarks._cantilever import (
    Beam,
    equilibrium,
    first_lane,
    nearest,
    own_weight,
    tip,
)
from benchmarks._felupe import mixed_hexahedra
from benchmarks._problem import Figure, Goal, Options, Outcome, Table
from softcal_jax import NeoHookean
from softcal_jax.equilibrium import Formulation, linearise, sensitivity
from softcal_jax.sensitivity import mesh_row, stress_patches

SIZE, E = (0.1, 0.03, 0.03), 265e3
POISSON = (0.3, 0.45, 0.49, 0.499)

Cells = tuple[int, int, int]

FULL, MEAN = "tet10_displacement", "tet10_mean_dilatation"
ELEMENTS: dict[str, tuple[int, Formulation]] = {
    "tet4": (1, "displacement"),
    FULL: (2, "displacement"),
    MEAN: (2, "mean-dilatation"),
}
CELLS: tuple[Cells, ...] = ((7, 2, 2), (10, 4, 4), (14, 4, 4), (20, 6, 6), (28, 8, 8))
HALVED: tuple[Cells, ...] = ((7, 2, 2), (14, 4, 4), (28, 8, 8))
GOALS = {
    "smallest_estimate_over_error": Goal("at least", 0.5),
    "largest_estimate_over_error": Goal("at most", 2.0),
}
REFERENCE: tuple[Cells, ...] = ((3, 2, 2), (6, 4, 4), (12, 8, 8))


def run(options: Options) -> Outcome:
    """The reference, every element on every mesh, and what follows from both."""
    figures: dict[str, Figure] = {}
    samples: dict[str, list[float]] = {}
    reference = {}
    for nu in POISSON:
        options.say(f"reference, nu = {nu}")
        meshes = [mixed_hexahedra(Beam(SIZE, E, nu), cells) for cells in REFERENCE]
        samples[f"reference_nu{nu}_tip_mm"] = _down_mm(meshes)
        reference[nu] = extrapolate(meshes)
        rest = _percent(meshes[-1], reference[nu])
        figures[f"reference_nu{nu}_tip_mm"] = -1e3 * float(reference[nu][2])
        figures[f"reference_nu{nu}_finest_mesh_off_percent"] = rest

    errors, ratios = {}, []
    for element in ELEMENTS:
        options.say(element)
        tips, estimates = _tips(element)
        for nu in POISSON:
            samples[f"{element}_nu{nu}_tip_mm"] = _down_mm([tips[c, nu] for c in CELLS])
            for cells in CELLS:
                error = _percent(tips[cells, nu], reference[nu])
                errors[element, nu, cells] = error
                off = float(reference[nu][2] - tips[cells, nu][2])
                ratios.append(estimates[cells, nu] / off)
                figures[f"{element}_nu{nu}_{_name(cells)}_error_percent"] = error
            halved = [tips[cells, nu] for cells in HALVED]
            figures[f"{element}_nu{nu}_order"] = observed_order(halved)
            if element != "tet4":
                extrapolated = _percent(extrapolate(halved), reference[nu])
                figures[f"{element}_nu{nu}_extrapolated_off_percent"] = extrapolated
    figures["smallest_estimate_over_error"] = min(ratios)
    figures["largest_estimate_over_error"] = max(ratios)
    figures["median_estimate_over_error"] = float(np.median(ratios))
    samples["estimate_over_error"] = ratios
    tables = [_error_table(errors), _advice_table(errors)]
    return Outcome(figures, samples, GOALS, tables)


Tips = dict[tuple[Cells, float], np.ndarray]


def _tips(element: str) -> tuple[Tips, dict[tuple[Cells, float], float]]:
    """Displacement of the tip and estimated error of its height [m], for every nu."""
    order, formulation = ELEMENTS[element]
    tips, estimates = {}, {}
    for cells in CELLS:
        model = Beam(SIZE, E, POISSON[0]).model(
            cells, order=order, formulation=formulation
        )
        lane = first_lane(own_weight(model))
        at_tip = nearest(model.mesh.points, tip(SIZE))
        patches = stress_patches(model)
        for nu in POISSON:  # one compilation serves all of them
            changed = model.with_law(NeoHookean(E, nu))
            u = equilibrium(changed, lane).displacement
            tips[cells, nu] = np.asarray(u[at_tip])
            moved = estimated_error(changed, lane, u, patches)
            estimates[cells, nu] = float(moved[at_tip, 2])
    return tips, estimates


@eqx.filter_jit
def estimated_error(model, lane, u, patches):
    """Exact minus computed displacement [m], as estimated on the mesh itself."""
    lin = linearise(model, lane, u)
    moved = sensitivity(lin, mesh_row(lin, patches)).displacement
    assert moved is not None
    return moved[0]


def observed_order(meshes: list[np.ndarray]) -> float:
    """Order of convergence of the deflection on three meshes, each cell halved."""
    coarse, middle, fine = (float(u[2]) for u in meshes)
    return math.log2(abs((middle - coarse) / (fine - middle)))


def extrapolate(meshes: list[np.ndarray]) -> np.ndarray:
    """Limit of three meshes, each cell halved, with the order that they show (Aitken).

    The order comes from the deflection, the largest component.
    """
    growth = 2.0 ** observed_order(meshes)
    return meshes[2] + (meshes[2] - meshes[1]) / (growth - 1.0)


def _percent(u: np.ndarray, reference: np.ndarray) -> float:
    """Signed error of the deflection [%]: negative is too stiff."""
    return float(100.0 * (u[2] / reference[2] - 1.0))


def _down_mm(displacements: list[np.ndarray]) -> list[float]:
    return [-1e3 * float(u[2]) for u in displacements]


def _name(cells: Cells) -> str:
    return "x".join(map(str, cells))


def _error_table(errors: dict[tuple[str, float, Cells], float]) -> Table:
    rows = [
        [f"{element}, nu {nu}", *(f"{errors[element, nu, c]:+.2f}" for c in CELLS)]
        for nu in POISSON
        for element in ELEMENTS
    ]
    title = "Error of the deflection [%] by cells (6 tets each); minus: too stiff"
    return Table(title, ["element", *map(_name, CELLS)], rows)


def _advice_table(errors: dict[tuple[str, float, Cells], float]) -> Table:
    """The coarsest mesh of each element that is off by at most 2 %."""
    rows = []
    for nu in POISSON:
        row = [f"nu {nu}"]
        for element in ELEMENTS:
            enough = [c for c in CELLS if abs(errors[element, nu, c]) <= 2.0]
            row.append(_name(enough[0]) if enough else "none")
        rows.append(row)
    return Table("Coarsest mesh within 2 %", ["", *ELEMENTS], rows)
