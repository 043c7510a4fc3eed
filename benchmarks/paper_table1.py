"""Table I of the paper: condition numbers of W_ep W_pp^-1 by parameters and data.

4 and 6 parameters x 1 and 4 effectors x 3, 4 and 6 configurations, at p_target, in both
print planes. What the paper leaves open, and what is taken here:

- S: that of the published scene, (1 MPa, 1 MPa, 1 rad), and theta mixed linearly.
  `cond_ours_...` are with what we calibrate in, steps in ln E and directors, for six
  parameters and one effector. W_ep is in metres, W_pp, in joules, is the sum over the
  configurations.
- Which 4 parameters: E_t and E_l at both control points, with theta known, as it is
  where one prints. The other two pairs of fields are in the tables; with {E_l, theta}
  and 4 effectors the paper's orderings break.
- One effector: the tip. Four: the points of the published scene, without the tip.

Each design is calibrated from `START` too, with the paper's loop and with ours, and the
outcome is marked as measured.
"""

from collections.abc import Mapping, Sequence
from typing import Any, Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from benchmarks._paper import (
    CELLS,
    PAPER,
    STD,
    Cells,
    error_curve,
    one_run,
    paper_settings,
    parameter_errors,
    recovered,
    subset,
)
from benchmarks._problem import Figure, Options, Outcome, Table
from softcal_jax._typing import HostArray
from softcal_jax.calibration import CalibrationSettings, Run, build_problem
from softcal_jax.configurations import Configuration, Markers
from softcal_jax.equilibrium import solve_equilibrium
from softcal_jax.fields import ControlPointParameters, ParameterSpace
from softcal_jax.identifiability import conditioning
from softcal_jax.robots import AnisotropicBeam, anisotropic_beam, synthetic_measurements
from softcal_jax.sensitivity import energy_compliance
from softcal_jax.unknowns import Problem

FIELDS = {
    "E_l, theta": ("E_l", "theta"),
    "E_t, E_l": ("E_t", "E_l"),
    "E_t, theta": ("E_t", "theta"),
    "all": ("E_t", "E_l", "theta"),
}
"""Fields that are calibrated, at both control points."""

FOUR = "E_t, E_l"
"""The 4 parameters of the figures."""

EFFECTORS = {1: (0,), 4: (1, 2, 3, 4)}
"""Markers of the beam that a number of effectors stands for."""

Plane = Literal["xy", "xz"]

PLANES: dict[Plane, str] = {"xy": "", "xz": "_xz"}
"""Print planes, and what they add to the name of a figure."""

COUNTS = (3, 4, 6)
"""Numbers of configurations, 1 to n of Fig. 2."""

PAPER_S = {**PAPER, "scaling": "paper"}
"""Choices of the beam: the scaling S of the published scene, and theta as there."""

PAPER_BOUND = 0.1
"""Bound on the step of the paper's loop: 100 kPa, 0.1 rad [-]."""

STEPS = 60
"""Steps that a calibration is given."""

TAIL = 10
"""Last steps by which a run that did not converge is judged."""


class Design(NamedTuple):
    """An entry of Table I: fields by their key, effectors, configurations."""

    fields: str
    effectors: int
    configurations: int

    @property
    def figure(self) -> str:
        """Name of its condition number."""
        n = 6 if self.fields == "all" else 4
        return f"cond_p{n}_e{self.effectors}_c{self.configurations}"


def designs(fields: Sequence[str]) -> list[Design]:
    """All designs of some fields."""
    return [Design(f, e, c) for f in fields for e in EFFECTORS for c in COUNTS]


def run(options: Options) -> Outcome:
    """Condition numbers of all choices, then the calibrations of the 12 designs."""
    figures: dict[str, Figure] = {}
    tables = []
    for plane, suffix in PLANES.items():
        options.say(f"print plane {plane}: condition numbers")
        numbers = condition_numbers(CELLS, plane)
        figures |= {
            design.figure + suffix: _finite(numbers[design])
            for design in designs((FOUR, "all"))
        }
        options.say(f"print plane {plane}: calibrations")
        outcomes = {
            title: calibrations(CELLS, plane, title == "paper")
            for title in ("paper", "ours")
        }
        broken = broken_orderings(numbers, FOUR)
        figures[f"orderings_broken{suffix}"] = len(broken)
        ours = condition_numbers(CELLS, plane, {})
        for c in COUNTS:
            design = Design("all", 1, c)
            name = design.figure.replace("cond_", "cond_ours_") + suffix
            figures[name] = _finite(ours[design])
        tables += _tables(plane, numbers, outcomes)
    return Outcome(figures, {}, {}, tables)


