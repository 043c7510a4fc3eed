"""A strict stand-in for IceSL: runs a script, and keeps what the slicer would be told.

IceSL is a program with a window. Here a Lua interpreter runs the script with the
functions of the slicer that are described in its documentation and used in the examples
of its makers; any other name, a setting that IceSL does not have, a value out of range
or a texture of another size fails.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import lupa.lua51
import meshio
import numpy as np

N = 64
STEPS = 255

RANGES = {
    "infill_percentage_0": 100.0,
    "infill_angle_0": 360.0,
    "kgon_x_shrink_0": 1.0,
    "phasor_infill_theta_0": 360.0,
    "phasor_infill_phi_0": 360.0,
    "phasor_infill_iso_0": 100.0,
    "pfoam_min_percentage_0": 100.0,
}
"""Settings that are numbers, and what a texture of 1 stands for in their own unit."""

WORDS = {"infill_type_0": {"Polyfoam", "Phasor"}}
COUNTS = {"num_shells_0", "cover_thickness_mm_0"}
SWITCHES = {"print_perimeter_0"}
WITHOUT_TEXTURE = {"pfoam_min_percentage_0"}

_RUNTIME = """
local host = ...
local Vector = {}
local function v(x, y, z)
  assert(type(x) == 'number' and type(y) == 'number' and type(z) == 'number',
         'v needs three numbers')
  return setmetatable({x = x, y = y, z = z}, Vector)
end
local Texture = {}
Texture.__index = function(_, key) return rawget(Texture, key) or
  error('a texture has no ' .. tostring(key)) end
local function whole(index)
  return type(index) == 'number' and index >= 0 and index < host.n
    and index == math.floor(index)
end
function Texture.set(self, i, j, k, value, ...)
  assert(select('#', ...) == 0, 'set takes three indices and a vector')
  assert(whole(i) and whole(j) and whole(k), 'indices go from 0 to 63')
  assert(getmetatable(value) == Vector, 'a texture holds vectors')
  assert(value.x >= 0 and value.x <= 1, 'a texture holds values from 0 to 1')
  local step = 255 * value.x
  if host.rounds then step = step + 0.5 end
  self.steps[i + host.n * (j + host.n * k)] = math.floor(step)
end
local function tex3d_r8f(x, y, z)
  assert(x == host.n and y == host.n and z == host.n, 'textures are 64 x 64 x 64')
  return setmetatable({steps = {}}, Texture)
end
local Shape, Box = {}, {}
Box.__index = function(box, key)
  if key == 'min_corner' then return function(self) return self.low end end
  if key == 'max_corner' then return function(self) return self.high end end
  error('a box has no ' .. tostring(key))
end
local function load(path) return setmetatable({path = path}, Shape) end
local function check_shape(shape)
  assert(getmetatable(shape) == Shape, 'a shape is needed')
end
local emitted = {}
local function emit(shape, brush)
  check_shape(shape)
  emitted[brush or 0] = true
  host.emit(shape.path, brush or 0)
end
local function bbox(shape)
  check_shape(shape)
  local c = host.corners(shape.path)
  return setmetatable({low = v(c[0], c[1], c[2]), high = v(c[3], c[4], c[5])}, Box)
end
local function set_setting_value(name, value, low, high, ...)
  assert(select('#', ...) == 0, 'a setting has a name, a value and two corners')
  assert(emitted[0], 'nothing was emitted with this brush')
  if getmetatable(value) ~= Texture then
    assert(low == nil and high == nil, 'only a texture has corners')
    return host.set(name, value)
  end
  assert(getmetatable(low) == Vector and getmetatable(high) == Vector,
         'a texture needs two corners')
  local steps = {}
  for index = 0, host.n ^ 3 - 1 do
    local step = assert(value.steps[index], 'a voxel was not set')
    steps[#steps + 1] = string.format('%02x', step)
  end
  host.texture(name, table.concat(steps),
               low.x, low.y, low.z, high.x, high.y, high.z)
end
local names = {
  v = v, tex3d_r8f = tex3d_r8f, load = load, emit = emit, bbox = bbox,
  set_setting_value = set_setting_value, Path = host.path,
  math = math, string = string, table = table, tonumber = tonumber,
}
local scope = setmetatable({}, {
  __index = function(_, key) return names[key] == nil and
    error('unknown name ' .. tostring(key)) or names[key] end,
  __newindex = function(_, key) error('global ' .. tostring(key) .. ' is set') end,
})
setfenv(assert(loadstring(host.script, 'script')), scope)()
"""


@dataclass(frozen=True)
class Texture:
    """A texture that was bound to a setting.

    Attributes:
        values: Values in [0, 1] by voxel, in whole steps of 1/255.
        low: Corner of the box that it fills [mm].
        high: The opposite corner [mm].
    """

    values: np.ndarray
    low: np.ndarray
    high: np.ndarray


class Slicer:
    """What a script has told the slicer.

    Attributes:
        settings: Values by name, in the slicer's own units.
        textures: Textures by the name of their setting.
        part: File of the shape that was emitted.
    """

    def __init__(self, script: Path, *, stores: Literal["rounded", "cut"] = "rounded"):
        """Run a script; a texture keeps the nearest step, or the next lower one.

        Raises:
            lupa.lua51.LuaError: If the script does what IceSL would not understand.
        """
        self.settings: dict[str, Any] = {}
        self.textures: dict[str, Texture] = {}
        self.part: Path | None = None
        lua = lupa.lua51.LuaRuntime(unpack_returned_tuples=True)
        host = {
            "n": N,
            "rounds": stores == "rounded",
            "script": script.read_text(encoding="utf-8"),
            "path": f"{script.parent}/",
            "emit": self._emit,
            "corners": lambda path: lua.table_from(
                dict(enumerate(map(float, np.ravel(self._corners(path)))))
            ),
            "set": self._set,
            "texture": self._texture,
        }
        lua.execute(_RUNTIME, lua.table_from(host))

    def values(self, name: str) -> np.ndarray:
        """Return a setting by voxel, as a share of its full range."""
        if name in self.textures:
            return self.textures[name].values
        return np.full((N, N, N), self.settings[name] / RANGES[name])

    def _emit(self, path: str, brush: int) -> None:
        if brush != 0 or self.part is not None:
            raise ValueError("one part was expected, with brush 0")
        self.part = Path(path)

    def _corners(self, path: str) -> np.ndarray:
        points = meshio.read(path).points
        return np.stack([points.min(axis=0), points.max(axis=0)])

    def _set(self, name: str, value: object) -> None:
        known = {*RANGES, *WORDS, *COUNTS, *SWITCHES}
        if name not in known:
            raise ValueError(f"unknown setting {name}")
        if name in WORDS:
            fine = value in WORDS[name]
        elif name in SWITCHES:
            fine = isinstance(value, bool)
        else:
            fine = isinstance(value, int | float) and not isinstance(value, bool)
            fine = fine and 0.0 <= float(str(value)) <= RANGES.get(name, 1e3)
        if not fine or name in self.settings or name in self.textures:
            raise ValueError(f"{name} = {value!r}")
        self.settings[name] = value

    def _texture(self, name: str, steps: str, *corners: float) -> None:
        if name not in RANGES or name in WITHOUT_TEXTURE:
            raise ValueError(f"{name} takes no texture")
        if name in self.settings or name in self.textures:
            raise ValueError(f"{name} is set twice")
        values = np.frombuffer(bytes.fromhex(steps), np.uint8).reshape(N, N, N)
        low, high = np.reshape(corners, (2, 3))
        self.textures[name] = Texture(values.transpose(2, 1, 0) / STEPS, low, high)
