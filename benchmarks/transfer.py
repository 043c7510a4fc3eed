"""Do the values of one robot hold for another? What `softcal transfer` says, and where.

- `planted`: ten times two printed strips of one material, E at three control points, of
  other sections and in other poses. The first is clamped as stated (`right`), or 10 mm
  deeper than its project says (`wrong`): then its field makes up for the mounting, and
  must not be called that of the material. `wrong_fit_over_right` says how well it does:
  the rms of the markers of the first strip after each fit.
- `printed`: the same with ten pairs of printed parallel robots, of one print each,
  assembled twice and measured in other poses. A wrong mounting has its motors 2 mm off
  on each axis (standard deviation), and not 0.5 mm.
- `arm`: the silicone beam and the pneumatic arm, both of Dragon Skin 10, by the shear
  modulus of Gent's law.
- `sessions`: the tentacle in two sessions, by E.

`run transfer --count planted=1` does one part, with one pair.
"""

import itertools
import shutil
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks._parallel_robot import ParallelRobot, parallel_robot
from benchmarks._printed_robot import (
    PrintedRobot,
    PrintingErrors,
    printed_robot,
    read_poses_of,
)
from benchmarks._problem import Figure, Goal, Options, Outcome
from benchmarks._robot import READINGS, STD, STD_ANGLE, UNCERTAIN
from softcal_jax._typing import Float, HostArray
from softcal_jax.calibration import CalibrationResult, CalibrationSettings, calibrate
from softcal_jax.configurations import Configuration, Markers, Support, SurfaceForce
from softcal_jax.equilibrium import build_model
from softcal_jax.fields import (
    ControlPointParameters,
    ControlPoints,
    ParameterSpace,
    exactly_known,
)
from softcal_jax.inference import difference
from softcal_jax.materials import NeoHookean
from softcal_jax.mesh import beam
from softcal_jax.project import Project, load_project
from softcal_jax.results import transfer
from softcal_jax.robots import ready_made_path, synthetic_measurements

LENGTH, JITTER = 0.12, 1e-4
"""Of the strips, and the standard deviation of each coordinate of a marker [m]."""

E_START, SPREAD = 300e3, 0.3
"""Mean modulus of what is printed [Pa], and the spread of its logarithm [-]."""

CLAMPED = 0.01
"""By how much the clamp of a wrong mounting is longer than stated [m]."""


class Strip(NamedTuple):
    """Height and width [m]; per pose the direction of gravity, and a weight [N]."""

    section: tuple[float, float]
    poses: tuple[tuple[tuple[float, float, float], float], ...]


FIRST = Strip(
    (0.015, 0.015),
    (((0, -1, 0), 0.0), ((0, -1, 0), 0.03), ((0, 1, 0), 0.0), ((0, 1, 0), 0.03)),
)
SECOND = Strip(
    (0.012, 0.02),
    (((0, -1, 0), 0.0), ((0, -1, 0), 0.02), ((0, 0, 1), 0.0), ((0, 0, 1), 0.1)),
)

COARSE = 0.01
"""Edge length of the tets of the parallel robots [m]."""

MOUNTED = 2e-3
"""Standard deviation of the place of a motor that is mounted wrongly, per axis [m]."""

COUNTS = {"planted": 10, "printed": 10, "arm": 1, "sessions": 1}

GOALS = {
    f"{part}{mounting}_told_apart_percent": goal
    for part in ("", "printed_")
    for mounting, goal in (
        ("wrong", Goal("at least", 90.0)),
        ("right", Goal("at most", 10.0)),
    )
}

_GENT = (
    ('law = "neo-hookean" #', 'law = "gent" #'),
    ('E = "200 kPa" ', 'mu = "100 kPa"\nJ_m = 60 '),
    (
        'field = "E"\nlower = "50 kPa"\nupper = "1 MPa"',
        'field = "mu"\nlower = "20 kPa"\nupper = "400 kPa"',
    ),
)
"""The beam with the law of the arm's silicone, and its J_m."""


