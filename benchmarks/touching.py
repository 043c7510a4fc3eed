"""Surfaces of the body that touch each other: against closed forms and a mirror.

- `hertz`: a flat and a round surface of two bodies of one material, pressed together; a
  quarter of both on graded meshes of quadratic tets. Force by Hertz, F = 4/3 E* R^0.5
  d^1.5 with 1 / E* = 2 (1 - nu^2) / E.
- `fold`: two arms over a slit are pressed together, and one of them against a plane in
  their mirror. Both arms touch as the one does its plane.
- `bellows`: three hollow folds in a row on a strip are inflated between two planes, and
  one of them between the planes in the middle of its gaps, which are obstacles and
  mirrors. Each of the three moves as the one does.
- `closed`: a cable closes a fold on itself, and E is calibrated from where
  twelve markers stand in three poses, all closed. The truth has a finer mesh; noise of
  0.3 mm.

Figures:

- `hertz_error_percent`: of the force, on the finest mesh.
- `fold_error_percent`: largest difference of displacements, over the largest.
- `balance`: sum of the forces of contact on the fold, over their absolute sum.
- `iteration_over_apart`: time of a Newton iteration of the fold, over one of the same
  arms that pass through each other.
- `bellows_error_percent`: largest difference of displacements of the three folds from
  those of the one, over the largest; `bellows_touches_at_percent` of the pressure.
- `closed_covered`: draws of noise whose 95 % interval, by the linear model, holds the
  true E; `closed_share_covered`, over all draws [%]; `closed_std_percent`, standard
  error of E, the median; `closed_off_percent`, error of the mean of E over all draws.
"""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from scipy.spatial import KDTree

from benchmarks._bellows import PITCH, bellows
from benchmarks._problem import Goal, Options, Outcome
from benchmarks._timing import interleave, median_ms
from softcal_jax.actuators import Cable, Chamber
from softcal_jax.bodies import RigidBody
from softcal_jax.calibration import calibrate
from softcal_jax.configurations import (
    Configuration,
    ImposedForce,
    Markers,
    Support,
    SurfaceForce,
)
from softcal_jax.contact import HalfSpace
from softcal_jax.equilibrium import (
    Model,
    build_model,
    robot_states,
    solve_equilibrium,
)
from softcal_jax.fields import Parameter, ParameterSpace, exactly_known
from softcal_jax.materials import Corotational, Isotropic, NeoHookean
from softcal_jax.mesh import TetMesh, beam, boundary_faces, to_quadratic
from softcal_jax.robots import simulated_measurements

GOALS = {
    "hertz_error_percent": Goal("at most", 2.0),
    "fold_error_percent": Goal("at most", 1.0),
    "bellows_error_percent": Goal("at most", 1.0),
    "closed_covered": Goal("at least", 18),
    "balance": Goal("at most", 1e-12),
    "iteration_over_apart": Goal("at most", 1.5),
}

COUNTS = {"hertz": 3, "fold": 5, "bellows": 1, "closed": 20}

E, NU = 1e5, 0.3
LAW = Corotational(Isotropic(E, NU))
NO_WEIGHT = (0.0, 0.0, 0.0)

MESHES = [(6, 1.6e-2), (8, 8e-3), (10, 6e-3)]
"""Cells along each axis of both bodies, and the scale of contact over the approach."""

FAR, GRADED = 60.0, 5.2
"""Size of both bodies over that of the contact, and refinement towards it."""


def run(options: Options) -> Outcome:
    """Run the parts that are asked for.

    `hertz=n` takes the first n meshes, `fold=n` that many timed solves, `closed=n`
    draws of noise.
    """
    counts = options.counts or COUNTS
    figures, samples = {}, {}
    if n := counts.get("hertz"):
        options.say("a round surface on a flat one")
        errors = [_hertz(cells, scale) for cells, scale in MESHES[:n]]
        samples["hertz_error_percent"] = errors
        figures["hertz_error_percent"] = abs(errors[-1])
    if n := counts.get("fold"):
        options.say("a fold, and its half on a mirror")
        figures |= _fold(n)
    if counts.get("bellows"):
        options.say("three folds of a bellows, and one between its mirrors")
        figures |= _bellows()
    if n := counts.get("closed"):
        options.say("calibrations of a fold that is closed")
        figures |= _closed(n)
    goals = {name: goal for name, goal in GOALS.items() if name in figures}
    return Outcome(figures, samples, goals, [])


