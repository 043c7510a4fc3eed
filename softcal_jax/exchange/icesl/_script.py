"""The script that gives IceSL a part and its infill."""

from typing import NamedTuple

import numpy as np

from softcal_jax._text import escaped
from softcal_jax._typing import HostArray, Int
from softcal_jax.exchange.icesl._fields import N_VOXELS
from softcal_jax.exchange.icesl._settings import Setting

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


class Script(NamedTuple):
    """What a script says.

    Attributes:
        title: Its first line.
        comments: Further lines, for the reader.
        part: Name of the file of the part, beside the script.
        infill: "Polyfoam" or "Phasor".
        settings: Density, angles and anisotropy.
        min_percentage: Lowest density that Polyfoam shall allow; None for that of IceSL
            (20) [%].
    """

    title: str
    comments: tuple[str, ...]
    part: str
    infill: str
    settings: tuple[Setting, ...]
    min_percentage: int | None

    def __str__(self) -> str:
        """Write the script."""
        head = _HEAD.format(
            title=_one_line(self.title),
            comments="\n".join(f"-- {_one_line(line)}" for line in self.comments),
            part=self.part,
        )
        if any(own.texture is not None for own in self.settings):
            head += _TEXTURE.format(n=N_VOXELS)
        constants: list[tuple[str, str]] = [
            ("infill_type", f"'{self.infill}'"),
            ("num_shells", "0"),
            ("cover_thickness_mm", "0"),
            ("print_perimeter", "false"),
        ]
        if self.min_percentage is not None:
            constants.append(("pfoam_min_percentage", str(self.min_percentage)))
        lines = [head, *(_set(name, value) for name, value in constants)]
        for own in self.settings:
            if own.texture is None:
                lines.append(_set(own.name, f"{own.constant:.9g}"))
                continue
            rows = _rows(own.texture)
            box = "box:min_corner(), box:max_corner()"
            lines.append(_set(own.name, f"texture([[\n{rows}]]), {box}"))
        return "\n".join(lines) + "\n"


def _set(name: str, value: str) -> str:
    """Write a line that sets something of the first brush."""
    return f"set_setting_value('{name}_0', {value})"


def _one_line(text: str) -> str:
    return escaped(" ".join(text.split()))


def _rows(texture: Int[HostArray, "n n n"]) -> str:
    """Write two hexadecimal digits per voxel, one line per row along x."""
    rows = texture.astype(np.uint8).transpose(2, 1, 0).reshape(-1, len(texture))
    return "".join(f"{row.tobytes().hex()}\n" for row in rows)
