"""What the mesh does to the modulus of an air finger: as said, and on a finer one.

Readings by FElupe 11.3: 27-node hexahedra with a mixed pressure, E = 320 kPa, nu =
0.499, under gravity with 0, 15, 25, 35 and 45 kPa in a chamber with walls of 3 and 4
mm. The response to weight is too soft on a coarse mesh, that to pressure too stiff.
"""

import shutil
from pathlib import Path

import pytest

from benchmarks._cad_models import modelled
from softcal_jax.project import load_project
from softcal_jax.unknowns import MESH

PROJECT = """
name = "finger"
mesh = { file = "finger.step", size = "%s" }
material = { law = "neo-hookean", E = "320 kPa", nu = 0.499, density = "1070 kg/m^3" }
parameters = [{ field = "E", lower = "10 kPa", upper = "100 MPa" }]
actuators.air = { type = "chamber", surface = "wall" }
settings = { noise = "stated", intervals = 0 }

[groups]
held = { plane = { point = "(0, 7.5, 7.5) mm", normal = "x" }, of = "faces" }
wall = { inside = { point = "(40, 7.5, 10) mm" } }

[markers]
std = "0.3 mm"

[markers.positions]
m30 = "(30, 0, 6) mm"
m45 = "(45, 0, 6) mm"
m60 = "(60, 0, 6) mm"
m75 = "(75, 0, 6) mm"
tip_low = "(80, 7.5, 2) mm"
tip_high = "(80, 7.5, 14) mm"

[shared]
gravity = "(0, 0, -9.81) m/s^2"
supports = [{ group = "held" }]
measured = { file = "finger_by_felupe.csv"%s }

[[configurations]]
name = "rest"
measured.select = { pose = "rest" }

[[configurations]]
name = "15 kPa"
actuation = { air = "15 kPa" }
measured.select = { pose = "15 kPa" }

[[configurations]]
name = "35 kPa"
actuation = { air = "35 kPa" }
measured.select = { pose = "35 kPa" }
"""

ON_2_MM = {"": 316.5, ', displacement_from = "rest"': 309.7}
"""E with tets of 2 mm, from positions and from displacements (ten minutes) [kPa]."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("finger")
    with modelled(folder / "finger.step", None) as shape:
        body = shape.addBox(0, 0, 0, 80, 15, 15)
        shape.cut([(3, body)], [(3, shape.addBox(6, 4, 8, 68, 7, 4))])
    shutil.copy(Path(__file__).with_name("finger_by_felupe.csv"), folder)
    return folder


@pytest.mark.slow
@pytest.mark.parametrize("reference", ON_2_MM)
@pytest.mark.parametrize("size", ["5 mm", "3 mm"])
def test_the_stated_part_is_right_to_a_factor_of_two(folder, size, reference):
    path = folder / "project.toml"
    path.write_text(PROJECT % (size, reference))
    result = load_project(path).calibrate()
    stated = float(result.budget.by_cause()[MESH][0])
    off = 1e3 * ON_2_MM[reference] - result.value("E")
    assert 0.5 < stated / off < 2.0