def run(options: Options) -> Outcome:
    """Each part by itself."""
    figures: dict[str, Figure] = {}
    for part, count in (options.counts or COUNTS).items():
        options.say(part)
        figures |= _PARTS[part](count)
    goals = {name: goal for name, goal in GOALS.items() if name in figures}
    return Outcome(figures, goals=goals)


def planted(count: int) -> dict[str, Figure]:
    """Pairs of strips: how often they are told apart, and how well the first fits."""
    apart: dict[str, list[bool]] = {"right": [], "wrong": []}
    rms: dict[str, list[float]] = {"right": [], "wrong": []}
    random = np.random.default_rng(5)
    for _ in range(count):
        E = E_START * np.exp(SPREAD * random.standard_normal(3))
        of_second = _fitted(SECOND, E, random).estimate
        for mounting, clamped in (("right", 0.0), ("wrong", CLAMPED)):
            fit = _fitted(FIRST, E, random, clamped)
            d = difference(fit.estimate, of_second)
            apart[mounting].append(not d.agree)
            rms[mounting] += [c.rms_after for c in fit.configurations]
    return {
        "wrong_told_apart_percent": 100.0 * float(np.mean(apart["wrong"])),
        "right_told_apart_percent": 100.0 * float(np.mean(apart["right"])),
        "wrong_fit_over_right": float(np.mean(rms["wrong"]) / np.mean(rms["right"])),
    }


def _fitted(
    strip: Strip,
    E: Float[HostArray, "3"],
    random: np.random.Generator,
    clamped: float = 0.0,
) -> CalibrationResult:
    """Measure a strip whose clamp is longer than stated [m], and calibrate it."""
    mesh = beam(LENGTH, *strip.section, (12, 1, 1), order=2)
    model = build_model(mesh, NeoHookean(E_START, 0.3), density=1000.0)
    points = ControlPoints([(x, 0.0, 0.0) for x in (0.0, LENGTH / 2, LENGTH)])
    field = ControlPointParameters(
        "E", points, start=E_START, lower=3e4, upper=3e6, unit="Pa"
    )
    places = [(x * LENGTH, 0.0, 0.0) for x in (0.25, 0.5, 0.75, 1.0)]
    markers = Markers(("a", "b", "c", "d"), places, JITTER)
    times = lambda size, d: (size * d[0], size * d[1], size * d[2])
    stated = [
        Configuration(
            f"pose {k + 1}",
            "x_min",
            gravity=times(9.81, down),
            loads=[SurfaceForce("x_max", times(weight, down))],
            markers=markers,
        )
        for k, (down, weight) in enumerate(strip.poses)
    ]
    held = Support(np.flatnonzero(mesh.points[:, 0] <= clamped))
    space = ParameterSpace((field,))
    exact = synthetic_measurements(
        model,
        space,
        [replace(pose, supports=(held,)) for pose in stated],
        dict(zip(space.names, E, strict=True)),
    )
    jittered = lambda x: x + JITTER * random.standard_normal(x.shape)
    read = [
        replace(pose, measured=jittered(c.measured))
        for pose, c in zip(stated, exact, strict=True)
    ]
    known = exactly_known()
    return calibrate(model, space, read, uncertain=known, intervals=None)


