"""A field of moduli as a part with graded foam, for the slicer IceSL."""

import os
from pathlib import Path
from typing import Literal

import meshio
import numpy as np

from softcal_jax._text import check_known
from softcal_jax.calibration import CalibrationResult
from softcal_jax.designs import FoamTable, Infill, foam_table, write_foam_table
from softcal_jax.equilibrium import Model
from softcal_jax.exchange.icesl import _report as report
from softcal_jax.exchange.icesl._report import IceslResult
from softcal_jax.exchange.icesl._settings import (
    Convention,
    Design,
    PrintPlane,
    choose,
    part_on_bed,
    print_plane,
    sample,
)
from softcal_jax.export import results_folder, write_json
from softcal_jax.mesh import tessellate
from softcal_jax.project import Project
from softcal_jax.report import LoadedResult, load_result

_SCRIPT, _PART = "robot.lua", "robot.stl"

Printable = LoadedResult | CalibrationResult | Project | Model | Design


def export_icesl(
    result: Printable | str | os.PathLike[str],
    directory: str | os.PathLike[str],
    *,
    infill: Infill = "Polyfoam",
    table: FoamTable | str | os.PathLike[str] | None = None,
    plane: PrintPlane | None = None,
    region: str | None = None,
    angle_marks: Literal["soft", "stiff"] | None = None,
    angle_offset: float = 0.0,
    clockwise: bool = False,
    force: bool = False,
) -> IceslResult:
    """Write a calibrated or designed field as graded foam for the slicer IceSL.

    The folder gets `robot.lua`, which IceSL opens; `robot.stl`, the surface in mm, laid
    on the bed; `foam.csv`, the table that was used; `unreachable.csv`, one line per
    voxel whose material the foam does not have, with its place in the frame of the
    model, what was asked for and what it gets, written only if there are any; and
    `icesl.json`, all of it in numbers.

    Density and anisotropy are those whose moduli are nearest to E_t and E_l by the
    table; the fibre gives the angles. Each is one value, or a texture of 64^3 voxels
    that fill the box of the part, with values at their centres. Poisson's ratios and
    shear moduli are those of the foam, whatever the model has. Layers of the print lie
    in the print plane.

    Args:
        result: The results folder, its `result.json`, or what `load_result` or
            `calibrate` returned; for a designed field a project, with its start
            values, a model, or a `Design`.
        directory: The folder; it must be new or empty, or hold an earlier export.
        infill: "Polyfoam", with a soft axis, or "Phasor", with a stiff one.
        table: Moduli of the foam, or the file of such a table, see `read_foam_table`;
            by default the published one of Polyfoam of TPU.
        plane: Axes of the mesh that lie along x and y of the bed; by default those in
            which the model's theta is counted, "xy" if it has none.
        region: Tet group that is printed; everything by default.
        angle_marks: Axis of the foam that the angle of IceSL marks; by default the
            single one: soft for Polyfoam, stiff for Phasor.
        angle_offset: Added to every angle [rad].
        clockwise: Whether IceSL counts angles clockwise, seen from above.
        force: Replace an earlier export; files that a user added stay.

    Returns:
        What was written, and what the print will not have.

    Raises:
        ResultError: If the result cannot be loaded, see `load_result`.
        FileExistsError: If the folder is not empty, and `force` is off or it is not a
            results folder.
        ValueError: If the law has no moduli for a foam, the table is missing or does
            not fit the infill, or a region or choice is unknown.
    """
    check_known("axis to mark", ("soft", "stiff"), angle_marks or "soft")
    if isinstance(result, str | os.PathLike):
        result = load_result(result)
    directory, design = Path(directory), _design(result)
    foam = table if isinstance(table, FoamTable) else foam_table(infill, table)
    if foam.infill != infill:
        raise ValueError(
            f"the table is of {foam.infill}, and the infill is {infill!r}: give both "
            "alike."
        )
    plane = plane or print_plane(design.model)
    part = part_on_bed(design.model.mesh, plane=plane, region=region)
    samples = sample(design, part)
    convention = Convention(angle_marks or foam.axis, angle_offset, clockwise)
    chosen = choose(samples, foam, convention)
    notes = report.print_notes(samples, chosen, foam)
    obstacles = ", ".join(design.model.mechanism.contacts.names)
    if obstacles:
        notes += (f"Only the part is written, without the obstacles: {obstacles}.",)
    written = IceslResult(
        directory=directory,
        infill=foam.infill,
        settings=chosen.settings,
        n_voxels=len(samples.voxels),
        n_beyond=int(chosen.beyond.sum()),
        n_tilted=int(chosen.tilted.sum()),
        n_across=int(chosen.across.sum()),
        worst=float(np.expm1(chosen.foam.error.max())),
        rounding=chosen.rounding,
        notes=notes,
    )
    comments = (*report.meaning(foam, convention, plane), *notes)
    with results_folder(directory, force=force) as folder:
        text = report.script(design.title, comments, _PART, foam.infill, chosen)
        (folder / _SCRIPT).write_text(text, encoding="utf-8")
        cut = tessellate(part.mesh)
        points = 1e3 * cut.interpolate(part.mesh.points)  # in mm
        surface = meshio.Mesh(points, [("triangle", cut.triangles)])
        surface.write(folder / _PART, file_format="stl", binary=True)
        write_foam_table(folder / report.TABLE, foam)
        if chosen.unreachable.any():
            report.write_unreachable(folder / report.UNREACHABLE, samples, chosen)
        about = report.icesl_dict(written, part, foam, convention)
        write_json(folder / "icesl.json", about)
    return written


def _design(source: Printable) -> Design:
    """Return the field that a result or a project holds."""
    if isinstance(source, Design):
        return source
    if isinstance(source, Model):
        return Design(source)
    if isinstance(source, Project):
        z = None if source.space is None else source.space.start()
        return Design(source.model, source.space, z, source.name)
    title = source.project.name if isinstance(source, LoadedResult) else "robot"
    return Design(source.model, source.space, source.z, title)
