"""Four small problems, and models of them with one thing really wrong."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Literal, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from benchmarks.paper_table1 import all_markers
from softcal_jax._typing import HostArray
from softcal_jax.actuators import Cable, Guide
from softcal_jax.bodies import RigidBody, rotation_matrix
from softcal_jax.configurations import (
    BodyFrame,
    Configuration,
    ImposedForce,
    Markers,
    SurfaceForce,
)
from softcal_jax.equilibrium import Model, build_model
from softcal_jax.fields import Parameter, ParameterSpace, Uncertain
from softcal_jax.materials import (
    Corotational,
    Fibre,
    Isotropic,
    ReducedTransverseIsotropic,
)
from softcal_jax.mesh import TetMesh, beam
from softcal_jax.robots import synthetic_measurements
from softcal_jax.robots._ready_made import MASS, NU, SIZE

WIDTHS = Uncertain()
"""The budget that errors are counted in."""

STD = 1e-4
"""Standard deviation of markers and sensors [m]."""

STD_ANGLE = 2e-3
"""Standard deviation of the orientation of a sensor [rad]."""

DOWN = (0.0, 0.0, -9.81)
"""Gravity in the frame of a beam that lies [m/s2]."""

Order = Literal[1, 2]


class Wrong(NamedTuple):
    """How far a real robot is from what is known of it, in widths of the budget.

    Attributes:
        nu: Error of Poisson's ratio.
        density: Error of the density.
        clamp: How much further out than known every clamp really grips.
        tilt: Tilt of gravity, half along the beam and half across.
        loads: Error of weights and forces.
    """

    nu: float = 0.0
    density: float = 0.0
    clamp: float = 0.0
    tilt: float = 0.0
    loads: float = 0.0


class Problem(NamedTuple):
    """A calibration: a box-shaped body, what is unknown, and its poses.

    Attributes:
        title: What it is called.
        size: Length, width and height [m].
        cells: Cells along, across and up.
        model: The body of a mesh, Poisson's ratio and a relative density.
        nu: Poisson's ratio [-].
        space: What is calibrated.
        truth: True values, in SI units.
        poses: Configurations, without measurements.
    """

    title: str
    size: tuple[float, float, float]
    cells: tuple[int, int, int]
    model: Callable[[TetMesh, float, float], Model]
    nu: float
    space: ParameterSpace
    truth: Mapping[str, float]
    poses: tuple[Configuration, ...]

    def fitted_model(self, order: Order) -> Model:
        """The model as it is known, on linear or quadratic tets."""
        return self.model(beam(*self.size, self.cells, order=order), self.nu, 1.0)

    def measured(self, wrong: Wrong, seed: int | None) -> tuple[Configuration, ...]:
        """What a robot with errors would be measured at, with a draw of noise.

        Args:
            wrong: Its errors.
            seed: Seed of the noise; None for none.

        Returns:
            The poses as they are known, with the measured values of the real ones.
        """
        real = [_really(c, wrong) for c in self.poses]
        seen = {}
        for held in dict.fromkeys(_held(c) for c in self.poses):
            model = self._real_model(wrong, held)
            # All of them, so that one program serves every clamp.
            simulated = synthetic_measurements(
                model,
                self.space,
                real,
                self.truth,
                noise=seed is not None,
                seed=seed or 0,
            )
            seen |= {c.name: c for c in simulated if _held(c) == held}
        return tuple(
            replace(c, measured=seen[c.name].measured, effectors=seen[c.name].effectors)
            for c in self.poses
        )

    def _real_model(self, wrong: Wrong, held: str) -> Model:
        """The body of a robot with errors, on quadratic tets."""
        mesh = beam(*self.size, self.cells, order=2)
        longer = WIDTHS.clamp * wrong.clamp
        points = np.array(mesh.points)
        length = self.size[0]
        points[:, 0] *= 1.0 + longer / length
        if held == "x_min":
            points[:, 0] -= longer
        mesh = eqx.tree_at(lambda m: m.points, mesh, points)
        nu = self.nu + WIDTHS.nu * wrong.nu
        return self.model(mesh, nu, 1.0 + WIDTHS.density * wrong.density)


def _held(c: Configuration) -> str:
    return c.supports[0].name


def _really(c: Configuration, wrong: Wrong) -> Configuration:
    """A pose with its gravity and its forces as they really are."""
    factor = 1.0 + WIDTHS.loads * wrong.loads
    loads = []
    for load in c.loads:
        assert isinstance(load, SurfaceForce)
        loads.append(SurfaceForce(load.where, tuple(factor * np.array(load.force))))
    forces = {}
    for name, force in c.actuation.items():
        assert isinstance(force, ImposedForce)
        forces[name] = ImposedForce(factor * force.value)
    gravity = _tilted(np.array(c.gravity), WIDTHS.gravity * wrong.tilt)
    return replace(c, gravity=tuple(gravity), loads=loads, actuation=forces)


def _tilted(gravity: HostArray, angle: float) -> HostArray:
    """Gravity turned by an angle [rad], half along the beam and half across."""
    along = np.array([1.0, 0.0, 0.0])
    across = np.cross(gravity, along) / np.linalg.norm(gravity)
    axis = (along + across) / np.sqrt(2.0)
    return np.asarray(rotation_matrix(jnp.asarray(angle * axis))) @ gravity


def problems() -> tuple[Problem, ...]:
    """One modulus; two; the six of the paper's beam; a cable beam with a sensor."""
    return (_one_modulus(), _two_moduli(), _paper(), _cable_beam())


