"""Surfaces of the body that touch each other: against closed forms and a mirror.

- `hertz`: a flat and a round surface of two bodies of one material, pressed together; a
  quarter of both on graded meshes of quadratic tets. Force by Hertz, F = 4/3 E* R^0.5
  d^1.5 with 1 / E* = 2 (1 - nu^2) / E.
- `fold`: two arms over a slit are pressed together, and one of them against a plane in
  their mirror. Both arms touch as the one does its plane.

Figures:

- `hertz_error_percent`: of the force, on the finest mesh.
- `fold_error_percent`: largest difference of displacements, over the largest.
- `balance`: sum of the forces of contact on the fold, over their absolute sum.
- `iteration_over_apart`: time of a Newton iteration of the fold, over one of the same
  arms that pass through each other.
"""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks._problem import Goal, Options, Outcome
from benchmarks._timing import interleave, median_ms
from softcal_jax.bodies import RigidBody
from softcal_jax.configurations import Configuration, Support, SurfaceForce
from softcal_jax.contact import HalfSpace
from softcal_jax.equilibrium import (
    Model,
    build_model,
    robot_states,
    solve_equilibrium,
)
from softcal_jax.materials import Corotational, Isotropic
from softcal_jax.mesh import TetMesh, beam, boundary_faces, to_quadratic

GOALS = {
    "hertz_error_percent": Goal("at most", 2.0),
    "fold_error_percent": Goal("at most", 1.0),
    "balance": Goal("at most", 1e-12),
    "iteration_over_apart": Goal("at most", 1.5),
}

COUNTS = {"hertz": 3, "fold": 5}

E, NU = 1e5, 0.3
LAW = Corotational(Isotropic(E, NU))
NO_WEIGHT = (0.0, 0.0, 0.0)

MESHES = [(6, 1.6e-2), (8, 8e-3), (10, 6e-3)]
"""Cells along each axis of both bodies, and the scale of contact over the approach."""

FAR, GRADED = 60.0, 5.2
"""Size of both bodies over that of the contact, and refinement towards it."""


def run(options: Options) -> Outcome:
    """Run the parts that are asked for.

    `hertz=n` takes the first n meshes, `fold=n` that many timed solves.
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
    force, _ = _pressed(model, pose)
    E_star = 0.5 * E / (1.0 - NU**2)
    hertz = 4.0 / 3.0 * E_star * np.sqrt(R) * approach**1.5
    return 100.0 * float(4.0 * force[2] / hertz - 1.0)


def _pressed(model: Model, pose: Configuration):
    """Force of the first surface on the second, and displacements of nodes."""
    solution = solve_equilibrium(model, pose)
    batch = jax.tree.map(lambda leaf: leaf[None], solution)
    (state,) = robot_states(model, [pose], batch)
    if state is None:
        raise RuntimeError(f"{pose.name} has no equilibrium.")
    return state.contacts[0].force, np.asarray(solution.displacement)


LENGTH, WIDTH, SLIT = 0.06, 0.01, 0.004


def _arms(*, both: bool) -> TetMesh:
    """An arm over a slit, and its mirror image."""
    box = beam(LENGTH, WIDTH, 2.5 * SLIT, (18, 3, 5), order=2)
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