def printed(count: int) -> dict[str, Figure]:
    """Pairs of parallel robots of one print: how often they are told apart."""
    robot = parallel_robot(size=COARSE, setup=None, std=STD, std_angle=STD_ANGLE)
    errors = {"right": PrintingErrors(), "wrong": PrintingErrors(mounting=MOUNTED)}
    apart: dict[str, list[bool]] = {"right": [], "wrong": []}
    buckled = 0
    for seed in itertools.count():
        if len(apart["right"]) == count:
            break
        build = partial(printed_robot, robot.geometry, seed=seed, size=COARSE)
        firsts = {name: build(errors=e) for name, e in errors.items()}
        try:  # mounted so wrongly, some buckle where they should be measured
            read = {
                name: _read(first, robot.configurations, seed)
                for name, first in firsts.items()
            }
        except RuntimeError:
            buckled += 1
            continue
        again = _read(build(assembly=1000 + seed), robot.validation, seed + 1)
        of_second = _material_of(robot, again).estimate
        for name, poses in read.items():
            d = difference(_material_of(robot, poses).estimate, of_second)
            apart[name].append(not d.agree)
    shares = {
        f"printed_{name}_told_apart_percent": 100.0 * float(np.mean(flags))
        for name, flags in apart.items()
    }
    return {**shares, "printed_buckled": buckled}


def _read(
    robot: PrintedRobot, poses: Sequence[Configuration], seed: int
) -> tuple[Configuration, ...]:
    return read_poses_of(robot, poses, seed=seed, readings=READINGS)


def _material_of(
    robot: ParallelRobot, poses: Sequence[Configuration]
) -> CalibrationResult:
    """Calibrate the material of the model, with its setup as stated."""
    return calibrate(
        robot.model,
        robot.space,
        poses,
        noise="stated",
        uncertain=UNCERTAIN,
        settings=CalibrationSettings(max_steps=100),
        starts=1,
        intervals=None,
    )


def arm(count: int) -> dict[str, Figure]:
    """The beam, by the law of the arm's silicone, and the arm."""
    del count
    of_beam = _changed(ready_made_path("beam"), _GENT)
    return _asked("arm", "mu", of_beam, load_project(ready_made_path("pneumatic-arm")))


def sessions(count: int) -> dict[str, Figure]:
    """The tentacle in one session, and in the other."""
    del count
    first = load_project(ready_made_path("tentacle"))
    second = replace(first, calibration=first.validation, validation=())
    return _asked("sessions", "E", replace(first, validation=()), second)


def _asked(part: str, name: str, a: Project, b: Project) -> dict[str, Figure]:
    """Calibrate both, and ask the second for the values of the first."""
    of_a, of_b = (replace(p, intervals=None).calibrate() for p in (a, b))
    found = transfer(of_a.estimate, b, of_b)
    d = found.difference
    i = d.names.index(name)
    both = np.isfinite(found.rms_own) & np.isfinite(found.rms_of_a)
    squares = lambda rms: float(1e3 * np.sqrt(np.mean(rms[both] ** 2)))
    return {
        f"{part}_{name}_first_kPa": float(d.of_a[i] / 1e3),
        f"{part}_{name}_first_standard_error_kPa": float(d.std_a[i] / 1e3),
        f"{part}_{name}_second_kPa": float(d.of_b[i] / 1e3),
        f"{part}_{name}_second_standard_error_kPa": float(d.std_b[i] / 1e3),
        f"{part}_chi_squared": d.chi_squared,
        f"{part}_agree": int(d.agree),
        f"{part}_poses_lost": len(found.lost),
        f"{part}_rms_of_second_mm": squares(found.rms_own),
        f"{part}_rms_of_second_by_first_mm": squares(found.rms_of_a),
    }


def _changed(path: Path, changes: Sequence[tuple[str, str]]) -> Project:
    """Load a copy of a project file with pieces of it exchanged."""
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(shutil.copytree(path.parent, Path(folder) / "copy")) / path.name
        text = copy.read_text(encoding="utf-8")
        for old, new in changes:
            if text.count(old) != 1:
                raise RuntimeError(f"{old!r} does not stand once in {path}.")
            text = text.replace(old, new)
        copy.write_text(text, encoding="utf-8")
        return load_project(copy)


_PARTS: dict[str, Callable[[int], dict[str, Figure]]] = {
    "planted": planted,
    "printed": printed,
    "arm": arm,
    "sessions": sessions,
}
