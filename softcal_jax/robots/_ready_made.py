"""Robots that come with the package, and readings that a known robot would give."""

from collections.abc import Callable, Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax import equilibrium
from softcal_jax._module import Module
from softcal_jax._text import check_known
from softcal_jax.configurations import (
    Configuration,
    ConfigurationArrays,
    Markers,
    configuration_lanes,
)
from softcal_jax.equilibrium import Model, build_model
from softcal_jax.fields import ControlPointParameters, ControlPoints, ParameterSpace
from softcal_jax.materials import Corotational, Fibre, ReducedTransverseIsotropic
from softcal_jax.mesh import beam


def synthetic_measurements(
    model: equilibrium.Model,
    space: ParameterSpace,
    configurations: Sequence[Configuration],
    values: Mapping[str, float],
    *,
    noise: bool = False,
    seed: int = 0,
    newton: equilibrium.NewtonSettings | None = None,
) -> tuple[Configuration, ...]:
    """Return configurations with the measurements that known parameters would give.

    `values` has one for every parameter of the `space`, by name, in SI units. Other
    arguments and errors are those of `simulated_measurements`.

    Raises:
        ValueError: If a value is missing or unknown.
    """
    unknown = sorted(set(values) ^ set(space.names))
    if unknown:
        raise ValueError(
            f"values must name every parameter once; {unknown[0]!r} is "
            f"{'not given' if unknown[0] in space.names else 'no parameter'}. "
            f"Parameters: {', '.join(space.names)}."
        )
    z = space.to_scaled(jnp.asarray([values[name] for name in space.names]))
    return simulated_measurements(
        space.model_at(model, z),
        configurations,
        noise=noise,
        seed=seed,
        newton=newton,
        change=lambda c: space.apply(model, c, z)[1],
    )


def simulated_measurements(
    model: equilibrium.Model,
    configurations: Sequence[Configuration],
    *,
    noise: bool = False,
    seed: int = 0,
    newton: equilibrium.NewtonSettings | None = None,
    first: equilibrium.Model | None = None,
    change: Callable[[ConfigurationArrays], ConfigurationArrays] | None = None,
) -> tuple[Configuration, ...]:
    """Return configurations with the measurements that a given model would give.

    Args:
        model: The model that stands for the real robot.
        configurations: Poses with effectors; measured values are replaced.
        noise: Whether to add Gaussian noise with the stated standard deviations.
        seed: Seed of the noise.
        newton: Settings of the equilibrium.
        first: A model of the same mesh and mechanism whose equilibria are easier to
            find and lie near: its states are the guesses.
        change: Changes each configuration when it is measured, like an offset of the
            recording; nothing by default.

    Raises:
        ValueError: If a configuration has no effectors.
        RuntimeError: If a configuration has no equilibrium.
    """
    mesh, mechanism = model.mesh, model.mechanism
    posed = [c.measured_at_rest(mesh, mechanism) for c in configurations]
    arrays, records = configuration_lanes(mesh, posed, mechanism)
    arrays = arrays if change is None else jax.vmap(change)(arrays)
    newton = newton or equilibrium.NewtonSettings()

    guess = None
    if first is not None:
        with equilibrium.Workers(first, len(configurations)) as workers:
            guess = equilibrium.equilibria(workers, first, arrays, newton).displacement
    with equilibrium.Workers(model, len(configurations)) as workers:
        solution = equilibrium.equilibria(workers, model, arrays, newton, guess=guess)
        effectors = equilibrium.effectors_on_all_cores(workers, model, arrays, solution)
    equilibrium.check_converged(solution, tuple(c.name for c in configurations))
    random = np.random.default_rng(seed)
    effectors, weights = np.asarray(effectors), np.asarray(arrays.effectors.inverse_std)
    measured = []
    for lane, (c, of_pose) in enumerate(zip(configurations, records, strict=True)):
        rows = [record.index for record in of_pose]
        e, weight = effectors[lane, rows], weights[lane, rows]
        if noise:
            std = np.where(weight > 0.0, 1.0 / np.maximum(weight, 1e-300), 0)
            e = e + std * random.standard_normal(e.shape)
        measured.append(c.measured_as(e, mesh, mechanism))
    return tuple(measured)


READY_MADE = {
    "beam": "silicone_beam",
    "cable-beam": "cable_beam",
    "pneumatic-finger": "pneumatic_finger",
    "pneumatic-arm": "pneumatic_arm",
    "parallel-robot": "parallel_robot",
    "tentacle": "soft_tentacle",
    "emio": "emio",
    "pressed-pad": "pressed_pad",
    "bellows-finger": "bellows_finger",
}
"""Folders of this package, by the names of the robots that users type."""

SIZE = (0.150, 0.015, 0.015)
"""Length, width and height, from the authors' published scene [m]."""

MASS = 0.032  # mass [kg], ours
GRAVITY = 9.81  # acceleration of gravity [m/s2]
NU = 0.3  # Poisson's ratio of the reduced law [-]

POSES = {
    1: (0.0, "x_min"),
    2: (45.0, "x_min"),
    3: (90.0, "x_min"),
    4: (0.0, "x_max"),
    5: (45.0, "x_max"),
    6: (90.0, "x_max"),
}
"""Configurations of Fig. 2: turn about the long axis [degrees], and the held end."""

START = {"E_t": 700e3, "E_l": 400e3, "theta": 0.0}
"""Start of the runs of Fig. 3 at both control points [Pa, rad]."""

TARGET = {
    "E_t of CP 1": 900e3,
    "E_t of CP 2": 600e3,
    "E_l of CP 1": 300e3,
    "E_l of CP 2": 200e3,
    "theta of CP 1": float(np.deg2rad(20.0)),
    "theta of CP 2": float(np.deg2rad(-35.0)),
}
"""p_target, the values behind the synthetic measurements [Pa, rad]."""


