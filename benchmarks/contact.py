"""Contact with obstacles: against closed forms, and a press test as a measurement.

- `hertz`, `punch`: a sphere, and a flat punch with a rounded edge, pressed into a
  half-space; a quarter of it on graded meshes of quadratic tets. Forces by Sneddon
  (Int. J. Engng Sci. 3, 1965), which for the sphere is Hertz's F = 4/3 E* R^0.5 d^1.5.
- `press`: a finger of two halves of silicone, glued down along its length, is pressed
  by a probe with a force sensor at six places, with 1 % of noise, and both moduli are
  found from the forces alone.
- `friction`: a block on a slope, which friction holds up to the angle atan mu;
  and a belt over a quarter of a drum, pulled at both ends, which holds up to the ratio
  exp(mu pi / 2) of Euler and Eytelwein, for a belt whose middle runs beside the drum.
- `drops`: a ball moves onto a thin clamped plate from a random place above it, in a
  random direction, to up to 30 times the thickness of the plate below it.

Figures:

- `hertz_error_percent`, `punch_error_percent`: of the force, on the finest mesh; and
  `hertz_order`, the order at which the error falls.
- `balance`: forces and moments on the pressed finger that are left, over the force.
- `penetration_over_scale`: how deep the surface lies in the probe at most.
- `press_test_recovers_percent`: the largest error of a modulus, over all draws; and
  `press_test_covered`, the share of 95 % intervals that hold the truth [%].
- `newton_iterations_over_free`: of a press, over those of the same finger under the
  same force without contact; the median over the six.
- `slope_off_degrees`, `belt_off_percent`: where it begins to slide, by bisection; and
  `slope_force_error`: of shear and pressure on the block, just before, over its weight.
- `iteration_over_smooth`: time of a Newton iteration of a press with friction, over one
  without; the median over the six.
- `passages`: drops whose equilibrium has the ball on the other side of the plate;
  `drops_solved` of them have an equilibrium.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from scipy.integrate import quad
from scipy.optimize import brentq

from benchmarks._problem import Goal, Options, Outcome, Table
from benchmarks._timing import interleave, median_ms
from softcal_jax._typing import Float, HostArray
from softcal_jax.bodies import BodyState, Pose, RigidBody
from softcal_jax.calibration import calibrate
from softcal_jax.configurations import (
    Configuration,
    ContactForce,
    PointForce,
    Support,
    SurfaceForce,
    configuration_arrays,
)
from softcal_jax.contact import (
    Ball,
    Capsule,
    ContactState,
    HalfSpace,
    RoundedCylinder,
)
from softcal_jax.equilibrium import (
    EquilibriumSolution,
    Model,
    NewtonSettings,
    build_model,
    gravity_load,
    residual,
    robot_states,
    solve_equilibrium,
)
from softcal_jax.fields import Parameter, ParameterSpace, exactly_known
from softcal_jax.materials import Corotational, Isotropic, NeoHookean
from softcal_jax.mesh import beam, to_quadratic
from softcal_jax.robots import synthetic_measurements

GOALS = {
    "hertz_error_percent": Goal("at most", 2.0),
    "balance": Goal("at most", 1e-8),
    "penetration_over_scale": Goal("at most", 1.0),
    "press_test_recovers_percent": Goal("at most", 5.0),
    "newton_iterations_over_free": Goal("at most", 2.5),
    "slope_off_degrees": Goal("at most", 0.1),
    "slope_force_error": Goal("at most", 1e-3),
    "belt_off_percent": Goal("at most", 2.0),
    "iteration_over_smooth": Goal("at most", 1.3),
    "passages": Goal("at most", 0),
}

COUNTS = {"hertz": 3, "punch": 1, "press": 5, "friction": 7, "drops": 200}

E, NU = 1e5, 0.3
NO_WEIGHT = (0.0, 0.0, 0.0)


def run(options: Options) -> Outcome:
    """Run the parts that are asked for.

    `hertz=n` takes the first n meshes, `press=n` draws of noise, `friction=n` halvings
    of the bracket, `drops=n` drops.
    """
    counts = options.counts or COUNTS
    figures, samples, tables = {}, {}, []
    if n := counts.get("hertz"):
        options.say("a sphere on a half-space")
        errors = [_indentation(_sphere(), cells, s) for cells, s in MESHES[:n]]
        samples["hertz_error_percent"] = errors
        figures["hertz_error_percent"] = abs(errors[-1])
        if n > 1:
            sizes = np.log([1.0 / cells for cells, _ in MESHES[:n]])
            slope = np.polyfit(sizes, np.log(np.abs(errors)), 1)[0]
            figures["hertz_order"] = float(slope)
        rows = [
            [str(c), f"{error:+.2f}"]
            for (c, _), error in zip(MESHES, errors, strict=False)
        ]
        tables.append(Table("Hertz: error of the force [%]", ["cells", "error"], rows))
    if counts.get("punch"):
        options.say("a punch with a rounded edge")
        figures["punch_error_percent"] = abs(_indentation(_punch(), *MESHES[-1]))
    if n := counts.get("press"):
        options.say("press tests of a finger")
        figures |= _press_tests(n)
    if n := counts.get("friction"):
        options.say("a block on a slope, a belt over a drum, and what friction costs")
        figures |= _slope(n) | _belt(n) | _cost()
    if n := counts.get("drops"):
        options.say("balls that drop onto a plate")
        figures |= _drops(n)
    goals = {name: goal for name, goal in GOALS.items() if name in figures}
    return Outcome(figures, samples, goals, tables)


# A quarter of the half-space, FAR times as large as the contact, and its refinement
# towards the contact.
FAR, GRADED = 60.0, 5.2

MESHES = [(6, 1.6e-2), (8, 8e-3), (14, 4e-3)]
"""Cells along each axis, and the scale of contact over the depth of the indenter."""


class _Indenter:
    """A body of revolution with the profile f(r), pressed in by a depth [m]."""

    def __init__(self, shape, height, slope, radius, depth):
        self.shape, self.height, self.depth, self.radius = shape, height, depth, radius
        self.slope = slope

    def force(self) -> float:
        """Force on the half-space: F = 2 E* int_0^a r^2 f'(r) / sqrt(a^2 - r^2) dr."""
        a = self.radius
        on_arc = lambda t: (a * np.sin(t)) ** 2 * self.slope(a * np.sin(t))
        return 2.0 * E / (1.0 - NU**2) * quad(on_arc, 0.0, 0.5 * np.pi)[0]


