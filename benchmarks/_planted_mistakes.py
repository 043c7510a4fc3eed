"""Four small robots, and mistakes in what is said of them, one at a time.

The robots are not quite those of their models: gravity is tilted and the loads are off
by as much as the default budget of errors says, and the readings have noise.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Literal, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks._wrong_models import problems
from softcal_jax._typing import HostArray
from softcal_jax.bodies import Pose
from softcal_jax.configurations import (
    Configuration,
    ImposedForce,
    Markers,
    Support,
    SurfaceForce,
)
from softcal_jax.equilibrium import Model, build_model
from softcal_jax.fields import Parameter, ParameterSpace, Uncertain
from softcal_jax.materials import NeoHookean
from softcal_jax.mesh import beam, box_faces
from softcal_jax.project import load_project
from softcal_jax.robots import ready_made_path, synthetic_measurements

WIDTHS = Uncertain()
"""How well gravity and loads are known."""

SPREAD = 0.2
"""Spread of the logarithm of each modulus about its nominal value [-]."""

Noise = Literal["estimated", "stated"]
Force = Literal["loads", "actuation"]


class Robot(NamedTuple):
    """A robot as it is, and its poses.

    Attributes:
        name: Its name.
        model: The model.
        space: What is calibrated.
        nominal: About what the parameters are, in SI units; fits start from elsewhere.
        poses: Its poses, without readings.
        noise: Where the noise comes from, see `calibrate`.
        force: What deforms it beside gravity.
        signed: What of this has a sign.
        marker: The marker up to which the clamp may reach.
    """

    name: str
    model: Model
    space: ParameterSpace
    nominal: Mapping[str, float]
    poses: tuple[Configuration, ...]
    noise: Noise
    force: Force
    signed: Force
    marker: str = "root"

    def measured(
        self,
        random: np.random.Generator,
        poses: tuple[Configuration, ...] | None = None,
    ) -> tuple[Configuration, ...]:
        """Return its poses with readings, by default of itself as it is stated."""
        spread = lambda: float(np.exp(SPREAD * random.standard_normal()))
        truth = {name: value * spread() for name, value in self.nominal.items()}
        tilt = WIDTHS.gravity * random.standard_normal(2)
        factor = 1.0 + WIDTHS.loads * float(random.standard_normal())
        real = [
            with_forces(_tilted(c, tilt), self.force, factor)
            for c in poses or self.poses
        ]
        seed = int(random.integers(1 << 31))
        read = synthetic_measurements(
            self.model, self.space, real, truth, noise=True, seed=seed
        )
        return tuple(
            replace(c, measured=r.measured, effectors=r.effectors)
            for c, r in zip(self.poses, read, strict=True)
        )


def _tilted(c: Configuration, tilt: HostArray) -> Configuration:
    """Turn gravity by two small angles about axes across it [rad]."""
    g = np.array(c.gravity)
    across = np.eye(3)[np.argsort(np.abs(g))[:2]]
    g = g + np.linalg.norm(g) * tilt @ across
    return replace(c, gravity=tuple(g.tolist()))


def with_forces(c: Configuration, force: Force, factor: float) -> Configuration:
    """Multiply the loads or the actuation of a pose."""
    if force == "loads":
        loads = []
        for load in c.loads:
            assert isinstance(load, SurfaceForce)
            scaled = factor * np.array(load.force)
            loads.append(SurfaceForce(load.where, tuple(scaled.tolist())))
        return replace(c, loads=tuple(loads))
    forces = {}
    for name, one in c.actuation.items():
        assert isinstance(one, ImposedForce)
        forces[name] = ImposedForce(factor * one.value)
    return replace(c, actuation=forces)


def robots() -> tuple[Robot, ...]:
    """The silicone beam, the cable beam, the pneumatic finger and a printed strip."""
    return _silicone_beam(), _cable_beam(), _finger(), _strip()


def _markers(places: Mapping[str, tuple[float, float, float]], std: float) -> Markers:
    """Markers at places in millimetres, with a standard deviation [m]."""
    positions = [[1e-3 * x for x in place] for place in places.values()]
    return Markers(tuple(places), np.array(positions), std)


def _silicone_beam() -> Robot:
    """The beam of `softcal demo`, on a coarser mesh and with markers along it."""
    mesh = beam(0.1, 0.03, 0.03, (5, 2, 2), order=2)
    places = {
        "root": (40.0, 5.0, 30.0),
        "mid": (70.0, 25.0, 30.0),
        "end": (100.0, 10.0, 30.0),
        "side": (100.0, 30.0, 10.0),
    }
    pose = lambda name, newtons: Configuration(
        name,
        "x_min",
        loads=[SurfaceForce("x_max", (0.0, 0.0, -newtons))],
        markers=_markers(places, 3e-4),
    )
    return Robot(
        name="silicone beam",
        model=build_model(mesh, NeoHookean(200e3, 0.49), density=1070.0),
        space=ParameterSpace((Parameter("E", "E", 200e3, 50e3, 1e6, unit="Pa"),)),
        nominal={"E": 200e3},
        poses=(pose("gravity", 0.0), pose("load52", 0.51), pose("load101", 1.0)),
        noise="estimated",
        force="loads",
        signed="loads",
    )


def _cable_beam() -> Robot:
    """The ready-made one, with markers too, a thread to one side and three tensions."""
    project = load_project(ready_made_path("cable-beam"))
    pulled = project.calibration[1]
    places = {
        "root": (34.0, 4.0, 20.0),
        "mid": (60.0, 20.0, 6.0),
        "end": (82.0, 0.0, 14.0),
    }
    sensor = tuple(e for e in pulled.effectors if e.name == "sensor")
    poses = tuple(
        replace(
            pulled,
            name=f"{tension:g} N",
            actuation={"cable": ImposedForce(tension)},
            loads=[SurfaceForce("x_max", (0.0, -0.2, 0.0))],
            markers=_markers(places, 1e-4),
            measured=None,
            effectors=sensor,
        )
        for tension in (0.5, 1.0, 2.0)
    )
    assert project.space is not None
    return Robot(
        name="cable beam",
        model=project.model,
        space=project.space,
        nominal={"E": 300e3},
        poses=poses,
        noise="stated",
        force="actuation",
        signed="loads",
    )


def _finger() -> Robot:
    """The ready-made pneumatic finger, of linear tets so that it is quick."""
    source = ready_made_path("pneumatic-finger")
    with TemporaryDirectory() as folder:
        for path in source.parent.iterdir():
            text = path.read_bytes()
            if path == source:
                text = text.replace(b'element = "quadratic"', b'element = "linear"')
            (Path(folder) / path.name).write_bytes(text)
        project = load_project(Path(folder) / source.name)
    places = {
        "root": (12.0, 8.0, 12.0),
        "top": (30.0, 8.0, 12.0),
        "side": (40.0, 16.0, 6.0),
        "edge": (60.0, 16.0, 12.0),
        "tip": (60.0, 8.0, 6.0),
    }
    assert project.space is not None
    return Robot(
        name="pneumatic finger",
        model=project.model,
        space=project.space,
        nominal={"E": 350e3},
        poses=tuple(
            replace(
                with_forces(c, "actuation", 1.5),
                markers=_markers(places, 1e-4),
                measured=None,
            )
            for c in project.calibration
        ),
        noise="stated",
        force="actuation",
        signed="actuation",
    )


def _strip() -> Robot:
    """A printed strip with two moduli, lying and on its side, with weights."""
    problem = problems()[1]
    places = {
        "root": (25.0, 2.0, 15.0),
        "a": (50.0, 15.0, 4.0),
        "b": (75.0, 0.0, 12.0),
        "end": (100.0, 15.0, 15.0),
    }
    markers = _markers(places, 1e-4)
    return Robot(
        name="printed strip",
        model=problem.fitted_model(2),
        space=problem.space,
        nominal=problem.truth,
        poses=tuple(replace(c, markers=markers) for c in problem.poses),
        noise="estimated",
        force="loads",
        signed="loads",
    )


class Case(NamedTuple):
    """Poses as a user states them, and what must be named.

    Attributes:
        poses: The poses with readings.
        kind: Kind of the mistake; empty where there is none.
        words: What must be said of it.
    """

    poses: tuple[Configuration, ...]
    kind: str = ""
    words: tuple[str, ...] = ()


def right(robot: Robot, random: np.random.Generator) -> Case:
    """No mistake."""
    return Case(robot.measured(random))


def _swapped(robot: Robot, random: np.random.Generator, *, everywhere: bool) -> Case:
    """Two markers exchanged."""
    poses = list(robot.measured(random))
    markers = poses[0].markers
    assert markers is not None
    a, b = sorted(random.choice(len(markers.names), 2, replace=False).tolist())
    chosen = int(random.integers(len(poses)))
    order = np.arange(len(markers.names))
    order[[a, b]] = order[[b, a]]
    for c, pose in enumerate(poses):
        if everywhere or c == chosen:
            assert pose.measured is not None
            poses[c] = replace(pose, measured=pose.measured[order])
    where = "all poses" if everywhere else poses[chosen].name
    words = markers.names[a], markers.names[b], where
    return Case(tuple(poses), "swapped markers", words)


def _in_other_frame(pose: Configuration, R: HostArray) -> Configuration:
    """Read a pose in a frame of other axes, about the origin of the mesh."""
    assert pose.measured is not None
    effectors = []
    for sensor in pose.effectors:
        at = np.asarray(sensor.point)  # pyright: ignore
        x, Q = at + sensor.measured.translation, sensor.measured.matrix  # pyright: ignore
        measured = Pose.from_matrix(R @ Q, R @ x - at)
        effectors.append(replace(sensor, measured=measured))  # pyright: ignore
    return replace(pose, measured=pose.measured @ R.T, effectors=tuple(effectors))


def _turned(robot: Robot, random: np.random.Generator, *, angle: int) -> Case:
    """The frame of the recording turned about an axis."""
    axis = "xyz"[int(random.integers(3))]
    R = Rotation.from_euler(axis, angle, degrees=True).as_matrix().round()
    poses = tuple(_in_other_frame(p, R) for p in robot.measured(random))
    back = 180 if angle == 180 else -angle
    return Case(poses, "turned frame", (f"by {back} degrees about {axis}",))


def _mirrored(robot: Robot, random: np.random.Generator) -> Case:
    """The frame of the recording mirrored; a sensor has no such readings."""
    axis = int(random.integers(3))
    R = np.eye(3)
    R[axis, axis] = -1.0
    poses = [replace(p, effectors=()) for p in robot.measured(random)]
    poses = tuple(_in_other_frame(p, R) for p in poses)
    return Case(poses, "mirrored frame", (f"in {'xyz'[axis]}",))


def _gravity(robot: Robot, random: np.random.Generator) -> Case:
    """Gravity stated upwards."""
    up = lambda c: tuple((-np.array(c.gravity)).tolist())
    poses = tuple(replace(c, gravity=up(c)) for c in robot.measured(random))
    return Case(poses, "wrong sign", ("gravity",))


def _reversed(robot: Robot, random: np.random.Generator) -> Case:
    """Loads or actuation stated in the wrong direction, in all poses."""
    poses = tuple(with_forces(c, robot.signed, -1.0) for c in robot.measured(random))
    return Case(poses, "wrong sign", (robot.signed,))


def _force_factor(robot: Robot, random: np.random.Generator) -> Case:
    """Too small: forces that are too large have no equilibrium to begin with."""
    pressure = robot.name == "pneumatic finger"
    factors = [6.895, 10.0, 1000.0] if pressure else [4.448, 9.81, 1000.0]
    factor = float(random.choice(factors))
    read = robot.measured(random)
    poses = tuple(with_forces(c, robot.force, 1.0 / factor) for c in read)
    return Case(poses, "wrong factor", (robot.force, f"by {factor:g}"))


def _lengths(robot: Robot, random: np.random.Generator) -> Case:
    """Readings of markers in another unit; a sensor has its own."""
    factor = float(random.choice([0.1, 1.0 / 25.4, 10.0, 25.4]))
    poses = []
    for c in robot.measured(random):
        assert c.measured is not None
        poses.append(replace(c, measured=factor * c.measured, effectors=()))
    words = "positions", f"by {max(factor, 1.0 / factor):g}"
    return Case(tuple(poses), "wrong factor", words)


def _lost(robot: Robot, random: np.random.Generator) -> Case:
    """A marker of one pose at (0, 0, 0)."""
    poses = list(robot.measured(random))
    c = int(random.integers(len(poses)))
    markers, measured = poses[c].markers, poses[c].measured
    assert markers is not None
    assert measured is not None
    k = int(random.integers(len(markers.names)))
    measured = measured.copy()
    measured[k] = 0.0
    poses[c] = replace(poses[c], measured=measured)
    return Case(tuple(poses), "lost marker", (markers.names[k], poses[c].name))


def _exchanged(robot: Robot, random: np.random.Generator) -> Case:
    """Two poses with each other's readings."""
    poses = list(robot.measured(random))
    a, b = sorted(random.choice(len(poses), 2, replace=False).tolist())
    first, second = poses[a], poses[b]
    poses[a] = replace(first, measured=second.measured, effectors=second.effectors)
    poses[b] = replace(second, measured=first.measured, effectors=first.effectors)
    return Case(tuple(poses), "swapped poses", (first.name, second.name))