def ready_made_path(name: str) -> Path:
    """Return the project file of a ready-made robot, by its name in `READY_MADE`.

    The readings of "beam", "pneumatic-arm", "tentacle" and "emio" were measured, those
    of the others computed; README.md beside each says how. The recordings of
    "pneumatic-arm" need ezc3d: pip install 'softcal-jax[mocap]'.

    Raises:
        ValueError: If there is no such robot; the text suggests the closest name.
    """
    check_known("robot", READY_MADE, name)
    return Path(str(files("softcal_jax.robots"))) / READY_MADE[name] / "project.toml"


class AnisotropicBeam(Module):
    """A calibration problem of Sec. V, to be measured by `synthetic_measurements`.

    Attributes:
        model: The beam.
        space: Its parameters {E_t, E_l, theta} at two control points.
        configurations: The poses, with effectors but without measurements.
        target: Values of the parameters for synthetic measurements.
    """

    model: Model
    space: ParameterSpace
    configurations: tuple[Configuration, ...]
    target: dict[str, float]


def anisotropic_beam(
    *,
    cells: tuple[int, int, int] = (10, 2, 2),
    order: Literal[1, 2] = 2,
    plane: Literal["xz", "xy"] = "xz",
    poses: Sequence[int] = (1, 2, 3, 4),
    n_effectors: Literal[1, 4] = 1,
    std: float = 1e-4,
    interpolation: Literal["linear", "director"] = "director",
    scaling: Literal["log", "linear", "paper"] = "log",
    start: dict[str, float] | None = None,
    ordered: bool = True,
    tensor_steps: bool = True,
) -> AnisotropicBeam:
    """Build the cantilever of Sec. V-A, Fig. 2: 150 x 15 x 15 mm under its own weight.

    Size and step scaling are those of the authors' published scene; mass, Poisson's
    ratio, control points (centres of the end faces) and target are ours, since the
    paper gives none.

    Args:
        cells: Cells along, up and across; 6 tets each.
        order: 2 for quadratic tets; 1 for linear ones, which lock in bending.
        plane: Print plane that theta turns in: "xz" lies flat at rest, "xy" upright.
        poses: Numbers of the configurations, 1 to 6; see `POSES`.
        n_effectors: 1: the centre of the free end face; 4: the points of the published
            scene on the bottom midline.
        std: Standard deviation of the effectors [m].
        interpolation: How theta is mixed between control points; the paper's is linear.
        scaling: "log" steps in ratios of moduli; "paper" steps by S = (1 MPa, 1 MPa,
            1 rad) with the step limits of the scene, 1 % of S and 0.005 rad.
        start: Values at both control points before calibration; `START` by default.
        tensor_steps: Whether steps of {E_t, E_l, theta} are taken as tensors (`axes` of
            `ParameterSpace`); needs the director and the log scale.
        ordered: Whether E_l <= E_t is a constraint of the QP.

    Raises:
        ValueError: If a pose or the number of effectors is unknown.
    """
    length, width, height = SIZE
    mesh = beam(length, width, height, cells, order=order)
    law = Corotational(
        ReducedTransverseIsotropic(700e3, 400e3, NU, Fibre(0.0, plane=plane))
    )
    density = MASS / (length * width * height)
    model = build_model(mesh, law, density=density)
    centre = (width / 2, height / 2)
    points = ControlPoints([(0.0, *centre), (length, *centre)])
    start, paper = start or START, scaling == "paper"
    moduli = [
        ControlPointParameters(
            field,
            points,
            start=start[field],
            lower=50e3,
            upper=1e6,
            unit="Pa",
            scale="log" if scaling == "log" else "linear",
            S=None if scaling == "log" else 1e6,
            max_step=0.01 if paper else None,
        )
        for field in ("E_t", "E_l")
    ]
    theta = ControlPointParameters(
        "theta",
        points,
        start=start["theta"],
        lower=-np.pi / 2,
        upper=np.pi / 2,
        unit="rad",
        scale="linear",
        S=1.0,
        interpolation=interpolation,
        max_step=0.005 if paper else None,
    )
    space = ParameterSpace(
        (*moduli, theta),
        order=[("E_l", "E_t")] if ordered and not tensor_steps else (),
        axes=[("E_l", "E_t", "theta")] if tensor_steps else (),
    )
    configurations = tuple(_pose(number, n_effectors, std) for number in poses)
    return AnisotropicBeam(model, space, configurations, dict(TARGET))


def _pose(number: int, n_effectors: int, std: float) -> Configuration:
    if number not in POSES:
        raise ValueError(
            f"pose must be one of {', '.join(map(str, POSES))}, got {number}."
        )
    turn, held = POSES[number]
    # The beam turns, gravity stays: in the frame of the mesh it is gravity that turns.
    angle = np.deg2rad(turn)
    gravity = (0.0, -GRAVITY * float(np.cos(angle)), GRAVITY * float(np.sin(angle)))
    length, width, height = SIZE
    if n_effectors == 1:
        free = length if held == "x_min" else 0.0
        places = {"tip": (free, width / 2, height / 2)}
    elif n_effectors == 4:
        along = (0.0525, 0.0675, 0.0825, 0.0975)
        places = {f"x {1e3 * x:g} mm": (x, 0.0, height / 2) for x in along}
    else:
        raise ValueError(f"n_effectors must be 1 or 4, got {n_effectors}.")
    markers = Markers([*places], [*places.values()], std)
    return Configuration(f"pose {number}", held, gravity=gravity, markers=markers)
