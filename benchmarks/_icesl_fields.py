"""Random fields as foam for IceSL: do the textures hold them, and the list the rest?"""

import csv
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import jax
import numpy as np

from benchmarks._icesl import STEPS, N, Slicer
from benchmarks._problem import Figure
from softcal_jax.designs import published_foam
from softcal_jax.equilibrium import build_model
from softcal_jax.exchange.icesl import Design, IceslResult, export_icesl
from softcal_jax.fields import ControlPointParameters, ControlPoints, ParameterSpace
from softcal_jax.materials import Corotational, Fibre, ReducedTransverseIsotropic
from softcal_jax.mesh import beam

SEED = 23


class Field(NamedTuple):
    """Moduli and fibre at control points of a beam, and how the slicer counts angles.

    Attributes:
        size: Edges of the beam [m].
        places: Control points [m].
        E_t: Modulus across the fibre there [Pa].
        E_l: Modulus along it [Pa].
        theta: Its angle in the xy plane [rad].
        marks: Axis of the foam that the angle marks.
        offset: Added to every angle [rad].
        clockwise: Whether angles count clockwise.
    """

    size: np.ndarray
    places: np.ndarray
    E_t: np.ndarray
    E_l: np.ndarray
    theta: np.ndarray
    marks: str
    offset: float
    clockwise: bool

    def at_centres(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Mix E_t, E_l and theta at the centres of the voxels, by their definition."""
        steps = (np.arange(N) + 0.5) / N
        centres = np.stack(np.meshgrid(*(steps,) * 3, indexing="ij"), -1) * self.size
        squares = ((centres[..., None, :] - self.places) ** 2).sum(axis=-1)
        w = (1.0 / squares) / (1.0 / squares).sum(axis=-1, keepdims=True)
        c, s = (w @ part(2.0 * self.theta) for part in (np.cos, np.sin))
        return w @ self.E_t, w @ self.E_l, 0.5 * np.arctan2(s, c)


def run(count: int, say: Callable[[str], None]) -> dict[str, Figure]:
    """Write so many fields, and read them back.

    Returns:
        `icesl_roundtrip_steps`: largest distance of a texture from the field, in steps
        of 1/255. `icesl_unlisted_voxels`: voxels whose moduli the foam misses by more
        than 1 % and that are not listed, or the other way round.
        `icesl_listed_percent`: share of the voxels that were listed.
        `icesl_export_s`: slowest export.
    """
    jax.config.update("jax_enable_x64", True)
    random = np.random.default_rng(SEED)
    steps, seconds, listed, unlisted = 0.0, 0.0, 0, 0
    for number in range(count):
        field = draw(random)
        say(f"icesl: field {number + 1} of {count}, {len(field.places)} control points")
        with tempfile.TemporaryDirectory() as folder:
            begin = time.perf_counter()
            written = write(field, Path(folder) / "print")
            seconds = max(seconds, time.perf_counter() - begin)
            steps = max(
                steps, distance(field, Slicer(Path(folder) / "print/robot.lua"))
            )
            off, length = compare_list(field, written)
        unlisted, listed = unlisted + off, listed + length
    return {
        "icesl_roundtrip_steps": steps,
        "icesl_unlisted_voxels": unlisted,
        "icesl_listed_percent": 100.0 * listed / (count * N**3),
        "icesl_export_s": seconds,
    }


def draw(random: np.random.Generator) -> Field:
    """Draw a beam with two to five control points, some softer than any foam."""
    n = int(random.integers(2, 6))
    size = random.uniform(0.01, 0.1, 3)
    foam = published_foam()
    density, shrink = random.uniform(0.1, 0.32, n), random.uniform(0.25, 0.9, n)
    E_l, E_t = foam.moduli(density, shrink).T
    E_l = E_l * random.uniform(0.2, 1.0, n)
    return Field(
        size,
        random.uniform(0.0, 1.0, (n, 3)) * size,
        E_t,
        E_l,
        random.uniform(-0.5, 0.5, n) * np.pi,
        str(random.choice(["soft", "stiff"])),
        float(random.uniform(-np.pi, np.pi)),
        bool(random.integers(2)),
    )


def write(field: Field, folder: Path) -> IceslResult:
    """Write a field by the package."""
    law = ReducedTransverseIsotropic(1e6, 5e5, 0.3, Fibre(0.0, plane="xy"))
    length, width, height = field.size
    mesh = beam(length, width, height, (4, 2, 2))
    model = build_model(mesh, Corotational(law), density=400.0)
    points = ControlPoints(field.places)
    modulus = {"lower": 1e3, "upper": 1e8, "unit": "Pa"}
    space = ParameterSpace(
        (
            ControlPointParameters("E_t", points, start=field.E_t, **modulus),
            ControlPointParameters("E_l", points, start=field.E_l, **modulus),
            ControlPointParameters(
                "theta",
                points,
                start=field.theta,
                lower=-np.pi / 2,
                upper=np.pi / 2,
                scale="linear",
                interpolation="director",
                unit="rad",
            ),
        )
    )
    z = space.start()
    return export_icesl(
        Design(space.model_at(model, z), space, z),
        folder,
        angle_marks="soft" if field.marks == "soft" else "stiff",
        angle_offset=field.offset,
        clockwise=field.clockwise,
    )


def distance(field: Field, slicer: Slicer) -> float:
    """Find how far what the slicer holds is from the field [steps of 1/255]."""
    E_t, E_l, theta = field.at_centres()
    foam = published_foam().find(E_l.ravel(), E_t.ravel())
    density = slicer.values("infill_percentage_0") - foam.density.reshape(E_t.shape)
    shrink = slicer.values("kgon_x_shrink_0") - foam.anisotropy.reshape(E_t.shape)
    # Back from what the slicer counts to the soft axis, an axis by half a turn.
    angle = 2.0 * np.pi * slicer.values("infill_angle_0") - field.offset
    angle = -angle if field.clockwise else angle
    angle = angle + (0.5 * np.pi if field.marks == "stiff" else 0.0)
    off = np.mod(angle - theta + 0.5 * np.pi, np.pi) - 0.5 * np.pi
    parts = (density, shrink, off / (2.0 * np.pi))
    return float(STEPS * max(np.abs(part).max() for part in parts))


def compare_list(field: Field, written: IceslResult) -> tuple[int, int]:
    """Count voxels that are listed wrongly or not at all, and those that are listed."""
    E_t, E_l, _ = field.at_centres()
    beyond = published_foam().find(E_l.ravel(), E_t.ravel()).error > 0.01
    listed = np.zeros((N,) * 3, bool)
    path = written.directory / "unreachable.csv"
    if path.exists():
        with path.open(newline="") as file:
            for row in csv.DictReader(file):
                listed[int(row["i"]), int(row["j"]), int(row["k"])] = True
    return int((beyond != listed.ravel()).sum()), int(listed.sum())
