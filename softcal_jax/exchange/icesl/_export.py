"""A field of moduli as a part with graded foam, for the slicer IceSL.

The script of the part, what it means, and what the print lacks.
"""

import os
from collections.abc import Iterable
from itertools import compress
from pathlib import Path
from typing import Any, Literal

import meshio
import numpy as np

from softcal_jax._module import Module
from softcal_jax._text import check_known, escaped
from softcal_jax._typing import Float, HostArray
from softcal_jax._units import readable, readable_values
from softcal_jax.calibration import CalibrationResult
from softcal_jax.designs import FoamTable, Infill, foam_table, write_foam_table
from softcal_jax.equilibrium import Model
from softcal_jax.exchange.icesl._settings import (
    N_VOXELS,
    RTOL,
    Chosen,
    Convention,
    Design,
    PrintedPart,
    PrintPlane,
    Samples,
    SlicerSetting,
    choose,
    part_on_bed,
    print_plane,
    sample,
)
from softcal_jax.mesh import tessellate
from softcal_jax.project import Project
from softcal_jax.results import (
    LoadedResult,
    load_result,
    plain,
    results_folder,
    write_json,
)

SCRIPT, PART = "robot.lua", "robot.stl"
TABLE, UNREACHABLE = "foam.csv", "unreachable.csv"


class IceslResult(Module):
    """What was written for IceSL.

    Attributes:
        directory: Folder of the files.
        infill: "Polyfoam" or "Phasor".
        settings: Density, angles and anisotropy, as the script has them.
        n_voxels: Voxels that the part fills.
        n_beyond: Voxels whose moduli the foam does not reach; they get the nearest.
        n_tilted: Voxels whose fibre leaves the print plane, as the infill cannot.
        n_across: Voxels that are right in the print plane only, because their axis is
            soft and that of the foam stiff, or the reverse.
        worst: Largest relative distance of a modulus from the one asked for [-].
        rounding: Largest relative error of a modulus by the 8 bits of a texture, where
            the foam reaches what was asked for [-].
        notes: What to know before printing, in sentences.
    """

    directory: Path
    infill: str
    settings: tuple[SlicerSetting, ...]
    n_voxels: int
    n_beyond: int
    n_tilted: int
    n_across: int
    worst: float
    rounding: float
    notes: tuple[str, ...]


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
    notes = print_notes(samples, chosen, foam)
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
    comments = (*meaning(foam, convention, plane), *notes)
    with results_folder(directory, force=force) as folder:
        text = script(design.title, comments, PART, foam.infill, chosen)
        (folder / SCRIPT).write_text(text, encoding="utf-8")
        cut = tessellate(part.mesh)
        points = 1e3 * cut.interpolate(part.mesh.points)  # in mm
        surface = meshio.Mesh(points, [("triangle", cut.triangles)])
        surface.write(folder / PART, file_format="stl", binary=True)
        write_foam_table(folder / TABLE, foam)
        if chosen.unreachable.any():
            write_unreachable(folder / UNREACHABLE, samples, chosen)
        about = icesl_dict(written, part, foam, convention)
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


def meaning(table: FoamTable, convention: Convention, plane: str) -> tuple[str, ...]:
    """Say what the numbers in a script mean."""
    turn = "clockwise" if convention.clockwise else "counter-clockwise"
    more = f", plus {readable(convention.offset, 'rad')}" if convention.offset else ""
    return (
        f"Moduli of the foam: {table.source}.",
        f"Angles mark the {convention.marks} axis of the foam and count {turn} from x "
        f"of the bed{more}; x and y of the bed are {plane[0]} and {plane[1]} of the "
        "model.",
        "Density is taken for the infill percentage. Poisson's ratios and shear moduli "
        "are what the foam has.",
    )


