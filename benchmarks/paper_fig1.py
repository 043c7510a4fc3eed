"""Fig. 1 of the paper: a field of theta between two control points for p = 1, 2 and 6.

theta is -35 degrees at one end of the beam and 35 at the other. The larger the exponent
of the inverse-distance weighting, the more abrupt the change in the middle. Angles are
mixed as numbers, as in the paper. The picture shows them as fibres on the mesh.
"""

import numpy as np

from benchmarks._problem import Figure, Options, Outcome, Table
from softcal_jax._typing import HostArray
from softcal_jax.fields import ControlPointParameters, ControlPoints
from softcal_jax.mesh import TetMesh, beam
from softcal_jax.plotting import plot_fibres

POWERS = (1.0, 2.0, 6.0)
"""Exponents of the weighting [-]."""

ENDS = np.deg2rad([-35.0, 35.0])
"""theta at the two control points [rad]."""

SIZE = (0.150, 0.015, 0.015)
"""Length, height and width [m]."""

PLACES = {"quarter": 0.25, "three_eighths": 0.375, "middle": 0.5}
"""Where along the axis theta is reported, as a share of the length."""


def run(options: Options) -> Outcome:
    """The fields, their values along the axis, and the picture."""
    mesh = beam(*SIZE, (30, 3, 3))
    middle = (SIZE[1] / 2, SIZE[2] / 2)
    axis = np.array([(share * SIZE[0], *middle) for share in PLACES.values()])
    figures: dict[str, Figure] = {}
    panels, rows = {}, []
    for power in POWERS:
        field = theta_field(power)
        panels[f"power p = {power:g}"] = on_tets(field, mesh)
        values = np.rad2deg(np.asarray(field.control_points.weights(axis)) @ ENDS)
        for place, value in zip(PLACES, values, strict=True):
            figures[f"theta_{place}_p{power:g}_deg"] = float(value)
        rows.append([f"{power:g}", *(f"{value:.2f}" for value in values)])
    picture = options.folder() / "fig1.png"
    points = np.asarray(theta_field(2.0).control_points.positions)
    plot_fibres(
        mesh,
        panels,
        picture,
        plane="xy",
        control_points=points,
        title="Fig. 1: fibres between two control points, theta from -35 to 35 degrees",
    )
    options.say(f"picture: {picture}")
    columns = ["p", *(f"theta at {share:g} L [deg]" for share in PLACES.values())]
    return Outcome(figures, tables=[Table("Fig. 1, on the axis", columns, rows)])


def theta_field(power: float) -> ControlPointParameters:
    """Angles at the centres of the end faces, spread with this exponent."""
    length, height, width = SIZE
    points = ControlPoints(
        [(0.0, height / 2, width / 2), (length, height / 2, width / 2)], power=power
    )
    return ControlPointParameters(
        "theta",
        points,
        start=ENDS,
        lower=-np.pi / 2,
        upper=np.pi / 2,
        scale="linear",
        unit="rad",
        interpolation="linear",
    )


def on_tets(field: ControlPointParameters, mesh: TetMesh) -> HostArray:
    """Angle of each tet [rad]."""
    values = {q.name: q.start for q in field.parameters}
    return np.asarray(field.evaluate(mesh, values))
