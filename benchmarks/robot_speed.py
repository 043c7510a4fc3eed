"""Time and memory of the parallel robot on sheets of about 3 000 nodes each.

- The calibration of 36 parameters on seven poses, compiled, and the peak of the memory
  of its process.
- A step of inverse control: what it takes beyond the Newton iterations of the
  equilibrium that it is tried on, and with them.
"""

import json
import statistics
import sys
import time

import equinox as eqx
import jax
import numpy as np

from benchmarks._memory import peak_bytes
from benchmarks._parallel_robot import ParallelRobot, parallel_robot, pose as posed
from benchmarks._printed_robot import printed_robot, read_poses_of
from benchmarks._problem import Figure, Goal, Options, Outcome, Table
from benchmarks._timing import forget_starts, run_process
from softcal_jax._typing import HostArray
from softcal_jax.bodies import Pose
from softcal_jax.calibration import CalibrationResult, calibrate
from softcal_jax.configurations import (
    AbstractEffector,
    BodyFrame,
    Configuration,
    configuration_arrays,
)
from softcal_jax.control import ControlSettings, solve_inverse
from softcal_jax.equilibrium import effector_values, solve_equilibrium

SIZE = 0.005
"""Edge length of the tets: 3 348 nodes a sheet [m]."""

PRINTED_SIZE = 0.0075
"""Edge length of the printed robot that is measured [m]."""

GOAL_ANGLES = (30.0, 40.0, 55.0, 60.0, 50.0, 35.0)
"""Motor angles whose pose of the rod is the goal of inverse control [degrees]."""

REPEATS = 3
"""Timed runs of inverse control."""

GOALS = {
    "seconds_calibration": Goal("at most", 60),
    "peak_memory_gb": Goal("at most", 4),
    "inverse_step_over_newton_iteration": Goal("at most", 3),
}


def run(options: Options) -> Outcome:
    """The calibration in a process of its own, for its memory; then inverse control."""
    options.say("calibration, twice: the first one compiles")
    command = [sys.executable, "-m", "benchmarks.robot_speed"]
    figures: dict[str, Figure] = json.loads(run_process(command).splitlines()[-1])
    options.say("inverse control")
    figures |= control_figures()
    rows = [[name, f"{value:.3g}"] for name, value in figures.items()]
    return Outcome(figures, goals=GOALS, tables=[Table("Speed", ["", ""], rows)])


def measured_robot() -> tuple[ParallelRobot, tuple[Configuration, ...]]:
    """The robot, and its poses as a printed one takes them."""
    robot = parallel_robot(size=SIZE, setup=None)
    printed = printed_robot(robot.geometry, seed=0, size=PRINTED_SIZE)
    return robot, read_poses_of(printed, robot.configurations, seed=0)


def calibration_figures() -> dict[str, Figure]:
    """Time of the second calibration, and peak memory of this process."""
    robot, measured = measured_robot()
    seconds: list[float] = []
    results: list[CalibrationResult] = []
    for _ in range(2):
        forget_starts()
        begin = time.perf_counter()
        done = calibrate(
            robot.model,
            robot.space,
            measured,
            noise="stated",
            starts=1,
            intervals=None,
        )
        results.append(done)
        seconds.append(time.perf_counter() - begin)
    return {
        "seconds_calibration": seconds[1],
        "seconds_first_calibration": seconds[0],
        "calibration_steps": len(results[1].history) - 1,
        "calibration_converged": int(results[1].converged),
        "parameters": len(robot.space.names),
        "nodes": robot.model.mesh.n_nodes,
        "degrees_of_freedom": robot.model.n_dof,
        "peak_memory_gb": peak_bytes() / 1e9,
    }


def control_figures() -> dict[str, Figure]:
    """Time of an inverse step, in Newton iterations."""
    robot = parallel_robot(size=SIZE, setup=None)
    at_work = robot.configurations[0]
    newton_s, start, goal = _newton_iteration(robot)
    solve = lambda: _timed_inverse(robot, at_work, start, goal)
    solve()
    runs = [solve() for _ in range(REPEATS)]
    result = runs[0][1]
    steps, newton_steps = len(result.steps), sum(s.newton_steps for s in result.steps)
    whole = statistics.median(seconds for seconds, _ in runs) / newton_s
    return {
        "inverse_step_over_newton_iteration": (whole - newton_steps) / steps,
        "whole_inverse_step_over_newton_iteration": whole / steps,
        "inverse_steps": steps,
        "inverse_newton_steps": newton_steps,
        "inverse_met": int(result.met),
        "newton_iteration_ms": 1e3 * newton_s,
    }


def _timed_inverse(robot: ParallelRobot, at_work, start, goal):
    begin = time.perf_counter()
    # One descent, whose steps are counted.
    direct = ControlSettings(other_starts=0)
    result = solve_inverse(
        robot.model, at_work, goals=goal, guess=start, settings=direct
    )
    jax.block_until_ready(result.solution.displacement)
    return time.perf_counter() - begin, result


def _newton_iteration(robot: ParallelRobot):
    """Time of an iteration, the equilibrium at work, and the goal as a pose."""
    target = posed(robot.geometry, "goal", GOAL_ANGLES, std=1e-3, std_angle=1e-2)
    lanes = configuration_arrays(
        robot.model.mesh,
        [robot.configurations[0], target],
        robot.model.mechanism,
    )
    one, other = (jax.tree.map(lambda leaf, i=i: leaf[i], lanes) for i in (0, 1))
    solve = eqx.filter_jit(solve_equilibrium)
    at_work = solve(robot.model, one)
    there = solve(robot.model, other, guess=at_work.displacement)
    seconds = []
    for _ in range(2 * REPEATS):
        begin = time.perf_counter()
        there = jax.block_until_ready(
            solve(robot.model, other, guess=at_work.displacement)
        )
        seconds.append((time.perf_counter() - begin) / int(there.steps))
    values = effector_values(robot.model, other, there.displacement)
    (rod,) = robot.configurations[0].effectors
    goal = {rod.name: _pose_of(rod, np.asarray(values), robot)}
    return statistics.median(seconds), at_work.displacement, goal


def _pose_of(rod: AbstractEffector, values: HostArray, robot: ParallelRobot) -> Pose:
    read = rod.measured_as(values, robot.model.mechanism)
    assert isinstance(read, BodyFrame)
    assert read.measured is not None
    return read.measured


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    print(json.dumps(calibration_figures()))