def _clamped(robot: Robot, random: np.random.Generator) -> Case:
    """A clamp that really reaches up to the first marker."""
    markers = robot.poses[0].markers
    assert markers is not None
    reach = float(markers.positions[markers.names.index(robot.marker), 0])
    held = Support(np.flatnonzero(robot.model.mesh.points[:, 0] <= reach))
    real = tuple(replace(c, supports=(held,)) for c in robot.poses)
    return Case(robot.measured(random, real), "longer clamp", (robot.marker,))


def _other_face(robot: Robot, random: np.random.Generator) -> Case:
    """Another face is said to be held."""
    faces, rigid = box_faces(robot.model.mesh), robot.model.mechanism.bodies.attached
    del faces["the face of least x"]
    others = [np.setdiff1d(nodes, rigid) for nodes in faces.values()]
    others = [nodes for nodes in others if nodes.size]
    held = Support(others[int(random.integers(len(others)))])
    poses = tuple(replace(c, supports=(held,)) for c in robot.measured(random))
    return Case(poses, "wrong clamp", ("least x",))


def _misplaced(robot: Robot, random: np.random.Generator) -> Case:
    """A marker that stands 5 mm from its place."""
    poses = robot.measured(random)
    markers = poses[0].markers
    assert markers is not None
    k, shift = int(random.integers(len(markers.names))), random.standard_normal(3)
    off = np.zeros((len(markers.names), 3))
    off[k] = 5e-3 * shift / np.linalg.norm(shift)
    moved = [replace(c, measured=c.measured + off) for c in poses]  # pyright: ignore
    return Case(tuple(moved), "misplaced marker", (markers.names[k],))


