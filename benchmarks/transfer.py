"""Do the values of one robot hold for another? What `softcal transfer` says, and where.

- `planted`: ten times two printed strips of one material, {E_t, E_l, theta} at two
  control points, of other sections and in other poses. The first is mounted as stated
  (`right`), or turned by ten degrees about its axis, which its project does not say
  (`wrong`): then its field makes up for the mounting, and must not be called that of
  the material. `wrong_fit_over_right` says how well it does: the rms of the markers of
  the first strip after each fit.
- `arm`: the silicone beam and the pneumatic arm, both of Dragon Skin 10, by the shear
  modulus of Gent's law.
- `sessions`: the tentacle in two sessions, by E.

`run transfer --count planted=1` does one part, with one pair.
"""

import shutil
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks._problem import Figure, Goal, Options, Outcome
from benchmarks._random_beams import (
    LAYOUTS,
    NOISES,
    Layout,
    noisy,
    problem,
    true_values,
)
from softcal_jax.calibration import CalibrationResult, calibrate
from softcal_jax.configurations import Support
from softcal_jax.inference import Estimate, difference
from softcal_jax.project import Project, load_project
from softcal_jax.report import transfer
from softcal_jax.robots import ready_made_path, synthetic_measurements

CLAMPED = 0.02
"""By how much the clamps of a wrong mounting are longer than stated [m]."""

FIRST, SECOND = LAYOUTS[0], LAYOUTS[2]

JITTERED = NOISES[0]

COUNTS = {"planted": 10, "arm": 1, "sessions": 1}

GOALS = {
    "wrong_told_apart_percent": Goal("at least", 90.0),
    "right_told_apart_percent": Goal("at most", 10.0),
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
    for truth in true_values(problem(FIRST)[1], count):
        of_second = _estimate(_fitted(SECOND, truth, random))
        for mounting, clamped in (("right", 0.0), ("wrong", CLAMPED)):
            fit = _fitted(FIRST, truth, random, clamped)
            apart[mounting].append(not difference(_estimate(fit), of_second).agree)
            rms[mounting] += [c.rms_after for c in fit.configurations]
    return {
        "wrong_told_apart_percent": 100.0 * float(np.mean(apart["wrong"])),
        "right_told_apart_percent": 100.0 * float(np.mean(apart["right"])),
        "wrong_fit_over_right": float(np.mean(rms["wrong"]) / np.mean(rms["right"])),
    }


def _fitted(
    layout: Layout,
    truth: Mapping[str, float],
    random: np.random.Generator,
    clamped: float = 0.0,
) -> CalibrationResult:
    """Calibrate a strip, measured with its clamps longer than stated [m]."""
    model, space, stated = problem(layout)
    x, length = model.mesh.points[:, 0], layout.size[0]
    held = {"x_min": x <= clamped, "x_max": x >= length - clamped}
    mounted = [
        replace(c, supports=(Support(np.flatnonzero(held[pose.held])),))
        for c, pose in zip(stated, layout.poses, strict=True)
    ]
    exact = synthetic_measurements(model, space, mounted, truth)
    read = [
        replace(pose, measured=c.measured)
        for pose, c in zip(stated, noisy(exact, JITTERED, random), strict=True)
    ]
    known = {"noise": "stated", "uncertain": JITTERED.uncertain}
    return calibrate(model, space, read, **known, intervals=None)


def arm(count: int) -> dict[str, Figure]:
    """The beam, by the law of the arm's silicone, and the arm."""
    del count
    beam = _changed(ready_made_path("beam"), _GENT)
    return _asked("arm", "mu", beam, load_project(ready_made_path("pneumatic-arm")))


def sessions(count: int) -> dict[str, Figure]:
    """The tentacle in one session, and in the other."""
    del count
    first = load_project(ready_made_path("tentacle"))
    second = replace(first, calibration=first.validation, validation=first.calibration)
    return _asked("sessions", "E", first, second)


def _asked(part: str, name: str, a: Project, b: Project) -> dict[str, Figure]:
    """Calibrate both, and ask the second for the values of the first."""
    of_a, of_b = (replace(p, intervals=None).calibrate() for p in (a, b))
    found = transfer(_estimate(of_a), b, of_b)
    d = found.difference
    i = d.names.index(name)
    squares = lambda rms: float(1e3 * np.sqrt(np.mean(rms**2)))
    return {
        f"{part}_{name}_first_kPa": float(d.of_a[i] / 1e3),
        f"{part}_{name}_first_standard_error_kPa": float(d.std_a[i] / 1e3),
        f"{part}_{name}_second_kPa": float(d.of_b[i] / 1e3),
        f"{part}_{name}_second_standard_error_kPa": float(d.std_b[i] / 1e3),
        f"{part}_chi_squared": d.chi_squared,
        f"{part}_agree": int(d.agree),
        f"{part}_rms_of_second_mm": squares(found.rms_own),
        f"{part}_rms_of_second_by_first_mm": squares(found.rms_of_a),
    }


def _estimate(fit: CalibrationResult) -> Estimate:
    return Estimate(fit.space, fit.z, fit.budget.covariance)


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
    "arm": arm,
    "sessions": sessions,
}
