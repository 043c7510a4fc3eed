"""An arm on a motor with a cable, forces, a pressure and sensors, as a project file."""

from pathlib import Path

PROJECT = """\
name = "arm"

[mesh]
beam = { size = "(60, 20, 20) mm", cells = [3, 1, 1] }
element = "linear"

[material]
law = "corotational"
E = "300 kPa"
nu = 0.3
density = "1 g/cm^3"

[bodies.arm]
group = "x_min"
origin = "(-5, 10, 10) mm"
hinge = "-y"

[bodies.tip]
group = "x_max"
mass = "10 g"

[actuators.arm]
type = "motor"
body = "arm"

[actuators.left]
type = "cable"
guides = [{ point = "(0, 10, 30) mm", on = "ground" }, "(40, 10, 20) mm"]

[actuators.push]
type = "point-force"
point = "(50, 10, 20) mm"
direction = "-z"

[actuators.spread]
type = "surface-force"
surface = "x_max"
direction = "+z"

[actuators.blow]
type = "surface-pressure"
surface = "z_min"

[effectors.sensor]
type = "frame"
body = "tip"

[effectors.torque]
type = "actuator-force"
actuator = "arm"
std = "1 N*mm"

[shared]
gravity = "(0, 0, -9.81) m/s^2"

[[configurations]]
name = "up"
actuation = { arm = "20 deg", left = "300 mN", push = "200 mN", blow = "300 Pa" }

[[configurations]]
name = "let go"
actuation = { arm = "10 N*mm", left = "1 mm", spread = "-50 mN" }

[[configurations]]
name = "crushed"
actuation = { arm = "10 N*mm", blow = "290 kPa" }

[newton]
max_steps = 20
"""


def write_robot_project(folder: Path) -> Path:
    """Writes the project."""
    path = folder / "project.toml"
    path.write_text(PROJECT)
    return path