def _indenter(shape, height, slope, depth, most) -> _Indenter:
    """Find the radius of the contact: depth = a int_0^a f'(r) / sqrt(a^2 - r^2) dr."""

    def too_deep(a):
        return a * quad(lambda t: slope(a * np.sin(t)), 0.0, 0.5 * np.pi)[0] - depth

    return _Indenter(shape, height, slope, brentq(too_deep, 1e-9, most), depth)


def _sphere() -> _Indenter:
    """A sphere as Hertz has it: a paraboloid near the contact."""
    R = 5e-3
    return _indenter(Ball(R), R, lambda r: r / R, 0.01 * R, 0.5 * R)


def _punch() -> _Indenter:
    """A flat punch, whose edge is a quarter of a circle."""
    R, rounding = 1e-3, 0.5e-3
    shape = RoundedCylinder(R, 4e-3, rounding)

    def slope(r):
        out = max(0.0, r - (R - rounding))
        return out / np.sqrt(rounding**2 - out**2)

    return _indenter(shape, 2e-3, slope, 0.05e-3, 0.95 * R)


def _indentation(indenter: _Indenter, cells: int, scale: float) -> float:
    """Error of the force of an indenter [%]."""
    side = FAR * indenter.radius
    mesh = beam(side, side, side, (cells, cells, cells))
    graded = lambda t: side * np.sinh(GRADED * t / side) / np.sinh(GRADED)
    x, y, z = mesh.points.T
    points = np.stack([graded(x), graded(y), side - graded(side - z)], axis=1)
    mesh = to_quadratic(replace(mesh, points=points))
    place = (0.0, 0.0, side + indenter.height)
    model = build_model(
        mesh,
        Corotational(Isotropic(E, NU)),
        density=0.0,
        bodies=[RigidBody("indenter", shape=indenter.shape, origin=place)],
        contact_scale=scale * indenter.depth,
    )
    sides = [Support("x_max", "x"), Support("y_max", "y"), Support("z_min", "z")]
    pose = Configuration(
        "pressed",
        [Support("x_min", "x"), Support("y_min", "y"), *sides],
        gravity=NO_WEIGHT,
        bodies={"indenter": Pose((0.0, 0.0, -indenter.depth))},
    )
    (contact,) = _contacts(model, pose, solve_equilibrium(model, pose))
    return 100.0 * float(4.0 * contact.force[2] / indenter.force() - 1.0)


