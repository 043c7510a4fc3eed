"""Recover the motor angles of Emio's poses, which the authors did not record.

    python -m benchmarks._emio_angles SOURCE.csv -o poses.csv
    python -m benchmarks._emio_angles SOURCE.csv --tets -o camera.csv

The sources are blueleg_beam_polhemus_sphere.csv and blueleg_tetra_camera_sphere.csv of
Emio.validation. The robot was driven open loop by a SOFA scene, whose model put the
centre part at the column "Simulation". The same robot is brought there: with beams of
35 MPa (`SCENE` of _emio_mesh.py; quadratic tets stand in for them), or with the
authors' linear tets of 7 MPa. Of the four angles, three follow; the fourth is that of
least energy, as the scene's solver minimises the energy of the motors as well: where
turning the motors without moving the centre takes no work.
"""

import argparse
import csv
import re
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy.spatial.distance import cdist

import softcal_jax as sc
from benchmarks._emio_mesh import SCENE
from benchmarks._emio_robot import MOTORS, pose, robot, robot_of_linear_tets
from softcal_jax.control import actuator_compliance, with_inputs
from softcal_jax.equilibrium import Model

TOLERANCE = 1e-6
"""Distance from the scene's position at which the angles are accepted [m]."""


class Source(NamedTuple):
    """Columns of a file of the authors, one row a pose [mm]."""

    target: np.ndarray
    simulation: np.ndarray
    camera: np.ndarray
    polhemus: np.ndarray


class Angles(NamedTuple):
    """Angles of a pose [rad], torques [N m], and Newton iterations of all solves."""

    angles: np.ndarray
    torques: np.ndarray
    jacobian: np.ndarray
    newton_steps: int


def main() -> None:
    """Write poses.csv: pose, target, angles of the motors, and what was measured."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("source", type=Path)
    parser.add_argument("-o", "--output", type=Path, default=Path("poses.csv"))
    parser.add_argument("--cells", type=int, default=32, help="along a leg")
    parser.add_argument("--tets", action="store_true", help="the authors' linear tets")
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    sc.use_compilation_cache()
    source = read_source(options.source)
    model = robot_of_linear_tets() if options.tets else robot(SCENE, options.cells)
    found = recover(model, source.simulation)
    steps = [f.newton_steps for f in found]
    print(f"{np.mean(steps):.0f} Newton iterations a pose, at most {max(steps)}")
    print(f"misses follow the torques: {following(source, found):.3f}")
    write(options.output, source, np.rad2deg([f.angles for f in found]))


def read_source(file: Path) -> Source:
    """Read a file of the authors; a sensor that was off has zeros."""
    rows = file.read_text().splitlines()[9:]
    number = r"-?\d+\.?\d*(?:e[-+]?\d+)?"
    cells = [[re.findall(number, cell) for cell in row.split(";")] for row in rows]
    return Source(*np.moveaxis(np.array(cells, float), 1, 0))


def recover(model: Model, places: np.ndarray) -> list[Angles]:
    """Find the angles for places of the centre part [mm], each from its nearest one."""
    found: dict[int, Angles] = {}
    lane = sc.lanes(model, pose("scene", np.zeros(4)))[0]
    rest = sc.solve_equilibrium(model, lane)
    home = np.asarray(actuator_compliance(model, lane, rest).state.effectors)[0]
    known = [(1e3 * home, np.zeros(4), rest.displacement)]
    left = list(range(len(places)))
    while left:
        distances = cdist(places[left], [place for place, _, _ in known])
        row, near = np.unravel_index(np.argmin(distances), distances.shape)
        k = left[row]
        found[k], u = approach(model, lane, known[near], places[k])
        known.append((places[k], found[k].angles, u))
        left.remove(k)
    return [found[k] for k in range(len(places))]


def approach(model: Model, lane, known, place: np.ndarray):
    """Turn the motors from a known pose until the centre part is at a place [mm].

    Newton's method in the four angles: the three coordinates, and no work along the
    motion of the motors that the centre does not follow.
    """
    _, angles, u = known
    steps = 0
    for _ in range(30):
        posed = with_inputs(lane, jnp.asarray(angles))
        solution = sc.solve_equilibrium(model, posed, guess=u)
        steps += int(solution.steps)
        if not solution.converged:
            raise RuntimeError(f"no equilibrium on the way to {place} mm: {solution}.")
        compliance = actuator_compliance(model, posed, solution)
        u = solution.displacement
        J, K = np.asarray(compliance.W_ea)[:3], np.asarray(compliance.by_force)
        torques = np.asarray(compliance.state.forces)
        off = 1e-3 * place - np.asarray(compliance.state.effectors)[0]
        idle = np.linalg.svd(J)[2][-1]
        turn = np.linalg.solve(
            np.vstack([J, idle @ K]), np.append(off, -float(idle @ torques))
        )
        if np.linalg.norm(off) < TOLERANCE and np.abs(turn).max() < 1e-4:
            return Angles(angles, torques, J, steps), u
        angles = angles + turn * min(1.0, 0.2 / np.abs(turn).max())
    raise RuntimeError(f"no angles for {place} mm.")


def following(source: Source, found: list[Angles]) -> float:
    """Correlate misses of the scene's solver with those that the torques would cause.

    It weighs the energy of the motors against the distance from the target, so it ends
    off the target by a multiple of the J+^T of the torques.
    """
    missed = source.target - source.simulation
    pulled = [np.linalg.pinv(f.jacobian).T @ f.torques for f in found]
    return float(np.corrcoef(np.ravel(missed), np.ravel(pulled))[0, 1])


def write(file: Path, source: Source, angles: np.ndarray) -> None:
    """Write the poses: names, positions [mm] and angles [deg]."""
    names = [
        *(f"{what}_{axis}_mm" for what in ("target", "scene") for axis in "xyz"),
        *(f"{motor.replace(' ', '_')}_deg" for motor in MOTORS),
        *(f"{axis}_mm" for axis in "xyz"),
    ]
    seen = source.polhemus if source.polhemus.any() else source.camera
    columns = [source.target, source.simulation, angles, seen]
    with file.open("w", newline="") as stream:
        lines = csv.writer(stream, lineterminator="\n")
        lines.writerow(["pose", "marker", *names])
        for k, row in enumerate(np.concatenate(columns, axis=1)):
            lines.writerow([f"pose {k + 1}", "sensor", *(f"{v:.4f}" for v in row)])


if __name__ == "__main__":
    main()
