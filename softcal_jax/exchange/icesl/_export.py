"""`export_icesl`: a calibrated or designed field as graded foam."""

import os
from pathlib import Path
from typing import Literal

from softcal_jax.calibration import CalibrationResult
from softcal_jax.equilibrium import Model
from softcal_jax.exchange.icesl._foam_file import read_foam_table
from softcal_jax.exchange.icesl._report import IceslResult
from softcal_jax.exchange.icesl._write import write_icesl
from softcal_jax.materials import FoamTable, Infill, published_foam
from softcal_jax.project import Project
from softcal_jax.report import LoadedResult, load_result


def export_icesl(
    result: LoadedResult | CalibrationResult | Project | Model | str | os.PathLike[str],
    directory: str | os.PathLike[str],
    *,
    infill: Infill = "Polyfoam",
    table: FoamTable | str | os.PathLike[str] | None = None,
    plane: Literal["xy", "xz", "yz"] | None = None,
    region: str | None = None,
    angle_marks: Literal["soft", "stiff"] | None = None,
    angle_offset: float = 0.0,
    clockwise: bool = False,
    force: bool = False,
) -> IceslResult:
    """Write a calibrated or designed field as graded foam for the slicer IceSL.

    The folder has a Lua script with density, angle and anisotropy of the foam as
    textures, and the part as STL; see `write_icesl` for its content and what is
    listed that the foam does not reach.

    Args:
        result: The results folder, its `result.json`, or what `load_result` or
            `calibrate` returned; for a designed field a project, with its start
            values, or a model.
        directory: The folder to write.
        infill: "Polyfoam", with a soft axis, or "Phasor", with a stiff one.
        table: Moduli of the foam, or the file of such a table, see `read_foam_table`;
            by default the published one of Polyfoam of TPU.
        plane: Axes of the mesh that lie along x and y of the print bed; by default
            those in which the model's theta counts.
        region: Tet group that is printed; everything by default.
        angle_marks: Axis of the foam that the angle of IceSL marks; by default soft
            for Polyfoam, stiff for Phasor.
        angle_offset: Added to every angle [rad].
        clockwise: Whether IceSL counts angles clockwise, seen from above.
        force: Replace an earlier export.

    Returns:
        What was written, and what the print will not have.

    Raises:
        ResultError: If the result cannot be loaded, see `load_result`.
        FileExistsError: If the folder is not empty, and `force` is off or it is not a
            results folder.
        ValueError: If the law has no moduli for a foam, the table is missing or does
            not fit the infill, or a choice is unknown.
    """
    if isinstance(result, str | os.PathLike):
        result = load_result(result)
    space, z, title = None, None, "robot"
    if isinstance(result, LoadedResult):
        space, z, title = result.space, result.z, result.project.name
    elif isinstance(result, CalibrationResult):
        space, z = result.space, result.z
    elif isinstance(result, Project):
        space, title = result.space, result.name
        z = None if space is None else space.start()
    return write_icesl(
        Path(directory),
        result if isinstance(result, Model) else result.model,
        _foam(infill, table),
        space=space,
        z=z,
        title=title,
        plane=plane,
        region=region,
        angle_marks=angle_marks,
        angle_offset=angle_offset,
        clockwise=clockwise,
        force=force,
    )


def _foam(
    infill: Infill, table: FoamTable | str | os.PathLike[str] | None
) -> FoamTable:
    """Return a table of the infill."""
    if table is None and infill == "Phasor":
        raise ValueError(
            "no moduli of Phasor are published: give a table of your own, from test "
            "prints, with the columns density, iso, E_soft_kPa and E_stiff_kPa "
            "(table=, --table)."
        )
    if table is None:
        table = published_foam()
    elif not isinstance(table, FoamTable):
        table = read_foam_table(table, infill)
    if table.infill != infill:
        raise ValueError(
            f"the table is of {table.infill}, and the infill is {infill!r}: give both "
            "alike."
        )
    return table