def _contacts(
    model: Model, pose: Configuration, solution: EquilibriumSolution
) -> tuple[ContactState, ...]:
    """What each obstacle feels; the equilibrium must exist."""
    batch = jax.tree.map(lambda leaf: leaf[None], solution)
    (state,) = robot_states(model, [pose], batch)
    if state is None:
        raise RuntimeError(f"{pose.name} has no equilibrium.")
    return state.contacts


FINGER = (0.06, 0.012, 0.012)
TRUTH = {"E_root": 1.2e5, "E_tip": 2.5e5}
PRECISE = NewtonSettings(rtol=1e-10)
PROBE = 6e-3
"""Radius of the probe [m]."""

PLACES = [(0.01, -0.5e-3), (0.016, -0.7e-3), (0.022, -0.9e-3)]
PLACES += [(0.038, -0.3e-3), (0.044, -0.45e-3), (0.05, -0.6e-3)]
"""Where the finger is pressed along its length, and how far [m]."""


def _finger(friction: float = 0.0) -> Model:
    """A finger of two halves, and a probe above it."""
    mesh = beam(*FINGER, (10, 2, 2), order=2)
    middle = mesh.points[mesh.tets[:, :4]].mean(axis=1)[:, 0]
    root = middle < 0.5 * FINGER[0]
    halves = {"root": np.flatnonzero(root), "tip": np.flatnonzero(~root)}
    moduli = np.where(root, TRUTH["E_root"], TRUTH["E_tip"])
    probe = RigidBody("probe", shape=Ball(PROBE), friction=friction)
    return build_model(
        replace(mesh, tet_groups=halves),
        Corotational(Isotropic(jnp.asarray(moduli), 0.45)),
        density=1100.0,
        bodies=[probe],
    )


def _presses() -> list[Configuration]:
    poses = []
    for x, depth in PLACES:
        above = np.array([x, 0.5 * FINGER[1], FINGER[2] + PROBE])
        below = above + np.array([0.0, 0.0, depth])
        state = BodyState("held", Pose(below), Pose(above))
        poses.append(
            Configuration(
                f"{1e3 * x:g} mm",
                ["z_min"],
                bodies={"probe": state},
                effectors=[ContactForce("cell", "probe", axis=(0.0, 0.0, 1.0))],
            )
        )
    return poses


def _press_tests(n: int) -> dict[str, float]:
    """Figures of the presses, and of `n` calibrations from their forces."""
    model, poses = _finger(), _presses()
    depths, left, ratios, forces = [], [], [], []
    for pose in poses:
        solution = solve_equilibrium(model, pose, settings=PRECISE)
        (contact,) = _contacts(model, pose, solution)
        forces.append(contact.force)
        depths.append(contact.depth / float(model.mechanism.contacts.scale))
        left.append(_unbalanced(model, pose, solution, contact))
        ratios.append(float(solution.steps) / _free_steps(pose, contact))
    errors, held = [], []
    space = _space()
    for draw in range(n):
        read = _read(model, space, poses, forces, draw)
        found = calibrate(
            model, space, read, noise="stated", uncertain=exactly_known(), starts=1
        )
        for estimate in found.parameters:
            off = estimate.value / TRUTH[estimate.name] - 1.0
            share = estimate.standard_error / estimate.value
            errors.append(100.0 * abs(off))
            held.append(abs(np.log1p(off)) < 1.96 * share)
    return {
        "balance": float(max(left)),
        "penetration_over_scale": float(max(depths)),
        "press_test_recovers_percent": float(max(errors)),
        "press_test_covered": 100.0 * float(np.mean(held)),
        "newton_iterations_over_free": float(np.median(ratios)),
    }