def _hertz(cells: int, scale: float) -> float:
    """Error of the force [%]."""
    R = 5e-3
    approach = 0.01 * R
    radius = np.sqrt(R * approach)
    side = FAR * radius
    box = beam(side, side, side, (cells, cells, cells))
    graded = lambda t: side * np.sinh(GRADED * t / side) / np.sinh(GRADED)
    x, y, z = box.points.T
    lower = np.stack([graded(x), graded(y), -graded(side - z)], axis=1)
    upper = np.stack([graded(x), graded(y), graded(z)], axis=1)
    tets = np.concatenate([box.tets, box.tets + box.n_nodes])
    mesh = to_quadratic(TetMesh(np.concatenate([lower, upper]), tets))
    # The round surface is a paraboloid around the contact.
    above, points = np.zeros(mesh.n_nodes, bool), mesh.points.copy()
    above[mesh.tets[len(box.tets) :]] = True
    r = np.minimum(np.linalg.norm(points[:, :2], axis=1), 3.0 * radius)
    flat = above & (points[:, 2] == 0.0)
    deep = np.exp(-np.abs(points[:, 2]) / (6.0 * radius))
    points[:, 2] += above * deep * r**2 / (2.0 * R)
    faces = boundary_faces(mesh)
    near = (points[faces][..., :2] < 3.0 * radius).all(axis=(1, 2))
    of_lower = ((mesh.points[faces][..., 2] == 0.0) & ~above[faces]).all(axis=1)
    mesh = replace(mesh, points=points)
    mesh = mesh.with_surface_group("flat", faces[near & of_lower])
    mesh = mesh.with_surface_group("round", faces[near & flat[faces].all(axis=1)])
    at = lambda axis, value: np.flatnonzero(np.isclose(points[:, axis], value))
    model = build_model(
        mesh,
        LAW,
        density=0.0,
        touching=[("flat", "round")],
        contact_scale=scale * approach,
    )
    along = [Support(at(k, v), "xy"[k]) for k in (0, 1) for v in (0.0, side)]
    top = Support(at(2, side), "z", displacement=(0.0, 0.0, -approach))
    pose = Configuration(
        "pressed", [*along, Support(at(2, -side), "z"), top], gravity=NO_WEIGHT
    )
    contact, _ = _pressed(model, pose)
    E_star = 0.5 * E / (1.0 - NU**2)
    hertz = 4.0 / 3.0 * E_star * np.sqrt(R) * approach**1.5
    return 100.0 * float(4.0 * contact.force[2] / hertz - 1.0)


def _pressed(model: Model, pose: Configuration):
    """State of the first contact, and displacements of nodes."""
    solution = solve_equilibrium(model, pose)
    batch = jax.tree.map(lambda leaf: leaf[None], solution)
    (state,) = robot_states(model, [pose], batch)
    if state is None:
        raise RuntimeError(f"{pose.name} has no equilibrium.")
    return state.contacts[0], np.asarray(solution.displacement)


LENGTH, WIDTH, SLIT = 0.06, 0.01, 0.004


def _arms(cells=(18, 3, 5), *, both: bool) -> TetMesh:
    """An arm over a slit, and its mirror image."""
    box = beam(LENGTH, WIDTH, 2.5 * SLIT, cells, order=2)
    x, _, z = box.centroids.T
    solid = (x < 0.01) | (z > 0.5 * SLIT)
    used, tets = np.unique(box.tets[solid], return_inverse=True)
    points, tets = box.points[used], tets.reshape(-1, 10)
    if both:
        n, on = len(points), points[:, 2] < 1e-9
        image = np.where(on, np.arange(n), n + np.cumsum(~on) - 1)
        points = np.concatenate([points, points[~on] * [1.0, 1.0, -1.0]])
        other = image[tets][:, [1, 0, 2, 3, 4, 6, 5, 8, 7, 9]]
        tets = np.concatenate([tets, other])
    mesh = TetMesh(points, tets)
    faces = boundary_faces(mesh)
    x, z = points[faces][..., 0].min(axis=1), points[faces][..., 2]
    for side, name, outer in ((1, "upper", "top"), (-1, "lower", "bottom")):
        wall = np.isclose(z, side * 0.5 * SLIT).all(axis=1) & (x > 0.0099)
        end = np.isclose(z, side * 2.5 * SLIT).all(axis=1) & (x > 0.8 * LENGTH)
        if wall.any():
            mesh = mesh.with_surface_group(name, faces[wall])
            mesh = mesh.with_surface_group(outer, faces[end])
    return mesh