def print_notes(samples: Samples, chosen: Chosen, table: FoamTable) -> tuple[str, ...]:
    """Say what the print will not have."""
    n = len(samples.voxels)
    share = lambda where: f"{100.0 * where.sum() / n:.3g} % of the part"
    notes = []
    if chosen.beyond.any():
        worst = int(np.argmax(chosen.foam.error))
        x = readable_values(samples.places[worst].tolist(), "m")
        moduli = [float(samples.E_t[worst]), float(samples.E_l[worst])]
        asked = readable_values(moduli, "Pa")
        given = readable_values(_given(samples, chosen)[worst].tolist(), "Pa")
        notes.append(
            f"{share(chosen.beyond)} has moduli that the foam does not reach within "
            f"{100.0 * RTOL:g} %, and gets the nearest: at {x} (E_t, E_l) = {asked} is "
            f"farthest off and becomes {given}. {UNREACHABLE} lists every voxel."
        )
    if chosen.tilted.any():
        remedy = "" if table.infill == "Phasor" else " Phasor can be inclined."
        notes.append(
            f"{share(chosen.tilted)} has a fibre that leaves the print plane, and gets "
            f"its projection.{remedy} {UNREACHABLE} lists every voxel."
        )
    if chosen.across.any():
        soft = table.axis == "soft"
        other, plane = ("E_l > E_t", "stiff") if soft else ("E_l < E_t", "soft")
        notes.append(
            f"{share(chosen.across)} has {other}, and {table.infill} is {plane} across "
            f"its {table.axis} axis: the print is right in its plane, but {plane} "
            f"along the bed's z too. {UNREACHABLE} lists every voxel."
        )
    if chosen.rounding > RTOL:
        notes.append(
            "The 8 bits of the textures change a modulus by up to "
            f"{100.0 * chosen.rounding:.2g} %."
        )
    if chosen.seams:
        notes.append(
            f"The axis turns through all directions, so the angle jumps by 180 degrees "
            f"between {chosen.seams} pairs of neighbouring voxels, where IceSL "
            "interpolates it the wrong way round: look at the print path there."
        )
    return tuple(notes)


def _given(samples: Samples, chosen: Chosen) -> Float[HostArray, "n 2"]:
    """Return E_t and E_l in the print plane as the foam has them [Pa]."""
    moduli = np.stack([chosen.foam.E_soft, chosen.foam.E_stiff], axis=1)
    stiff_fibre = samples.E_l > samples.E_t
    return np.where(stiff_fibre[:, None], moduli, moduli[:, ::-1])


def write_unreachable(path: Path, samples: Samples, chosen: Chosen) -> None:
    """List the voxels that do not get what was asked for, with where they are."""
    header = "x_mm,y_mm,z_mm,i,j,k,E_t_kPa,E_l_kPa,nearest_E_t_kPa,nearest_E_l_kPa,why"
    shape = "%.4f,%.4f,%.4f,%d,%d,%d,%.6g,%.6g,%.6g,%.6g,%s\n"
    flags = np.stack([chosen.beyond, chosen.tilted, chosen.across], axis=1)
    words = (
        "moduli beyond the foam table",
        "fibre out of the print plane",
        "right in the print plane only",
    )
    listed = np.flatnonzero(chosen.unreachable)
    columns = (
        *(1e3 * samples.places[listed].T),
        *samples.voxels[listed].T,
        *(1e-3 * np.stack([samples.E_t, samples.E_l])[:, listed]),
        *(1e-3 * _given(samples, chosen)[listed].T),
    )
    why = ["; ".join(compress(words, row)) for row in flags[listed].tolist()]
    rows = zip(*(column.tolist() for column in columns), why, strict=True)
    # A part may have a quarter of a million voxels.
    with path.open("w", newline="", encoding="utf-8") as file:
        file.write(f"{header}\n")
        file.writelines(shape % row for row in rows)


