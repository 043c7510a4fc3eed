"""A trunk with two cables in a process of its own: `_trunk.py BEGIN`.

It uses what the package offered before, too: a tapered trunk of quadratic tets with a
rigid cap, six poses, and Young's modulus. Prints as JSON when its calibration ends,
counted from BEGIN [s since 1970].
"""

import json
import sys
import time

import jax
import numpy as np

import softcal_jax as sc
from softcal_jax.mesh import TetMesh

LENGTH, SIDE, TAPER = 0.15, 0.03, 0.4
E, START = 150e3, 200e3
TENSIONS = ((0.0, 0.0), (0.5, 0.0), (0.0, 0.5), (1.0, 0.0), (0.0, 1.0), (0.5, 0.5))
"""Of both cables [N], in each pose."""


def trunk() -> TetMesh:
    """A beam along x that gets thinner towards its end."""
    mesh = sc.beam(LENGTH, SIDE, SIDE, (12, 2, 2), order=2)
    points = np.array(mesh.points)
    x, middle = points[:, :1] / LENGTH, SIDE / 2.0
    points[:, 1:] = middle + (points[:, 1:] - middle) * (1.0 - TAPER * x)
    return TetMesh(points, mesh.tets, mesh.node_groups, mesh.surface_groups)


def cable(name: str, side: float) -> sc.Cable:
    """Along the side of the trunk at +y or -y, from the clamp to the cap."""
    at = np.linspace(0.0, LENGTH, 5)
    across = side * 0.4 * SIDE * (1.0 - TAPER * at / LENGTH)
    middle = np.full_like(at, SIDE / 2.0)
    points = np.stack([at, middle + across, middle], axis=1)
    return sc.Cable(name, [tuple(map(float, point)) for point in points])


def main() -> None:
    """Simulate the measurements, calibrate against them, and print."""
    jax.config.update("jax_enable_x64", True)
    sc.use_compilation_cache()
    mesh = trunk()
    model = sc.build_model(
        mesh,
        sc.NeoHookean(E, 0.45),
        density=1070.0,
        bodies=[sc.RigidBody("cap", "x_max")],
        actuators=[cable("left", 1.0), cable("right", -1.0)],
    )
    places = np.array([[LENGTH / 2.0, 0.5 * SIDE, 0.3 * SIDE], [LENGTH, 0.015, 0.015]])
    markers = sc.Markers(("middle", "end"), places, std=1e-4)
    poses = [
        sc.Configuration(
            f"{left} N and {right} N",
            sc.Support("x_min"),
            markers=markers,
            actuation={"left": sc.ImposedForce(left), "right": sc.ImposedForce(right)},
        )
        for left, right in TENSIONS
    ]
    measured = sc.simulated_measurements(model, poses, noise=True)
    start = model.with_law(sc.NeoHookean(START, 0.45))
    modulus = sc.Parameter("E", "E", START, 5e4, 1e6, unit="Pa")
    result = sc.calibrate(start, modulus, measured)
    print(
        json.dumps(
            {
                "calibration_s": time.time() - float(sys.argv[1]),
                "converged": result.converged,
                "recovered": abs(result.value("E") / E - 1.0) < 0.02,
            }
        )
    )


if __name__ == "__main__":
    main()