def all_markers(
    cells: Cells, plane: Plane, **choices
) -> tuple[AnisotropicBeam, tuple[Configuration, ...]]:
    """The beam with six poses that carry both sets of effectors, the tip first."""
    one, four = (
        anisotropic_beam(
            cells=cells,
            plane=plane,
            poses=range(1, 7),
            std=STD,
            n_effectors=n,
            **choices,
        )
        for n in (1, 4)
    )
    poses = []
    for a, b in zip(one.configurations, four.configurations, strict=True):
        assert a.markers is not None
        assert b.markers is not None
        places = np.concatenate([a.markers.positions, b.markers.positions])
        markers = Markers([*a.markers.names, *b.markers.names], places, STD)
        poses.append(Configuration(a.name, a.supports, a.gravity, markers=markers))
    return one, tuple(poses)


@eqx.filter_jit
def _compliances(problem: Problem, z):
    model, lanes = problem.at(z)

    def lane(nominal, posed):
        u = solve_equilibrium(model, posed, settings=problem.newton).displacement
        return energy_compliance(problem.model, nominal, u, problem.space, z)

    return jax.vmap(lane)(problem.configurations, lanes)


def condition_numbers(
    cells: Cells, plane: Plane, choices: Mapping[str, Any] = PAPER_S
) -> dict[Design, float]:
    """cond(W_ep W_pp^-1) of every design at p_target, by choices of the beam."""
    beam, poses = all_markers(cells, plane, **choices)
    measured = synthetic_measurements(beam.model, beam.space, poses, beam.target)
    problem = build_problem(beam.model, beam.space, measured)
    p = jnp.asarray([beam.target[name] for name in beam.space.names])
    compliances = _compliances(problem, beam.space.to_scaled(p))
    if not bool(jnp.all(compliances.ok)):
        raise RuntimeError("a configuration has no equilibrium at p_target.")
    n_c, n_markers, _ = problem.configurations.effectors.measured.shape
    W_ep = np.asarray(compliances.W_ep).reshape(n_c, n_markers, 3, -1)
    W_pp = np.asarray(compliances.W_pp)
    fields = [q.field for q in beam.space.parameters]
    return {
        design: _condition(W_ep, W_pp, fields, design) for design in designs([*FIELDS])
    }


def _condition(
    W_ep: HostArray, W_pp: HostArray, fields: Sequence[str], design: Design
) -> float:
    """Of the rows and columns of one design; a known parameter is a column less."""
    columns = [i for i, f in enumerate(fields) if f in FIELDS[design.fields]]
    rows = W_ep[: design.configurations, EFFECTORS[design.effectors]][..., columns]
    rows = rows.reshape(-1, len(columns))
    total = W_pp[: design.configurations].sum(axis=0)[np.ix_(columns, columns)]
    return conditioning(rows / STD, W_ep=rows, W_pp=total).condition_W_ep_W_pp


def broken_orderings(numbers: Mapping[Design, float], four: str) -> list[str]:
    """Orderings of the paper's Table I that do not hold, in words.

    Args:
        numbers: Condition numbers of all designs.
        four: Key of the 4 parameters.
    """
    cond = lambda f, e, c: numbers[Design(f, e, c)]
    broken = []
    for f, n in ((four, 4), ("all", 6)):
        for e in EFFECTORS:
            c3, c4, c6 = (cond(f, e, c) for c in COUNTS)
            if not c3 > max(c4, c6):
                broken.append(f"{n} parameters, {e} effectors: 3 configurations worst")
            # Two more configurations bring c6: its gain counts per configuration.
            if not c3 / c4 > np.sqrt(c4 / c6):
                broken.append(f"{n} parameters, {e} effectors: the 4th helps most")
        for c in COUNTS:
            if not cond(f, 4, c) < cond(f, 1, c):
                broken.append(f"{n} parameters, {c} configurations: 4 effectors help")
    for e in EFFECTORS:
        for c in COUNTS:
            if not cond("all", e, c) > cond(four, e, c):
                broken.append(f"{e} effectors, {c} configurations: 6 worse than 4")
    return broken


