"""A sphere that is pressed into a half-space, pushed aside and drawn back.

It slips from the rim of the contact inwards, by Coulomb friction, as Cattaneo (Rend.
Accad. Naz. Lincei 27, 1938) and Mindlin (J. Appl. Mech. 16, 1949) have it; drawn back,
it slips the other way from the rim (Mindlin and Deresiewicz, J. Appl. Mech. 20, 1953).
With the radius a of the contact, P the normal force and d the way aside,

    Q = mu P (1 - (1 - d / d_1)^1.5),    d_1 = 3 mu P (2 - nu) / (16 a G),

and from d_0 with Q_0 back, Q = Q_0 - 2 mu P (1 - (1 - (d_0 - d) / (2 d_1))^1.5). It
sticks within c = a (1 - Q / (mu P))^(1/3). The half-space is all but incompressible, so
that pressing alone causes no shear, as these formulas assume; one half of it is meshed,
graded towards the contact. Each pose comes `after` the one before.

Figures:

- `force_error_percent`: of Q on the way aside, over mu P, the largest; and
  `force_back_error_percent`, on the way back.
- `stick_radius_error_percent`: of c, from the share of the contact that slides, over a,
  the largest on the way aside.
- `newton_iterations`: of each pose from the one before, the median.
"""

from dataclasses import replace

import numpy as np

from benchmarks._problem import Goal, Options, Outcome, Table
from softcal_jax.bodies import Pose, RigidBody
from softcal_jax.configurations import Configuration, Support
from softcal_jax.contact import Ball
from softcal_jax.equilibrium import (
    NewtonSettings,
    Workers,
    build_model,
    check_converged,
    equilibria,
    lanes,
    robot_states,
)
from softcal_jax.materials import Corotational, Isotropic
from softcal_jax.mesh import beam, to_quadratic

GOALS = {
    "force_error_percent": Goal("at most", 5.0),
    "force_back_error_percent": Goal("at most", 5.0),
    "stick_radius_error_percent": Goal("at most", 5.0),
}

COUNTS = {"cells": 8}

E, NU, MU, RADIUS = 1e5, 0.49, 0.3, 5e-3
DEPTH = 0.01 * RADIUS
FAR, GRADED = 16.0, 5.0
"""Size of the half-space over the contact, and its refinement towards the contact."""

SCALE = 8e-3
"""Scale of contact over the depth [-]."""

ASIDE, BACK = (0.3, 0.6, 0.85), (0.5, 0.1, -0.3)
"""Ways aside over that at which all slips, and from the last of them back [-]."""


def run(options: Options) -> Outcome:
    """Push aside and back; `cells=n` cells of the mesh along each axis."""
    cells = (options.counts or COUNTS)["cells"]
    G, a = E / (2.0 * (1.0 + NU)), np.sqrt(RADIUS * DEPTH)
    P = 4.0 / 3.0 * E / (1.0 - NU**2) * np.sqrt(RADIUS) * DEPTH**1.5
    longest = 3.0 * MU * P * (2.0 - NU) / (16.0 * a * G)
    side = FAR * a
    graded = lambda t: side * np.sinh(GRADED * t / side) / np.sinh(GRADED)
    mesh = beam(2.0 * side, side, side, (2 * cells, cells, cells))
    x, y, z = mesh.points.T
    points = np.stack([graded(x - side), graded(y), side - graded(side - z)], axis=1)
    sphere = RigidBody(
        "sphere", shape=Ball(RADIUS), origin=(0.0, 0.0, side + RADIUS), friction=MU
    )
    model = build_model(
        to_quadratic(replace(mesh, points=points)),
        Corotational(Isotropic(E, NU)),
        density=0.0,
        bodies=[sphere],
        contact_scale=SCALE * DEPTH,
    )
    ways = np.array([0.0, *ASIDE, *BACK])
    held = [Support("y_min", "y"), "x_min", "x_max", "y_max", "z_min"]
    poses = [
        Configuration(
            f"pose {k}",
            held,
            gravity=(0.0, 0.0, 0.0),
            bodies={"sphere": Pose((way * longest, 0.0, -DEPTH))},
            after=f"pose {k - 1}" if k else None,
        )
        for k, way in enumerate(ways)
    ]
    batch = lanes(model, poses)
    with Workers(model, len(poses)) as workers:
        solution = equilibria(workers, model, batch, NewtonSettings())
    check_converged(solution, tuple(pose.name for pose in poses))
    states = robot_states(model, poses, solution, batch)
    felt = [state.contacts[0] for state in states if state is not None]
    share = np.array([-c.force[0] / (MU * c.force[2]) for c in felt])
    aside = ways <= ways[len(ASIDE)]
    aside[len(ASIDE) + 1 :] = False
    first = 1.0 - (1.0 - ways) ** 1.5
    last = first[len(ASIDE)]
    after = (ways[len(ASIDE)] - ways) / 2.0
    expected = np.where(aside, first, last - 2.0 * (1.0 - (1.0 - after) ** 1.5))
    sticks = np.sqrt(1.0 - np.array([float(c.sliding) for c in felt]))
    radius_off = np.abs(sticks - (1.0 - expected) ** (1.0 / 3.0))[aside]
    off = 100.0 * np.abs(share - expected)
    figures = {
        "force_error_percent": float(off[aside].max()),
        "force_back_error_percent": float(off[~aside].max()),
        "stick_radius_error_percent": float(100.0 * radius_off.max()),
        "newton_iterations": float(np.median(np.asarray(solution.steps)[1:])),
    }
    rows = [
        [f"{way:.2f}", f"{q:.3f}", f"{want:.3f}", f"{c:.3f}"]
        for way, q, want, c in zip(ways, share, expected, sticks, strict=True)
    ]
    names = ["d / d_1", "Q / (mu P)", "by Mindlin", "stick radius / a"]
    return Outcome(figures, {}, GOALS, [Table("Partial slip", names, rows)])