def _fold(repeats: int) -> dict[str, float]:
    fold, half = _arms(both=True), _arms(both=False)
    root = lambda mesh: np.flatnonzero(mesh.points[:, 0] < 1e-9)
    cut = np.flatnonzero(half.points[:, 2] < 1e-9)
    push = [SurfaceForce(w, (0, 0, f)) for w, f in (("top", -0.03), ("bottom", 0.03))]
    build = partial(build_model, law=LAW, density=0.0, contact_scale=2e-5)
    model = build(fold, touching=[("upper", "lower")])
    mirror = build(half, bodies=[RigidBody("mirror", shape=HalfSpace())])
    pose = Configuration("fold", [root(fold)], loads=push, gravity=NO_WEIGHT)
    alone = Configuration(
        "half", [root(half), Support(cut, "z")], loads=push[:1], gravity=NO_WEIGHT
    )
    _, u = _pressed(model, pose)
    _, wanted = _pressed(mirror, alone)
    wanted = wanted[: half.n_nodes]
    touching, contacts = model.mechanism.contacts.touching, model.mechanism.contacts
    assert touching is not None
    x = jnp.asarray(fold.points + u)
    _, force = touching.energy_and_force(x, contacts.scale, contacts.stiffness)
    apart = build(fold)
    wait = lambda model: jax.block_until_ready(solve_equilibrium(model, pose))
    calls = {"touching": partial(wait, model), "apart": partial(wait, apart)}
    times = interleave(calls, repeats)
    each = {k: median_ms(times[k]) / float(calls[k]().steps) for k in calls}
    off = np.abs(u[: half.n_nodes] - wanted).max() / np.abs(wanted).max()
    left = jnp.abs(jnp.sum(force, axis=0)).max() / jnp.sum(jnp.abs(force))
    return {
        "fold_error_percent": 100.0 * float(off),
        "balance": float(left),
        "iteration_over_apart": each["touching"] / each["apart"],
    }


GAP, PRESSURE = 1e-3, 2.4e3
"""Gap of the bellows [m], and pressure in all of its folds [Pa]."""