def _taken(robot: Robot, random: np.random.Generator) -> Case:
    """Places at rest that were read in the first pose, under its loads."""
    poses = robot.measured(random)
    first = poses[0]
    assert first.markers is not None
    assert first.measured is not None
    far = np.full(len(first.markers.names), 0.05)
    markers = replace(first.markers, positions=first.measured, max_distance=far.max())
    poses = tuple(replace(c, markers=markers) for c in poses)
    return Case(poses, "", ("at rest",))


def _unloaded(robot: Robot, random: np.random.Generator) -> Case:
    """Gravity upwards in the one pose that has nothing else."""
    bare = [replace(c, loads=(), actuation={}, effectors=()) for c in robot.poses[:1]]
    alone = robot._replace(poses=tuple(bare))
    (pose,) = alone.measured(random)
    up = tuple((-np.array(pose.gravity)).tolist())
    return Case((replace(pose, gravity=up),), "", ("against gravity",))


def _sized(robot: Robot, random: np.random.Generator) -> Case:
    """Forces ten thousand times too small, or too large, but not for the reader."""
    factor = float(random.choice([1e-4, 1e2]))
    poses = tuple(with_forces(c, robot.force, factor) for c in robot.measured(random))
    return Case(poses, "", ("times what the body resists",))


Plant = Callable[[Robot, np.random.Generator], Case]

MISTAKES: Mapping[str, Plant] = {
    "markers swapped in all poses": lambda *a: _swapped(*a, everywhere=True),
    "markers swapped in one pose": lambda *a: _swapped(*a, everywhere=False),
    "frame turned by 90 degrees": lambda *a: _turned(*a, angle=90),
    "frame turned by 180 degrees": lambda *a: _turned(*a, angle=180),
    "frame mirrored": _mirrored,
    "gravity of the wrong sign": _gravity,
    "forces of the wrong sign": _reversed,
    "forces off by a factor": _force_factor,
    "lengths off by a factor": _lengths,
    "marker lost": _lost,
    "poses exchanged": _exchanged,
    "longer clamp": _clamped,
    "other face held": _other_face,
    "marker misplaced": _misplaced,
}
"""The kinds that a fit can tell, by name."""

CHECKED: Mapping[str, Plant] = {
    "other face held": lambda *a: _other_face(*a)._replace(words=(".supports",)),
    "places at rest read in a loaded pose": _taken,
    "gravity upwards": _unloaded,
    "forces beyond the body": _sized,
}
"""The kinds that `softcal check` tells, by name."""
