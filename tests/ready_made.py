"""The data of ready-made robots that nobody measured: meshes and synthetic readings.

    python tests/ready_made.py pneumatic_finger pressed_pad ... (by default all)

writes them into the package, beside the project files. `cable_project.py` does the same
for the cable beam.
"""

import csv
import math
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks._parallel_robot import parallel_robot
from benchmarks._printed_robot import printed_robot, read_poses_of
from softcal_jax.exchange.cad import mesh_cad
from softcal_jax.mesh import TetMesh, to_linear, write_mesh
from softcal_jax.project import load_project
from softcal_jax.robots import ready_made_path, simulated_measurements

FINGER_E, FINGER_STD, FINGER_ABOVE = 320e3, 0.2e-3, 2.0
"""Modulus [Pa] and noise [m] behind the readings; the cavity lies so high [mm]."""

FINGER_POSES = ("rest", "20 kPa", "40 kPa", "30 kPa")

ROBOT_SIZE, ROBOT_SEED, ROBOT_READINGS = 0.015, 0, 10
"""Edges of the tets of the parallel robot [m]; its errors; readings of each pose."""

PAD_E = {"left": 90e3, "right": 220e3}
PAD_CELLS = [14, 7, 4]
"""Moduli of the halves [Pa], and cells of the finer pad."""

BELLOWS_E, BELLOWS_STD = 10e6, 0.1e-3
"""Modulus [Pa] and noise [m] behind the readings."""

BELLOWS_GAP = 1e-3
BELLOWS_CELLS = {"along": 3, "across": 3, "up": 4}
"""Gaps of the folds [m], and cells of the finer finger."""

BELLOWS_POSES = ("100 kPa", "300 kPa", "500 kPa", "400 kPa")


def pneumatic_finger(folder: Path) -> None:
    """CAD model, mesh, and the markers of a finer finger of the true modulus."""
    from benchmarks._cad_models import write_finger

    step = write_finger(folder / "finger.step", above=FINGER_ABOVE)
    made = mesh_cad(step, size=4e-3, order=1)
    write_mesh(made, folder / "finger.msh", length_unit="mm")
    finer = {
        "mesh": {"file": "finger.step", "size": "2.5 mm"},
        "material.E": f"{FINGER_E} Pa",
    }
    _markers(folder, finer, FINGER_POSES, FINGER_STD)


def ordered_robot():
    """The parallel robot of the packaged project file."""
    std = {"std": 0.3e-3, "std_angle": math.radians(0.2)}
    return parallel_robot(size=ROBOT_SIZE, **std)


def parallel(folder: Path) -> None:
    """The two sheets, and what a tracker reads of a printed robot."""
    robot = ordered_robot()
    mesh = to_linear(robot.model.mesh)
    # A Gmsh file has one group of tets for each; those of the ends stay as nodes.
    sheets = {name: mesh.tet_groups[name] for name in ("lower", "upper")}
    mesh = TetMesh(mesh.points, mesh.tets, mesh.node_groups, {}, sheets)
    write_mesh(mesh, folder / "sheets.msh", length_unit="mm")
    printed = printed_robot(robot.geometry, seed=ROBOT_SEED, size=0.01)
    poses = (*robot.configurations, *robot.validation)
    measured = read_poses_of(printed, poses, seed=ROBOT_SEED, readings=ROBOT_READINGS)
    middle = np.array([0.0, -robot.geometry.rod_pull, 0.0])
    rows = []
    for c in measured:
        (rod,) = c.effectors
        place = 1e3 * (middle + rod.measured.translation)
        x, y, z, w = Rotation.from_matrix(rod.measured.matrix).as_quat()
        turn = [f"{q:.6f}" for q in (w, x, y, z)]
        rows.append([c.name, "rod", *(f"{p:.4f}" for p in place), *turn])
    header = ["pose", "sensor", "x_mm", "y_mm", "z_mm", "qw", "qx", "qy", "qz"]
    _write(folder / "tracker.csv", header, rows)


def pressed_pad(folder: Path) -> None:
    """Print what the sensor of the probe shows on a finer pad of the true moduli."""
    finer = {
        "mesh.beam.cells": PAD_CELLS,
        "material.contact_scale": "25 um",
        "material.regions": {name: {"E": f"{E} Pa"} for name, E in PAD_E.items()},
        "parameters": None,
    }
    project = load_project(folder / "project.toml", changes=finer)
    for c in simulated_measurements(project.model, project.configurations, noise=True):
        (cell,) = c.effectors
        forces = ", ".join(f"{force:.3f}" for force in cell.measured)
        print(f'{c.name}: measured.effectors.cell = "({forces}) N"')


def write_bellows(path: Path, **cells: int) -> None:
    """Write the mesh of the bellows finger, with other numbers of cells if given."""
    from benchmarks._bellows import Cells, bellows

    mesh = bellows(3, BELLOWS_GAP, Cells(**cells), ends=False, order=1)
    write_mesh(mesh, path, length_unit="mm")


def bellows_finger(folder: Path) -> None:
    """Mesh, and the markers of a finger of the true modulus on a finer mesh."""
    write_bellows(folder / "bellows.msh")
    with TemporaryDirectory() as place:
        file = Path(place) / "finer.msh"
        write_bellows(file, **BELLOWS_CELLS)
        changes = {"mesh.file": str(file), "material.E": f"{BELLOWS_E} Pa"}
        _markers(folder, changes, BELLOWS_POSES, BELLOWS_STD)


def _markers(folder: Path, changes, poses, std: float) -> None:
    """Write where markers are seen, with noise [m], on a project that is changed."""
    changes |= {"shared.measured": None}
    changes |= {f"configurations.{name}.measured": None for name in poses}
    project = load_project(folder / "project.toml", changes=changes)
    random = np.random.default_rng(0)
    rows = []
    for c in simulated_measurements(project.model, project.configurations):
        seen = c.measured + std * random.standard_normal(c.measured.shape)
        rows += [
            [c.name, name, *(f"{1e3 * x:.3f}" for x in place)]
            for name, place in zip(c.markers.names, seen, strict=True)
        ]
    _write(folder / "markers.csv", ["pose", "marker", "x_mm", "y_mm", "z_mm"], rows)


def _write(path: Path, header, rows) -> None:
    with path.open("w", newline="") as file:
        lines = csv.writer(file, lineterminator="\n")
        lines.writerows([header, *rows])


MAKERS = {
    "pneumatic_finger": pneumatic_finger,
    "parallel_robot": parallel,
    "pressed_pad": pressed_pad,
    "bellows_finger": bellows_finger,
}

if __name__ == "__main__":
    import jax

    jax.config.update("jax_enable_x64", True)
    sys.path.insert(0, str(Path(__file__).parents[1]))  # for the benchmarks
    for name in sys.argv[1:] or MAKERS:
        MAKERS[name](ready_made_path(name.replace("_", "-")).parent)
