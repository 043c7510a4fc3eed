"""From a CAD model to a calibrated robot in other programs, by commands alone.

A finger with a cavity that is open at its inlet is meshed from STEP, and blown up at
three pressures with moduli that are known. What `softcal simulate` writes there takes
the place of cameras; the calibration starts elsewhere, on the same mesh, and its result
goes to SOFA, CalculiX and IceSL.
"""

import csv
import json
import os
import shlex
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from pathlib import Path

import softcal_jax
from benchmarks import _sofa
from benchmarks._cad_models import write_finger
from benchmarks._problem import Figure

TRUE = {"E_t": 1.1e6, "E_l": 0.31e6}
START = {"E_t": 0.7e6, "E_l": 0.5e6}
"""Moduli across the fibre and along it [Pa]."""

PRESSURES = ("20 kPa", "40 kPa", "60 kPa")

COMMANDS = (
    ["mesh", "finger.step", "--size", "5 mm", "-o", "finger.msh"],
    ["simulate", "true.toml", "-o", "true"],
    ["calibrate", "project.toml", "-o", "results"],
    ["export", "sofa", "results", "-o", "scene"],
    ["export", "inp", "results", "-o", "job.inp", "--configuration", PRESSURES[-1]],
    ["export", "icesl", "results", "-o", "print"],
)

_SOFTCAL = "import sys; from softcal_jax.cli import main; sys.exit(main())"

_ROBOT = """\
name = "finger"

[mesh]
file = "finger.msh"
length_unit = "mm"

[groups.base]
face = {{ points = ["(0, 2, 2) mm"] }}

[groups.wall]
inside = {{ point = "(30, 8, 6) mm", stop_at = "base" }}

[material]
law = "corotational"
elasticity = "reduced-transverse-isotropic"
E_t = "{E_t} Pa"
E_l = "{E_l} Pa"
nu = 0.3
theta = "0 deg"
print_plane = "xy"
density = "400 kg/m^3"

[[parameters]]
field = "E_t"
lower = "100 kPa"
upper = "5 MPa"

[[parameters]]
field = "E_l"
lower = "100 kPa"
upper = "5 MPa"

[actuators.air]
type = "chamber"
surface = "wall"
seal = true

[markers]
std = "0.1 mm"

[markers.positions]
tip = "(60, 8, 6) mm"
edge = "(60, 16, 12) mm"
top = "(30, 8, 12) mm"
side = "(30, 16, 6) mm"

[shared]
gravity = "(0, 0, -9.81) m/s^2"
supports = [{{ group = "base" }}]
markers = ["tip", "edge", "top", "side"]
"""

_MEASURED = '\n[shared.measured]\nfile = "measured.csv"\n'
_POSE = '\n[[configurations]]\nname = "{0}"\nactuation = {{ air = "{0}" }}\n'
_SELECT = 'measured.select = {{ pressure = "{0}" }}\n'


def run(count: int, say: Callable[[str], None]) -> dict[str, Figure]:
    """Go the whole way so many times.

    Returns:
        `cad_to_result_s`: time of all commands, start of Python and compiling
        included, of the fastest way. `cad_modulus_error_percent`: largest error of a
        modulus. Empty where gmsh is missing.
    """
    seconds, error = [], 0.0
    for number in range(count):
        with tempfile.TemporaryDirectory() as folder:
            try:
                write_finger(Path(folder) / "finger.step")
            except (ImportError, OSError) as missing:
                say(
                    f"cad_to_result: no figures. There is no gmsh ({missing}): "
                    "pip install 'softcal-jax[cad]'."
                )
                return {}
            say(f"cad_to_result: {number + 1} of {count}")
            took, values = go(Path(folder), say)
        seconds.append(took)
        error = max(error, *(abs(values[name] / TRUE[name] - 1.0) for name in TRUE))
    return {
        "cad_to_result_s": min(seconds),
        "cad_modulus_error_percent": 100.0 * error,
    }


def go(folder: Path, say: Callable[[str], None]) -> tuple[float, Mapping[str, float]]:
    """Take `finger.step` all the way; returns seconds and the moduli [Pa].

    Raises:
        RuntimeError: If a command fails.
        ValueError: If SOFA would not understand the scene.
    """
    poses = "".join(_POSE.format(pressure) for pressure in PRESSURES)
    (folder / "true.toml").write_text(_ROBOT.format(**TRUE) + poses)
    poses = "".join((_POSE + _SELECT).format(pressure) for pressure in PRESSURES)
    text = _ROBOT.format(**START) + _MEASURED + poses
    (folder / "project.toml").write_text(text)

    seconds = 0.0
    for command in COMMANDS:
        begin = time.perf_counter()
        _softcal(folder, command)
        seconds += (took := time.perf_counter() - begin)
        say(f"  {took:5.1f} s  softcal {shlex.join(command)}")
        if command[0] == "simulate":
            _as_measured(folder / "true" / "markers.csv", folder / "measured.csv")
    _sofa.run(folder / "scene", "v26.06")
    result = json.loads((folder / "results" / "result.json").read_text("utf-8"))
    return seconds, {p["name"]: p["value"] for p in result["parameters"]}


def _softcal(folder: Path, arguments: list[str]) -> None:
    """Run a command in a folder, as a user does whose first commands these are.

    Compiled programs are kept in the folder, too, so none is there at the beginning.
    """
    package = str(Path(softcal_jax.__file__).parents[1])  # the one that runs here
    path = os.pathsep.join([package, *filter(None, [os.environ.get("PYTHONPATH")])])
    programs = str(folder / "programs")
    done = subprocess.run(
        [sys.executable, "-c", _SOFTCAL, *arguments],
        cwd=folder,
        env={
            **os.environ,
            "PYTHONPATH": path,
            "JAX_COMPILATION_CACHE_DIR": programs,
        },
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode != 0:
        output = f"{done.stdout}\n{done.stderr}"[-2000:]
        raise RuntimeError(f"softcal {' '.join(arguments)} failed:\n{output}")


def _as_measured(simulated: Path, measured: Path) -> None:
    """Write positions that were simulated as a table of measured ones."""
    with simulated.open(newline="") as source, measured.open("w", newline="") as file:
        written = csv.writer(file)
        written.writerow(["pressure", "marker", "x_mm", "y_mm", "z_mm"])
        for row in csv.DictReader(source):
            at = [row[f"simulated_{axis}_mm"] for axis in "xyz"]
            written.writerow([row["configuration"], row["marker"], *at])
