"""Which element when: the error of each, from nu = 0.3 to the incompressible limit.

A silicone cantilever, 100 x 30 x 30 mm, under its own weight. The error is that of the
displacement of the free face's centre. The reference is independent: 27-node hexahedra
of FElupe in the three-field form, three meshes that each halve the cells of the one
before, extrapolated (Aitken). Our own solutions, extrapolated in the same way (`..._
extrapolated_off_percent`), say how far it can be trusted.

The error budget takes the change on a finer mesh for the standard deviation: quadratic
tets in place of linear ones, and halved cells of these. `error_over_change` says what
errors are in these units, over the meshes that have a finer one and Poisson's ratios.
"""

import math
from itertools import pairwise

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
from softcal_jax.equilibrium import Formulation

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
GOALS = {"largest_error_over_change": Goal("at most", 2.0)}
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

    errors = {}
    for element in ELEMENTS:
        options.say(element)
        tips = _tips(element)
        for nu in POISSON:
            samples[f"{element}_nu{nu}_tip_mm"] = _down_mm([tips[c, nu] for c in CELLS])
            for cells in CELLS:
                error = _percent(tips[cells, nu], reference[nu])
                errors[element, nu, cells] = error
                figures[f"{element}_nu{nu}_{_name(cells)}_error_percent"] = error
            halved = [tips[cells, nu] for cells in HALVED]
            figures[f"{element}_nu{nu}_order"] = observed_order(halved)
            if element != "tet4":
                own = _percent(extrapolate(halved), reference[nu])
                figures[f"{element}_nu{nu}_extrapolated_off_percent"] = own
    in_changes = [
        abs(errors[coarse] / (errors[finer] - errors[coarse]))
        for nu in POISSON
        for coarse, finer in _pairs(nu)
    ]
    figures["largest_error_over_change"] = max(in_changes)
    figures["median_error_over_change"] = float(np.median(in_changes))
    samples["error_over_change"] = in_changes
    tables = [_error_table(errors), _advice_table(errors)]
    return Outcome(figures, samples, GOALS, tables)


def _pairs(nu: float) -> list[tuple[tuple, tuple]]:
    """List meshes with the finer one that tells their error, see `build_model`."""
    quadratic = MEAN if nu >= 0.49 else FULL
    raised = [(("tet4", nu, c), (quadratic, nu, c)) for c in CELLS]
    halved = [
        ((element, nu, coarse), (element, nu, fine))
        for element in (FULL, MEAN)
        for coarse, fine in pairwise(HALVED)
    ]
    return raised + halved


def _tips(element: str) -> dict[tuple[Cells, float], np.ndarray]:
    """Displacement of the tip [m] on every mesh, for every nu."""
    order, formulation = ELEMENTS[element]
    tips = {}
    for cells in CELLS:
        model = Beam(SIZE, E, POISSON[0]).model(
            cells, order=order, formulation=formulation
        )
        lane = first_lane(own_weight(model))
        at_tip = nearest(model.mesh.points, tip(SIZE))
        for nu in POISSON:  # one compilation serves all of them
            solution = equilibrium(model.with_law(NeoHookean(E, nu)), lane)
            tips[cells, nu] = np.asarray(solution.displacement[at_tip])
    return tips


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
