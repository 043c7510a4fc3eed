"""What the error of the mesh takes beside a fit: `_mesh_error ROBOT`.

Calibrates twice with the error of the mesh as the only one that is considered. Prints
as JSON its time over that of the fit, of the second run, and the peak of the memory at
its end over that at the end of the fit, of the first.
"""

import json
import sys
import time
from dataclasses import replace

import jax

from benchmarks._memory import peak_bytes
from benchmarks._timing import forget_starts

ROBOTS = ("beam", "arm", "robot")
"""Those of `softcal demo`, and the parallel robot on sheets of 3 000 nodes."""


def main() -> None:
    """Calibrate a robot of `ROBOTS` twice, and print."""
    jax.config.update("jax_enable_x64", True)
    from benchmarks.robot_speed import measured_robot
    from softcal_jax import calibrate, robots
    from softcal_jax.calibration import CalibrationResult, Event
    from softcal_jax.fields import exactly_known
    from softcal_jax.project import load_project

    (name,) = sys.argv[1:]
    only_mesh = replace(exactly_known(), mesh=1.0)
    if name == "robot":
        robot, configurations = measured_robot()
        fit = (robot.model, robot.space, configurations)
        options = {"starts": 1, "noise": "stated"}
    else:
        robot_name = {"beam": "beam", "arm": "pneumatic-arm"}[name]
        project = load_project(robots.ready_made_path(robot_name))
        assert project.space is not None
        fit = (project.model, project.space, project.calibration)
        options = {"starts": project.starts, "noise": project.noise}

    def once() -> tuple[float, float]:
        forget_starts()
        fitted: list[tuple[float, int]] = []

        def ended(event: Event) -> None:
            if isinstance(event, CalibrationResult):
                fitted.append((time.perf_counter(), peak_bytes()))

        begin = time.perf_counter()
        calibrate(*fit, uncertain=only_mesh, intervals=None, watch=ended, **options)
        ((until, peak),) = fitted
        spent = (time.perf_counter() - until) / (until - begin)
        return spent, peak_bytes() / peak

    (_, memory), (spent, _) = once(), once()
    print(json.dumps({"over_fit": spent, "memory_over_fit": memory}))


if __name__ == "__main__":
    main()
