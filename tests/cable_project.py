"""The ready-made cable beam, by the Python API, and its recordings.

The tracker's readings are equilibria of the same beam with another law, twice the cells
along and E = 400 kPa, five readings of each pose with 0.1 mm and 0.1 degrees of noise:

    python tests/cable_project.py
"""

import numpy as np
from scipy.spatial.transform import Rotation

import softcal_jax as sc
from softcal_jax.robots import ready_made_path, simulated_measurements

FOLDER = ready_made_path("cable-beam").parent
E_TRUE, N_READINGS = 400e3, 5
BASE = sc.Pose([-0.2, 0.05, 0.0], [0.0, 0.0, np.pi / 2])
POINT = np.array([0.105, 0.01, 0.01])
ASKED = {
    "slack": {},
    "pulled": {"cable": sc.ImposedForce(1.5)},
    "wound up": {"cable": sc.ImposedDisplacement(0.005)},
}


def cable_beam(law=None, cells=6):
    """The model of the project file."""
    cable = sc.Cable(
        "cable",
        [
            sc.Guide((0.0, 0.01, 0.025), "ground"),
            (0.05, 0.01, 0.02),
            sc.Guide((0.1, 0.01, 0.02), "plate"),
        ],
    )
    return sc.build_model(
        sc.beam(0.1, 0.02, 0.02, (cells, 1, 1), order=2),
        law or sc.Corotational(sc.Isotropic(300e3, 0.3)),
        density=1000.0,
        bodies=[sc.RigidBody("plate", "x_max", mass=0.01)],
        actuators=[cable],
    )


def poses():
    """Its configurations, not measured."""
    sensor = sc.BodyFrame(
        "sensor", "plate", point=POINT, std=1e-4, std_angle=float(np.deg2rad(0.1))
    )
    wound = sc.ActuatorDisplacement("wound", "cable", std=1e-4)
    return [
        sc.Configuration(
            name,
            "x_min",
            (0.0, 0.0, -9.81),
            effectors=[sensor, wound],
            actuation=asked,
        )
        for name, asked in ASKED.items()
    ]


def record():
    """Writes the tracker's file, and prints what the encoder of the winch showed."""
    robot = cable_beam(sc.NeoHookean(E_TRUE, 0.3), cells=12)
    random = np.random.default_rng(1)
    lines = ["pose,sensor,x_mm,y_mm,z_mm,azimuth_deg,elevation_deg,roll_deg"]
    for c in simulated_measurements(robot, poses()):
        sensor, wound = c.effectors
        place = POINT + sensor.measured.translation
        for _ in range(N_READINGS):
            noise = random.standard_normal(6) * ([0.1] * 3 + [0.1] * 3)
            R = Rotation.from_rotvec(np.deg2rad(noise[3:])) * Rotation.from_matrix(
                BASE.matrix.T @ sensor.measured.matrix
            )
            p = 1e3 * (place - BASE.translation) @ BASE.matrix + noise[:3]
            angles = R.as_euler("ZYX", degrees=True)
            cells = ",".join(f"{v:.3f}" for v in (*p, *angles))
            lines.append(f"{c.name},tip,{cells}")
        print(f"{c.name}: the cable is {1e3 * wound.measured:.2f} mm shorter")
    (FOLDER / "tracker.csv").write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    import jax

    jax.config.update("jax_enable_x64", True)
    record()
