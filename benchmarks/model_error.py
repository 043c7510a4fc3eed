"""Is a wrong model noticed? Data of the foam's full law, calibrated with less.

Data: quadratic tets, the full law of the published foam (E_t 1390, E_l 94.22 kPa, nu_t
0.26162, nu_tl 0.4161, mu_l 16.28 kPa), theta 20 and -35 degrees at the two control
points, noise of 0.1 mm. The beam weighs 300 kg/m3, an infill of about a quarter, since
this foam does not carry the mass of Sec. V. {E_t, E_l, theta} at both control points
are calibrated from 6 configurations with 5 effectors each, starting at the values of
the foam, with:

- the reduced law, whose shear modulus is tied to E_t and E_l: 8.8 times too stiff;
- the full law on linear tets, which lock in bending;
- both errors together;
- the full law on quadratic tets, the control, which must not be flagged.

A fit is flagged if its verdict says that the residuals are above the stated errors,
with chi-squared more than 3 times its degrees of freedom. `called_identifiable` counts
the wrong fits whose report calls its parameters identifiable all the same.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from benchmarks._paper import CELLS, STD, Cells
from benchmarks._problem import Figure, Goal, Options, Outcome, Table
from benchmarks.paper_table1 import all_markers
from softcal_jax.calibration import CalibrationResult, CalibrationSettings, calibrate
from softcal_jax.configurations import Configuration
from softcal_jax.equilibrium import Model, build_model
from softcal_jax.fields import (
    ControlPointParameters,
    ControlPoints,
    ParameterSpace,
    Uncertain,
)
from softcal_jax.identifiability import assess
from softcal_jax.materials import (
    Corotational,
    Fibre,
    ReducedTransverseIsotropic,
    TransverseIsotropic,
)
from softcal_jax.mesh import beam
from softcal_jax.robots import synthetic_measurements
from softcal_jax.robots._ready_made import SIZE

FOAM = {
    "E_t": 1390e3,
    "E_l": 94.22e3,
    "nu_t": 0.26162,
    "nu_tl": 0.4161,
    "mu_l": 16.28e3,
}
"""The published foam [Pa, -]."""

THETA = np.deg2rad([20.0, -35.0])
"""Angles of its fibre at the control points [rad]."""

DENSITY = 300.0
"""Density of the beam [kg/m3]."""

POSES = 6
"""Configurations that are calibrated, 1 to n of Fig. 2."""

SEEDS = (0, 1, 2)
"""Draws of noise that every case is tried with."""

UNCERTAIN = Uncertain(recordings=0.0)
"""What is uncertain: the stated noise is all there is in the readings."""

FAR_ABOVE = 3.0
"""Chi-squared over its degrees of freedom from which a misfit is no accident [-]."""

FLAG = "times what the stated errors explain"


class Case(NamedTuple):
    """A model that is calibrated, and whether it is wrong."""

    title: str
    reduced: bool
    order: int
    wrong: bool


CASES = (
    Case("full law, quadratic tets (control)", False, 2, False),
    Case("reduced law, quadratic tets", True, 2, True),
    Case("full law, linear tets", False, 1, True),
    Case("reduced law, linear tets", True, 1, True),
)


class Trial(NamedTuple):
    """One calibration of a case."""

    case: Case
    seed: int
    result: CalibrationResult

    @property
    def excess(self) -> float:
        """Chi-squared over its degrees of freedom [-]."""
        spread = self.result.uncertainty
        return spread.chi_squared / spread.degrees_of_freedom

    @property
    def warned(self) -> bool:
        """Whether the verdict speaks of the misfit."""
        return any(FLAG in doubt for doubt in self.result.doubts)

    @property
    def called_identifiable(self) -> bool:
        """Whether the report calls the parameters identifiable."""
        return assess(self.result).identified

    @property
    def flagged(self) -> bool:
        """Whether the report says that the model cannot match the data."""
        return self.warned and self.excess > FAR_ABOVE


def run(options: Options) -> Outcome:
    """All cases, with each draw of noise."""
    options.say("data")
    data = measured(CELLS, SEEDS)
    trials = []
    for case in CASES:
        options.say(case.title)
        trials += try_case(case, CELLS, data)
    wrong = [t for t in trials if t.case.wrong]
    control = [t for t in trials if not t.case.wrong]
    figures: dict[str, Figure] = {
        "flagged": sum(t.flagged for t in wrong),
        "flagged_of": len(wrong),
        "flagged_control": sum(t.warned for t in control),
        "control_of": len(control),
        "called_identifiable": sum(t.called_identifiable for t in wrong),
        "smallest_excess": min(t.excess for t in wrong),
        "largest_excess_control": max(t.excess for t in control),
        "not_converged": sum(not t.result.converged for t in trials),
    }
    goals = {
        "flagged": Goal("at least", len(wrong)),
        "flagged_control": Goal("at most", 0),
        "called_identifiable": Goal("at most", 0),
    }
    samples = {"excess": [t.excess for t in trials]}
    return Outcome(figures, samples, goals, [_table(trials)])


def try_case(
    case: Case, cells: Cells, data: Mapping[int, Sequence[Configuration]]
) -> list[Trial]:
    """Calibrate one model with several draws of noise.

    Args:
        case: The model.
        cells: Cells of its mesh.
        data: Measured configurations, by the seed of their noise.
    """
    model, space = body(cells, case.order, case.reduced), unknowns()
    settings = CalibrationSettings(step_bound=0.5, max_steps=100)
    return [
        Trial(
            case,
            seed,
            calibrate(
                model,
                space,
                poses,
                noise="stated",
                uncertain=UNCERTAIN,
                settings=settings,
                starts=1,
                intervals=None,
            ),
        )
        for seed, poses in data.items()
    ]


def body(cells: Cells, order: int, reduced: bool) -> Model:
    """The beam with one of the two laws."""
    fibre = Fibre(0.0, plane="xy")
    law = (
        ReducedTransverseIsotropic(FOAM["E_t"], FOAM["E_l"], FOAM["nu_t"], fibre)
        if reduced
        else TransverseIsotropic(**FOAM, fibre=fibre)
    )
    mesh = beam(*SIZE, cells, order=2 if order == 2 else 1)
    return build_model(mesh, Corotational(law), density=DENSITY)


def measured(
    cells: Cells, seeds: Sequence[int]
) -> dict[int, tuple[Configuration, ...]]:
    """What the foam would be measured at, with several draws of noise."""
    _, poses = all_markers(cells, "xy")
    truth = {f"theta of CP {i + 1}": float(v) for i, v in enumerate(THETA)}
    foam, space = body(cells, 2, False), ParameterSpace((_theta(),))
    return {
        seed: synthetic_measurements(
            foam, space, poses[:POSES], truth, noise=True, seed=seed
        )
        for seed in seeds
    }


def unknowns() -> ParameterSpace:
    """{E_t, E_l, theta} at both control points; the full law keeps its other three."""
    moduli = [
        ControlPointParameters(
            field, _points(), start=FOAM[field], lower=1e3, upper=20e6, unit="Pa"
        )
        for field in ("E_t", "E_l")
    ]
    return ParameterSpace((*moduli, _theta()), axes=[("E_l", "E_t", "theta")])


def _theta() -> ControlPointParameters:
    return ControlPointParameters(
        "theta",
        _points(),
        start=THETA,
        lower=-np.pi / 2,
        upper=np.pi / 2,
        unit="rad",
        scale="linear",
        S=1.0,
        interpolation="director",
    )


def _points() -> ControlPoints:
    length, height, width = SIZE
    centre = (height / 2, width / 2)
    return ControlPoints([(0.0, *centre), (length, *centre)])


def _table(trials: Sequence[Trial]) -> Table:
    rows = []
    for t in trials:
        spread = t.result.uncertainty
        said = "flagged" if t.flagged else "warned" if t.warned else "nothing said"
        values = ", ".join(
            f"{np.rad2deg(p.value):.1f} deg"
            if p.unit == "rad"
            else f"{p.value / 1e3:.4g} kPa"
            for p in t.result.parameters
        )
        converged = "" if t.result.converged else ", not converged"
        if t.called_identifiable:
            said += ', called "identifiable"'
        rows.append(
            [
                t.case.title,
                str(t.seed),
                f"{spread.chi_squared:.4g} / {spread.degrees_of_freedom}",
                said + converged,
                values,
            ]
        )
    columns = ["model", "noise", "chi-squared / dof", "notes", "E_t, E_l, theta at CPs"]
    title = f"Model error, data with {1e3 * STD:g} mm of noise"
    return Table(title, columns, rows)
