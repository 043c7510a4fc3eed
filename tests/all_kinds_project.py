"""Every kind of body, actuator and effector but the chamber, as a project file."""

ALL_KINDS = """\
name = "all kinds"

[mesh]
beam = { size = "(60, 20, 20) mm", cells = [6, 1, 1] }
element = "linear"

[groups.middle]
plane = { point = "(30, 0, 0) mm", normal = [1, 0, 0] }

[material]
law = "corotational"
E = "300 kPa"
nu = 0.3
density = "1 g/cm^3"

[bodies.arm]
group = ["x_min"]
origin = "(-5, 10, 10) mm"
hinge = "-y"
mounting = { translation = "(0, 0, 2) mm" }

[bodies.tip]
group = "x_max"
mass = "10 g"
centre_of_mass = "(65, 10, 10) mm"
axes = [[0, 1, 0], [0, 0, 1], [1, 0, 0]]

[bodies.collar]
group = "middle"
tied_to = "tip"
mounting = { rotation_vector = "(0, 10, 0) deg" }

[actuators.arm]
type = "motor"
body = "arm"

[actuators.left]
type = "cable"
guides = [{ point = "(0, 1, 2) cm", on = "ground" }, "(45, 10, 20) mm"]

[actuators.push]
type = "point-force"
point = "(45, 10, 20) mm"
direction = [0, 0, -2]

[actuators.spread]
type = "surface-force"
surface = "z_max"
direction = "+z"

[actuators.blow]
type = "surface-pressure"
surface = "z_max"

[[parameters]]
field = "E"
lower = "100 kPa"
upper = "1 MPa"
prior_std = 0.3

[[parameters]]
field = "nu"
lower = 0.2
upper = 0.4
prior_std = 0.05

[[setup]]
motor_zero = "arm"
limit = "3 deg"
prior_std = "0.5 deg"

[[setup]]
mounting = ["arm", "collar"]
limit = "2 mm"

[effectors.sensor]
type = "frame"
body = "tip"
std = "0.3 mm"
std_angle = "0.3 deg"

[effectors.bend]
type = "angle"
body = "tip"
other = "arm"
axis = "y"
std = "1 deg"

[effectors.middle]
type = "centroid"
group = "z_max"

[effectors.length]
type = "actuator-displacement"
actuator = "left"
std = "0.1 mm"

[effectors.torque]
type = "actuator-force"
actuator = "arm"
std = "1 N*mm"

[effectors.clamp]
type = "reaction"
group = "x_min"
std = "10 mN"

[shared]
gravity = "(0, 0, -9.81) m/s^2"
actuation = { arm = "20 deg", left = "1 N" }

[[configurations]]
name = "imposed forces"
actuation = { push = "2 mm", spread = "500 mN", blow = "1 kPa" }

[configurations.measured.effectors]
sensor = { position = "(1, 2, 3) mm", azimuth = "10 deg", roll = "-20 deg" }
bend = "5 deg"
middle = "(30, 10, 25) mm"
length = "-1 mm"
torque = "0.02 N*m"
clamp = "(0, 0, 1) N"

[[configurations]]
name = "held"
actuation = { arm = "5 N*mm", left = "1 mm" }
bodies = { tip = { translation = "(0, 0, 5) mm", rotation_vector = "(0, 5, 0) deg" } }
effectors = ["length"]

[[candidates]]
name = "hinged"
bodies = { tip = "hinged" }
"""
