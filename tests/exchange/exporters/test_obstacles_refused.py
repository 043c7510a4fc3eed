"""No format drops an obstacle silently."""

import pytest
from obstacle_results import beside_obstacles, pressed

from softcal_jax.configurations import configuration_lanes
from softcal_jax.exchange import mujoco
from softcal_jax.exchange.exporters import exporters
from softcal_jax.exchange.icesl import Design, export_icesl
from softcal_jax.exchange.inp import write_inp
from softcal_jax.exchange.sofa._export import check_robot
from softcal_jax.materials import Isotropic, StVenantKirchhoff

REFUSED = (
    r"obstacles \(probe, table\), and contact is not written to {}\. Take them out"
)


@pytest.fixture(scope="module")
def model():
    return beside_obstacles(StVenantKirchhoff(Isotropic(2e5, 0.4)))


def test_programs_refuse_them(model, tmp_path):
    posed = pressed(model).posed
    lane = configuration_lanes(model.mesh, [posed], model.mechanism).arrays[0]
    with pytest.raises(ValueError, match=REFUSED.format("a .inp file")):
        write_inp(tmp_path / "a.inp", model, lane)
    with pytest.raises(ValueError, match=REFUSED.format("a scene of SOFA")):
        check_robot(model)
    with pytest.raises(ValueError, match=REFUSED.format("a model of MuJoCo")):
        mujoco.check_robot(model)


def test_their_lists_name_them():
    every = exporters()
    for name in ("inp", "sofa", "mujoco"):
        assert "contact with obstacles" in every[name].cannot_hold


def test_a_print_says_that_it_is_the_part_alone(model, tmp_path):
    written = export_icesl(Design(model), tmp_path / "print")
    (note,) = [note for note in written.notes if "obstacles" in note]
    assert note.endswith("without the obstacles: probe, table.")
    assert note in (tmp_path / "print" / "robot.lua").read_text()