FORWARD = ((0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (1.0, 0.0, 0.0))
BACK = ((0.0, 0.0, 1.0), (0.0, 1.0, 0.0), (-1.0, 0.0, 0.0))
"""Axes of planes that face along x, and against it."""


def _folds(n: int) -> Model:
    """Hollow folds in a row, between planes in the middle of gaps at both ends."""
    planes = [
        RigidBody("first", shape=HalfSpace(), origin=(0.0, 0.0, 0.0), axes=FORWARD),
        RigidBody("last", shape=HalfSpace(), origin=(n * PITCH, 0.0, 0.0), axes=BACK),
    ]
    return build_model(
        bellows(n, GAP),
        NeoHookean(E, NU),
        density=0.0,
        actuators=[Chamber("air", "cavity", seal=True)],
        bodies=planes,
        touching=[("front", "back")] if n > 1 else (),
        contact_scale=5e-6,
    )


def _inflated(model: Model, share: float = 1.0):
    """Area on the first plane [m2], and displacements of nodes, at a pressure."""
    mesh = model.mesh
    x, _, z = mesh.points.T
    in_gap = np.isclose(x / PITCH, np.rint(x / PITCH))
    pose = Configuration(
        "inflated",
        [
            *(Support(end, "x") for end in ("base", "tip")),
            Support("mirror", "y"),
            Support(np.flatnonzero(in_gap & np.isclose(z, 0.0)), "z"),
        ],
        actuation={"air": ImposedForce(share * PRESSURE)},
        gravity=NO_WEIGHT,
    )
    contact, u = _pressed(model, pose)
    return contact.area, u[: mesh.n_nodes]


def _bellows() -> dict[str, float]:
    three, one = _folds(3), _folds(1)
    _, moved = _inflated(three)
    _, wanted = _inflated(one)
    tree, off = KDTree(three.mesh.points), []
    for k in range(3):
        away, at = tree.query(one.mesh.points + np.array([k * PITCH, 0.0, 0.0]))
        assert away.max() < 1e-9
        off.append(np.abs(moved[at] - wanted).max() / np.abs(wanted).max())
    # The end of the strip always lies on the plane.
    strip, _ = _inflated(one, 0.0)
    low, high = 0.0, 1.0
    for _ in range(6):
        middle = 0.5 * (low + high)
        area, _ = _inflated(one, middle)
        low, high = (low, middle) if area > 1.01 * strip else (middle, high)
    return {
        "bellows_error_percent": 100.0 * float(max(off)),
        "bellows_touches_at_percent": 100.0 * high,
    }


LARGER, NOISE = 4.0, 0.3e-3
"""Size of the closed fold over that of the other one; noise of a coordinate [m]."""

TENSIONS = (0.2, 0.4, 0.8)
"""Of the cable at its ends [N]; all close the fold."""


MARKED = (0.3, 0.45, 0.6, 0.75, 0.85, 0.95)
"""Where markers stand along both arms, over their length."""


def _closed(n: int) -> dict[str, float]:
    cells = {"coarse": (12, 2, 5), "fine": (18, 3, 5)}
    models = {name: _pulled(cells) for name, cells in cells.items()}
    places = LARGER * np.array([[share * LENGTH, 0.0, 0.0] for share in MARKED])
    upper = places + LARGER * np.array([0.0, 0.5 * WIDTH, 2.5 * SLIT])
    lower = places + LARGER * np.array([0.0, 0.5 * WIDTH, -2.5 * SLIT])
    both = np.concatenate([upper, lower])
    markers = Markers([str(k) for k in range(len(both))], both, std=NOISE)
    poses = [
        Configuration(
            f"{tension:g} N",
            ["root"],
            actuation={"cable": ImposedForce(tension)},
            markers=markers,
            gravity=NO_WEIGHT,
        )
        for tension in TENSIONS
    ]
    exact = simulated_measurements(models["fine"], poses)
    limits = {"lower": 0.2 * E, "upper": 5.0 * E, "unit": "Pa"}
    space = ParameterSpace([Parameter("E", "elasticity.E", 1.3 * E, **limits)])
    rng, z, stds = np.random.default_rng(0), [], []
    for _ in range(n):
        noise = [NOISE * rng.standard_normal(both.shape) for _ in exact]
        read = [
            replace(pose, measured=np.asarray(pose.measured) + more)
            for pose, more in zip(exact, noise, strict=True)
        ]
        found = calibrate(
            models["coarse"],
            space,
            read,
            noise="stated",
            uncertain=exactly_known(),
            starts=1,
        )
        if not found.converged:
            raise RuntimeError("a calibration did not converge.")
        (estimate,) = found.parameters
        z.append(np.log(estimate.value / E))
        stds.append(estimate.standard_error / estimate.value)
    inside = np.abs(z) < 1.96 * np.array(stds)
    return {
        "closed_covered": int(inside.sum()),
        "closed_share_covered": 100.0 * float(inside.mean()),
        "closed_std_percent": 100.0 * float(np.median(stds)),
        "closed_off_percent": 100.0 * float(np.mean(z)),
    }


def _pulled(cells: tuple[int, int, int]) -> Model:
    """A larger fold with a cable between the ends of its arms."""
    mesh = _arms(cells, both=True)
    mesh = replace(mesh, points=LARGER * mesh.points)
    mesh = mesh.with_node_group("root", np.flatnonzero(mesh.points[:, 0] < 1e-9))
    x, y, z = LARGER * np.array([0.9 * LENGTH, 0.5 * WIDTH, 1.5 * SLIT])
    return build_model(
        mesh,
        LAW,
        density=0.0,
        actuators=[Cable("cable", [(x, y, z), (x, y, -z)])],
        touching=[("upper", "lower")],
        contact_scale=LARGER * 2e-5,
    )