def with_known(
    space: ParameterSpace,
    unknown: Sequence[str],
    values: Mapping[str, float],
    bounds: tuple[float, float] | None = None,
) -> ParameterSpace:
    """The space with all but some fields known.

    Args:
        space: {E_t, E_l, theta} at control points.
        unknown: Fields that stay unknown.
        values: The others' values, by the name of the parameter.
        bounds: Bounds of the moduli; as they are by default [Pa].
    """
    entries = []
    for e in space.entries:
        assert isinstance(e, ControlPointParameters)
        names = () if e.field in unknown else e.control_points.names
        fixed = {name: values[f"{e.field} of {name}"] for name in names}
        low, high = (e.lower, e.upper) if e.unit == "rad" or not bounds else bounds
        entries.append(
            ControlPointParameters(
                e.field,
                e.control_points,
                start=e.start,
                lower=low,
                upper=high,
                scale=e.scale,
                S=e.S,
                region=e.region,
                unit=e.unit,
                interpolation=e.interpolation,
                fixed=fixed,
                max_step=e.max_step,
            )
        )
    if len(unknown) == len(space.entries):
        return ParameterSpace(entries, order=space.order, axes=space.axes)
    return ParameterSpace(entries, order=[("E_l", "E_t")])


def calibrations(
    cells: Cells,
    plane: Plane,
    paper: bool,
    wanted: Sequence[Design] | None = None,
) -> dict[Design, str]:
    """How the calibration of each design goes, from `START`.

    Args:
        cells: Cells of the beam.
        plane: Print plane.
        paper: With the paper's loop; else with ours.
        wanted: Designs; the 12 of Table I by default.
    """
    beam, poses = all_markers(cells, plane, **(PAPER if paper else {}))
    poses = synthetic_measurements(beam.model, beam.space, poses, beam.target)
    settings = (
        paper_settings(PAPER_BOUND, STEPS)
        if paper
        else CalibrationSettings(max_steps=STEPS)
    )
    courses = {}
    for design in wanted or designs((FOUR, "all")):
        space = with_known(beam.space, FIELDS[design.fields], beam.target)
        whole = build_problem(beam.model, space, poses)
        problem = subset(
            whole, range(design.configurations), EFFECTORS[design.effectors]
        )
        end = one_run(problem, settings, space.start())
        target = space.to_scaled(jnp.asarray([beam.target[n] for n in space.names]))
        courses[design] = _course(end, parameter_errors(space, end.z, target))
    return courses


def _course(end: Run, errors: HostArray) -> str:
    """What a run did, in words."""
    steps, sizes = int(end.steps), error_curve(end)
    if recovered(errors):
        return f"converged, {steps} steps"
    if not np.isfinite(float(end.cost)):
        return f"no equilibrium after {steps} steps"
    if bool(end.converged):
        return f"other optimum, {1e3 * sizes[-1]:.1g} mm"
    if sizes[-1] > sizes[0]:
        return f"diverged to {1e3 * sizes[-1]:.1g} mm"
    if np.sum(np.diff(sizes[-TAIL:]) > 0) >= 3:
        return f"oscillating at {1e3 * sizes[-1]:.1g} mm"
    return f"slow, {1e3 * sizes[-1]:.1g} mm after {steps} steps"


def _finite(number: float) -> Figure:
    return number if np.isfinite(number) else "infinite"


def _tables(
    plane: Plane,
    numbers: Mapping[Design, float],
    outcomes: Mapping[str, Mapping[Design, str]],
) -> list[Table]:
    rows = []
    for design in designs((FOUR, "all")):
        rows.append(
            [
                f"{2 * len(FIELDS[design.fields])}: {design.fields}",
                str(design.effectors),
                str(design.configurations),
                f"{numbers[design]:.3g}",
                outcomes["paper"][design],
                outcomes["ours"][design],
            ]
        )
    columns = ["parameters", "effectors", "configurations", "cond(W_ep W_pp^-1)"]
    columns += ["the paper's loop", "ours"]
    table = Table(f"Table I, print plane {plane}", columns, rows)
    columns = [f"e{e} c{c}" for e in EFFECTORS for c in COUNTS]
    others = []
    for fields in FIELDS:
        shown = [f"{numbers[design]:.3g}" for design in designs([fields])]
        broken = "" if fields == "all" else "; ".join(broken_orderings(numbers, fields))
        others.append([fields, *shown, broken or "-"])
    title = f"Choices of 4 parameters, print plane {plane}: condition numbers"
    return [table, Table(title, ["parameters", *columns, "orderings broken"], others)]
