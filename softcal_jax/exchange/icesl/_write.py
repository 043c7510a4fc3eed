"""A field of moduli as a part with graded foam, for the slicer IceSL."""

from pathlib import Path
from typing import Literal

import numpy as np

from softcal_jax._typing import Array, Float
from softcal_jax.equilibrium import Model
from softcal_jax.exchange.icesl._fields import (
    Part,
    Plane,
    part_on_bed,
    print_plane,
    sample,
)
from softcal_jax.exchange.icesl._foam_file import write_foam_table
from softcal_jax.exchange.icesl._report import (
    TABLE,
    UNREACHABLE,
    IceslResult,
    icesl_dict,
    meaning,
    print_notes,
    write_unreachable,
)
from softcal_jax.exchange.icesl._script import Script
from softcal_jax.exchange.icesl._settings import (
    Chosen,
    Convention,
    choose,
)
from softcal_jax.export import results_folder, write_json
from softcal_jax.fields import ParameterSpace
from softcal_jax.materials import FoamTable
from softcal_jax.mesh import tessellate

_SCRIPT, _PART = "robot.lua", "robot.stl"

_LOWEST_PERCENTAGE = 20.0
"""Density below which Polyfoam does not go unless told so [%]."""


def write_icesl(
    directory: str | Path,
    model: Model,
    table: FoamTable,
    *,
    space: ParameterSpace | None = None,
    z: Float[Array, " n_p"] | None = None,
    title: str = "robot",
    plane: Plane | None = None,
    region: str | None = None,
    angle_marks: Literal["soft", "stiff"] | None = None,
    angle_offset: float = 0.0,
    clockwise: bool = False,
    force: bool = False,
) -> IceslResult:
    """Write a part whose foam has the moduli of a model, for the slicer IceSL.

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
        directory: The folder; it must be new or empty, or hold an earlier export.
        model: The model, with its parameters set, at rest.
        table: Moduli of the foam, and with it the infill.
        space: Its parameters: fields with control points are evaluated at the voxels.
        z: Their scaled values [-].
        title: First line of the script.
        plane: Axes of the mesh that lie along x and y of the bed; by default those in
            which the model's theta counts, "xy" if it has none.
        region: Tet group that is printed; everything by default.
        angle_marks: Axis of the foam that the angle of IceSL marks; by default the
            single one: soft for Polyfoam, stiff for Phasor.
        angle_offset: Added to every angle [rad].
        clockwise: Whether IceSL counts angles clockwise, seen from above.
        force: Replace an earlier export; files that a user added stay.

    Raises:
        FileExistsError: If the folder is not empty, and `force` is off or it is not a
            results folder.
        ValueError: If the law has no moduli, the region or a choice is unknown.
    """
    if angle_marks not in (None, "soft", "stiff"):
        raise ValueError(
            f'angle_marks must be "soft" or "stiff", got {angle_marks!r}: the axis of '
            "the foam that the angle of IceSL marks."
        )
    plane = plane or print_plane(model)
    part = part_on_bed(model.mesh, plane=plane, region=region)
    samples = sample(model, part, space, z)
    convention = Convention(angle_marks or table.axis, angle_offset, clockwise)
    chosen = choose(samples, table, convention)
    notes = print_notes(samples, chosen, table)
    script = Script(
        title,
        (*meaning(table, convention, plane), *notes),
        _PART,
        table.infill,
        chosen.settings,
        _min_percentage(table, chosen),
    )
    result = IceslResult(
        directory=Path(directory),
        infill=table.infill,
        settings=chosen.settings,
        n_voxels=len(samples.voxels),
        n_beyond=int(chosen.beyond.sum()),
        n_tilted=int(chosen.tilted.sum()),
        n_across=int(chosen.across.sum()),
        worst=float(np.expm1(chosen.foam.error.max())),
        rounding=chosen.rounding,
        notes=notes,
    )
    with results_folder(directory, force=force) as folder:
        files = [_SCRIPT, _PART, TABLE]
        (folder / _SCRIPT).write_text(str(script), encoding="utf-8")
        _write_stl(folder / _PART, part)
        write_foam_table(folder / TABLE, table)
        if chosen.unreachable.any():
            write_unreachable(folder / UNREACHABLE, samples, chosen)
            files.append(UNREACHABLE)
        about = icesl_dict(result, part, table, convention)
        write_json(folder / "icesl.json", {**about, "files": files})
    return result


def _write_stl(path: Path, part: Part) -> None:
    """Write the surface as binary STL in mm."""
    import pyvista

    cut = tessellate(part.mesh)
    points = 1e3 * cut.interpolate(part.mesh.points)
    pyvista.PolyData.from_regular_faces(points, cut.triangles).save(path)


def _min_percentage(table: FoamTable, chosen: Chosen) -> int | None:
    """Return the lowest density that Polyfoam must be allowed [%], if it must."""
    lowest = 100.0 * float(chosen.foam.density.min())
    if table.infill != "Polyfoam" or lowest >= _LOWEST_PERCENTAGE:
        return None
    # Below the lowest step of the texture as well.
    return max(int(lowest - 0.5), 0)