def _space() -> ParameterSpace:
    limits = {"lower": 2e4, "upper": 2e6, "unit": "Pa"}
    return ParameterSpace(
        [
            Parameter(f"E_{half}", "elasticity.E", 2e5, region=half, **limits)
            for half in ("root", "tip")
        ]
    )


def _read(
    model: Model,
    space: ParameterSpace,
    poses: Sequence[Configuration],
    forces: Sequence[Float[HostArray, "3"]],
    seed: int,
) -> tuple[Configuration, ...]:
    """Forces of the true finger with 1 % of noise."""
    read = [
        replace(
            pose,
            effectors=[
                replace(pose.effectors[0], std=0.01 * float(np.linalg.norm(force)))
            ],
        )
        for pose, force in zip(poses, forces, strict=True)
    ]
    return synthetic_measurements(model, space, read, TRUTH, noise=True, seed=seed)


def _unbalanced(
    model: Model,
    pose: Configuration,
    solution: EquilibriumSolution,
    contact: ContactState,
) -> float:
    """Force and moment that are left on the finger, over the force of the probe [-]."""
    lane = configuration_arrays(model.mesh, [pose], model.mechanism)[0]
    u, nodes = solution.displacement, model.mesh.nodes("z_min")
    x = np.asarray(model.positions(u))
    held = np.asarray(residual(model, lane, u))[nodes]
    gravity = gravity_load(model, jnp.asarray(pose.gravity))
    weight = np.asarray(gravity)[: model.mesh.n_nodes]
    probe = x[model.mesh.n_nodes]
    total = held.sum(axis=0) + weight.sum(axis=0) - contact.force
    moment = np.cross(x[nodes], held).sum(axis=0)
    moment += np.cross(x[: model.mesh.n_nodes], weight).sum(axis=0)
    moment -= np.cross(probe, contact.force) + contact.moment
    force = np.linalg.norm(contact.force)
    off = np.linalg.norm(total), np.linalg.norm(moment) / FINGER[0]
    return float(max(off) / force)


def _free_steps(pose: Configuration, contact: ContactState) -> float:
    """Newton iterations under the same force at the same place, without contact."""
    model = _finger()
    probe = pose.bodies["probe"]
    assert isinstance(probe, BodyState)
    place = tuple(probe.start.translation - [0.0, 0.0, PROBE])
    push = PointForce(place, tuple(-contact.force))
    free = replace(pose, loads=[push], bodies={"probe": "absent"}, effectors=())
    return float(solve_equilibrium(model, free, settings=PRECISE).steps)


MU = 0.5


def _slides_from(
    low: float, high: float, n: int, solve: Callable[[float], EquilibriumSolution]
) -> tuple[float, float]:
    """Bracket where equilibria end, by n halvings; there must be one at `low`."""
    for _ in range(n):
        middle = 0.5 * (low + high)
        if bool(solve(middle).converged):
            low = middle
        else:
            high = middle
    return low, high


def _slope(n: int) -> dict[str, float]:
    """Figures of a block on a slope."""
    side = 0.02
    model = build_model(
        beam(side, side, side, (3, 3, 3), order=2),
        NeoHookean(E, 0.45),
        density=1000.0,
        bodies=[RigidBody("table", shape=HalfSpace(), friction=MU)],
    )

    def pose(degrees: float) -> Configuration:
        angle = np.radians(degrees)
        g = (9.81 * np.sin(angle), 0.0, -9.81 * np.cos(angle))
        return Configuration("slope", gravity=g)

    steepest = float(np.degrees(np.arctan(MU)))
    solve = lambda degrees: solve_equilibrium(model, pose(degrees))
    low, high = _slides_from(steepest - 3.0, steepest + 3.0, n, solve)
    (contact,) = _contacts(model, pose(low), solve(low))
    weight = model.mass * np.asarray(pose(low).gravity)
    return {
        "slope_off_degrees": max(steepest - low, high - steepest),
        "slope_force_error": float(
            np.max(np.abs(contact.force - weight)) / np.linalg.norm(weight)
        ),
    }