def icesl_dict(
    result: IceslResult, part: PrintedPart, table: FoamTable, convention: Convention
) -> dict[str, Any]:
    """Build the content of `icesl.json`, with the range of each texture.

    The rotation leads from the frame of the model to the bed; the shift follows it.
    """
    counts = {k: getattr(result, f"n_{k}") for k in ("beyond", "tilted", "across")}
    return plain(
        {
            "format": "softcal_jax.icesl/1",
            "infill": result.infill,
            "table": {"source": table.source, "file": TABLE},
            "angle": {
                "marks": convention.marks,
                "offset_deg": np.rad2deg(convention.offset),
                "clockwise": convention.clockwise,
            },
            "bed": {
                "rotation": part.rotation,
                "shift_mm": 1e3 * part.shift,
                "size_mm": 1e3 * part.mesh.points.max(axis=0),
            },
            "settings": list(map(_setting_dict, result.settings)),
            "voxels": {"n": N_VOXELS, "filled": result.n_voxels, **counts},
            "worst": result.worst,
            "rounding": result.rounding,
            "notes": result.notes,
        }
    )


def _setting_dict(setting: SlicerSetting) -> dict[str, Any]:
    if setting.texture is None:
        return {"name": setting.name, "constant": setting.constant}
    step, texture = setting.full / 255.0, setting.texture
    ends = {"lowest": step * texture.min(), "highest": step * texture.max()}
    return {"name": setting.name, **ends}


_HEAD = """\
-- {title}
-- Written by softcal_jax for IceSL, in the language of its releases of 2021 to 2025.
-- Older releases take the texture first: set_setting_value(texture, min, max, name).
--
{comments}
--
-- Before the robot, print a small bar with the same settings and bend it both ways: the
-- documents of IceSL do not say which axis of the foam the angle marks, nor which way
-- it counts. If the bar is stiff where it should be soft, export again with the other
-- convention.

local part = load(Path .. '{part}')
emit(part, 0)
local box = bbox(part)
"""

_TEXTURE = """\
-- Textures hold steps of 1/255: two hexadecimal digits per voxel along x, one line
-- per row of voxels along y, layer by layer along z. A quarter of a step is added, so
-- that the same step comes out whether IceSL rounds or cuts off.
local function texture(rows)
  local field = tex3d_r8f({n}, {n}, {n})
  local row = 0
  for line in string.gmatch(rows, '%x+') do
    local j, k = row % {n}, math.floor(row / {n})
    for i = 0, {n} - 1 do
      local step = tonumber(string.sub(line, 2 * i + 1, 2 * i + 2), 16)
      field:set(i, j, k, v(math.min((step + 0.25) / 255, 1), 0, 0))
    end
    row = row + 1
  end
  return field
end
"""


def script(
    title: str, comments: Iterable[str], part: str, infill: str, chosen: Chosen
) -> str:
    """Write the script, with comments for its reader; `part` is the file beside it."""
    head = _HEAD.format(
        title=_one_line(title),
        comments="\n".join(f"-- {_one_line(line)}" for line in comments),
        part=part,
    )
    if any(setting.texture is not None for setting in chosen.settings):
        head += _TEXTURE.format(n=N_VOXELS)
    values = {
        "infill_type": f"'{infill}'",
        "num_shells": "0",
        "cover_thickness_mm": "0",
        "print_perimeter": "false",
    }
    lowest = 100.0 * float(chosen.foam.density.min())
    if infill == "Polyfoam" and lowest < 20.0:  # where it goes only if told so
        # Below the lowest step of the texture as well.
        values["pfoam_min_percentage"] = str(max(int(lowest - 0.5), 0))
    for setting in chosen.settings:
        if setting.texture is None:
            values[setting.name] = f"{setting.constant:.9g}"
        else:
            # Two hexadecimal digits per voxel, one line per row along x.
            voxels = setting.texture.astype(np.uint8).transpose(2, 1, 0)
            rows = (row.tobytes().hex() for row in voxels.reshape(-1, len(voxels)))
            field = "texture([[\n{}\n]])".format("\n".join(rows))
            values[setting.name] = f"{field}, box:min_corner(), box:max_corner()"
    # The suffix _0 stands for the first brush.
    lines = [f"set_setting_value('{name}_0', {v})" for name, v in values.items()]
    return "\n".join([head, *lines]) + "\n"


def _one_line(text: str) -> str:
    return escaped(" ".join(text.split()))
