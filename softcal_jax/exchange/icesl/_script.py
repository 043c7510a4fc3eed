"""The script that gives IceSL a part and its infill."""

from collections.abc import Iterable

import numpy as np

from softcal_jax._text import escaped
from softcal_jax.exchange.icesl._fields import N_VOXELS
from softcal_jax.exchange.icesl._settings import Chosen

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


_LOWEST_PERCENTAGE = 20.0
"""Density below which Polyfoam does not go unless told so [%]."""


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
    if infill == "Polyfoam" and lowest < _LOWEST_PERCENTAGE:
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
    # Of the first brush.
    lines = [f"set_setting_value('{name}_0', {v})" for name, v in values.items()]
    return "\n".join([head, *lines]) + "\n"


def _one_line(text: str) -> str:
    return escaped(" ".join(text.split()))