def _one_modulus() -> Problem:
    """A lying beam of one material, by itself and with a weight."""

    def model(mesh: TetMesh, nu: float, density: float) -> Model:
        law = Corotational(Isotropic(300e3, nu))
        return build_model(mesh, law, density=1000.0 * density)

    size = (0.10, 0.015, 0.015)
    markers = _markers(size, (0.4, 0.7, 1.0))
    poses = (_pose("alone", DOWN, markers), _pose("loaded", DOWN, markers, 0.05))
    return _of_one_modulus("one modulus", size, model, poses)


def _of_one_modulus(
    title: str,
    size: tuple[float, float, float],
    model: Callable[[TetMesh, float, float], Model],
    poses: tuple[Configuration, ...],
) -> Problem:
    """A problem of an isotropic beam of which E is unknown."""
    E = Parameter("E", "E", 200e3, 50e3, 2e6, unit="Pa")
    return Problem(
        title=title,
        size=size,
        cells=(4, 1, 1),
        model=model,
        nu=0.3,
        space=ParameterSpace((E,)),
        truth={"E": 300e3},
        poses=poses,
    )


def _two_moduli() -> Problem:
    """A printed beam with its fibre at 30 degrees, on its sides and with weights."""

    def model(mesh: TetMesh, nu: float, density: float) -> Model:
        fibre = Fibre(np.deg2rad(30.0), plane="xy")
        law = Corotational(ReducedTransverseIsotropic(500e3, 250e3, nu, fibre))
        return build_model(mesh, law, density=1000.0 * density)

    size = (0.10, 0.015, 0.015)
    markers = _markers(size, (0.4, 0.7, 1.0))
    side = (0.0, -9.81, 0.0)
    start, low, high = 400e3, 50e3, 2e6
    moduli = [Parameter(f, f, start, low, high, unit="Pa") for f in ("E_t", "E_l")]
    return Problem(
        title="two moduli",
        size=size,
        cells=(4, 1, 1),
        model=model,
        nu=0.3,
        space=ParameterSpace(moduli),
        truth={"E_t": 500e3, "E_l": 250e3},
        poses=(
            _pose("lying", DOWN, markers),
            _pose("on its side", side, markers),
            _pose("lying, loaded", DOWN, markers, 0.05),
            _pose("on its side, loaded", side, markers, 0.05),
        ),
    )


def _paper() -> Problem:
    """The six parameters of Sec. V, with a weight of 5 g in two of its six poses."""
    cells = (6, 1, 1)
    known, poses = all_markers(cells, "xy")

    def model(mesh: TetMesh, nu: float, density: float) -> Model:
        fibre = Fibre(0.0, plane="xy")
        law = Corotational(ReducedTransverseIsotropic(700e3, 400e3, nu, fibre))
        return build_model(mesh, law, density=MASS / np.prod(SIZE) * density)

    # No weight is a load of zero: its arrays are those of the other poses.
    loaded = [
        replace(c, loads=[_weight(c, 0.05 if c.name in ("pose 2", "pose 5") else 0.0)])
        for c in poses
    ]
    return Problem(
        title="six of the paper's beam",
        size=SIZE,
        cells=cells,
        model=model,
        nu=NU,
        space=known.space,
        truth=known.target,
        poses=tuple(loaded),
    )


def _cable_beam() -> Problem:
    """A lying beam that a cable bends, with a plate and a 6-D sensor on its end."""
    length, width, height = size = (0.10, 0.02, 0.02)
    centre = 0.5 * width

    def model(mesh: TetMesh, nu: float, density: float) -> Model:
        # Inside a tet, whose nodes are then the same where the clamp is not as known.
        guides = [
            Guide((0.0, centre, height + 0.005), "ground"),
            (0.6 * length, centre, height),
            Guide((length, centre, height), "plate"),
        ]
        return build_model(
            mesh,
            Corotational(Isotropic(300e3, nu)),
            density=1000.0 * density,
            bodies=[RigidBody("plate", "x_max", mass=0.01)],
            actuators=[Cable("cable", guides)],
        )

    sensor = BodyFrame("sensor", "plate", std=STD, std_angle=STD_ANGLE)
    poses = tuple(
        Configuration(
            f"{force:g} N",
            "x_min",
            gravity=DOWN,
            actuation={"cable": ImposedForce(force)},
            effectors=[sensor],
        )
        for force in (0.5, 1.0, 2.0)
    )
    return _of_one_modulus("cable beam with a 6-D sensor", size, model, poses)


def _markers(size: Sequence[float], along: Sequence[float]) -> Markers:
    """Markers on the bottom midline of a beam."""
    names = [f"at {100 * s:g} %" for s in along]
    return Markers(names, [(s * size[0], 0.5 * size[1], 0.0) for s in along], STD)


def _pose(
    name: str,
    gravity: tuple[float, float, float],
    markers: Markers,
    weight: float = 0.0,
) -> Configuration:
    pose = Configuration(name, "x_min", gravity=gravity, markers=markers)
    return replace(pose, loads=[_weight(pose, weight)])


def _weight(c: Configuration, newtons: float) -> SurfaceForce:
    """A weight on the free end of a pose."""
    free = "x_max" if _held(c) == "x_min" else "x_min"
    down = np.array(c.gravity) / np.linalg.norm(c.gravity)
    return SurfaceForce(free, tuple(newtons * down))
