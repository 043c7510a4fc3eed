"""Robots in MuJoCo: is the tip at rest where the model has it?"""

import importlib
import importlib.util
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks._problem import Figure
from softcal_jax.exchange.mujoco import MujocoExport, export_mujoco
from softcal_jax.project import load_project
from softcal_jax.results import write_results
from softcal_jax.robots import ready_made_path

_FRICTIONLESS = {
    **{f"actuators.tendon {k}.friction": None for k in (1, 2)},
    **{f"actuators.tendon {k}.pulled_from": None for k in (1, 2)},
    "setup": [
        {"actuator_factor": ["tendon 1", "tendon 2"], "limit": 1.5, "prior_std": 0.1},
        {"gravity_tilt": True, "limit": "15 deg", "prior_std": "2 deg"},
        {"recording_offset": True, "limit": "30 mm", "prior_std": "10 mm"},
    ],
}
"""The tentacle as MuJoCo can hold it, and without offsets of markers."""

ROBOTS: dict[str, tuple[tuple[str, ...], dict[str, Any]]] = {
    "beam": (("gravity", "load101"), {"mesh.beam.cells": [6, 2, 2]}),
    "tentacle": (("m1u01", "m2u01"), _FRICTIONLESS),
}
"""Ready-made robots, the poses that are kept, and what else differs from their files.
"""

AT_REST = 1e-3
"""Speed at which a body counts as at rest [m/s]; its motion is some centimetres."""


class Tip(NamedTuple):
    """Displacement of the node farthest from the clamp by two programs [m]."""

    model: np.ndarray
    mujoco: np.ndarray

    @property
    def apart(self) -> float:
        """Distance of both over the motion [-]."""
        apart = np.linalg.norm(self.mujoco - self.model)
        return float(apart / np.linalg.norm(self.model))


def run(count: int, say: Callable[[str], None]) -> dict[str, Figure]:
    """Calibrate and export so many robots, and let MuJoCo run them to rest.

    Returns:
        `mujoco_tip_percent`: largest distance of a tip over its motion. Empty where
        MuJoCo is missing.
    """
    if missing():
        say("mujoco: no figures. Install mujoco, of the extra `dev`.")
        return {}
    apart = []
    for robot in list(ROBOTS)[:count]:
        with tempfile.TemporaryDirectory() as folder:
            export = exported(robot, Path(folder))
            for pose in export.files:
                tip = tip_at_rest(Path(folder) / "mujoco", export, pose)
                apart.append(tip.apart)
                motion = 1e3 * np.linalg.norm(tip.model)
                said = f"{100 * tip.apart:.4f} % of {motion:.1f} mm"
                say(f"mujoco: {robot}, {pose}: {said}")
    return {"mujoco_tip_percent": 100 * max(apart)}


def missing() -> bool:
    """Whether MuJoCo is not installed."""
    return importlib.util.find_spec("mujoco") is None


def exported(robot: str, folder: Path) -> MujocoExport:
    """Calibrate a ready-made robot by few poses, and export it to "mujoco".

    Its mesh is coarse and linear, so that markers follow larger patches of it.
    """
    names, changes = ROBOTS[robot]
    ready = ready_made_path(robot)
    shutil.copytree(ready.parent, folder / "robot")
    path = folder / "robot" / ready.name
    head, *poses = path.read_text(encoding="utf-8").split("[[configurations]]\n")
    (settings,) = (text for text in poses if "[settings]" in text)
    kept = [text for text in poses if text.split('"')[1] in names]
    kept = ["[[configurations]]\n" + text.split("\n\n# ")[0] for text in kept]
    parts = [head, *kept, settings[settings.index("[settings]") :]]
    path.write_text("\n\n".join(parts), encoding="utf-8")
    coarse = {"mesh.element": "linear", "markers.base_radius": "20 mm"}
    quick = {"settings.intervals": 0}
    project = load_project(path, changes=changes | coarse | quick)
    write_results(project.calibrate(), folder / "results", pictures=None)
    return export_mujoco(folder / "results", folder / "mujoco")


def tip_at_rest(folder: Path, export: MujocoExport, pose: str) -> Tip:
    """Run an exported robot from its shape without loads to rest in a pose."""
    mujoco: Any = importlib.import_module("mujoco")
    # It tells of each solve of its iterative solver that stops early, in a file.
    mujoco.set_mju_user_warning(lambda text: None)
    model = mujoco.MjModel.from_xml_path(str(folder / export.files[pose]))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key(pose).id)
    data.qpos[:] = 0.0
    mujoco.mj_forward(model, data)
    start = data.flexvert_xpos.copy()
    for _ in range(20):
        for _ in range(500):
            mujoco.mj_step(model, data)
        if np.abs(data.qvel).max() < AT_REST:
            break
    else:
        raise RuntimeError(f"{pose}: no rest in {data.time:.0f} s of MuJoCo.")
    (solved,) = (c for c in export.result.configurations if c.name == pose)
    predicted = np.asarray(solved.displacement)
    far = np.argmax(np.linalg.norm(predicted, axis=1))
    return Tip(predicted[far], data.flexvert_xpos[far] - start[far])