def belt() -> tuple[Callable[[float], EquilibriumSolution], float]:
    """Pull both ends of a belt over a quarter of a drum.

    Returns what solves for a ratio of both pulls, and the largest ratio that friction
    holds.
    """
    drum, thick, wide, pull = 0.02, 5e-4, 5e-3, 0.1
    flat = beam(0.5 * np.pi * drum, wide, thick, (24, 1, 1), order=2)
    x, y, z = np.asarray(flat.points).T
    around = [(drum + z) * np.sin(x / drum), y, (drum + z) * np.cos(x / drum)]
    body = RigidBody(
        "drum",
        shape=Capsule(drum, 0.05),
        origin=(0.0, 0.5 * wide, 0.0),
        axes=np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]], float),
        friction=0.3,
    )
    model = build_model(
        replace(flat, points=np.stack(around, axis=1)),
        NeoHookean(1e6, NU),
        density=0.0,
        bodies=[body],
        contact_scale=2e-5,
    )

    def solve(ratio: float) -> EquilibriumSolution:
        loads = [
            SurfaceForce("x_min", (-pull, 0.0, 0.0)),
            SurfaceForce("x_max", (0.0, 0.0, -ratio * pull)),
        ]
        pose = Configuration("belt", loads=loads, gravity=NO_WEIGHT)
        return solve_equilibrium(model, pose)

    most = float(np.exp(0.3 * 0.5 * np.pi * drum / (drum + 0.5 * thick)))
    return solve, most


def _belt(n: int) -> dict[str, float]:
    """Figure of a belt over a quarter of a drum."""
    solve, most = belt()
    low, high = _slides_from(0.9 * most, 1.1 * most, n, solve)
    off = max(most - low, high - most) / most
    return {"belt_off_percent": 100.0 * off}


def _cost() -> dict[str, float]:
    """Time of Newton's iterations with friction, over those without."""
    ratios, models = [], {"rough": _finger(MU), "smooth": _finger()}
    for pose in _presses():
        solve = {
            name: partial(solve_equilibrium, model, pose)
            for name, model in models.items()
        }
        wait = lambda one: jax.block_until_ready(one())
        calls = {name: partial(wait, one) for name, one in solve.items()}
        times = interleave(calls, 5)
        each = {k: median_ms(times[k]) / float(solve[k]().steps) for k in solve}
        ratios.append(each["rough"] / each["smooth"])
    return {"iteration_over_smooth": float(np.median(ratios))}


PLATE, THICKNESS = (0.04, 0.04), 1e-3


def _drops(n: int) -> dict[str, int]:
    rng, radius = np.random.default_rng(50), 3e-3
    mesh = beam(*PLATE, THICKNESS, (8, 8, 1), origin=(0.0, 0.0, -THICKNESS), order=2)
    model = build_model(
        mesh,
        Corotational(Isotropic(E, NU)),
        density=1000.0,
        bodies=[RigidBody("ball", shape=Ball(radius))],
    )
    passed = solved = 0
    for k in range(n):
        start = np.append(
            rng.uniform(0.2, 0.8, 2) * PLATE, radius * rng.uniform(1.1, 3)
        )
        way = np.append(
            rng.uniform(-0.01, 0.01, 2), -THICKNESS * rng.uniform(1.0, 30.0)
        )
        state = BodyState("held", Pose(start + way), Pose(start))
        rims = ["x_min", "x_max", "y_min", "y_max"]
        pose = Configuration(f"drop {k}", rims, bodies={"ball": state})
        solution = solve_equilibrium(model, pose)
        if bool(solution.converged):
            solved += 1
            x = np.asarray(model.positions(solution.displacement))
            passed += int(_is_through(x[: mesh.n_nodes], x[mesh.n_nodes], radius))
    return {"passages": passed, "drops_solved": solved}


def _is_through(
    x: Float[HostArray, "n 3"], ball: Float[HostArray, "3"], radius: float
) -> bool:
    """Tell whether a part of the plate lies above the middle of the ball."""
    beside = np.linalg.norm(x[:, :2] - ball[:2], axis=1)
    return bool(np.any(x[beside < 0.7 * radius, 2] > ball[2]))
