"""The values of one robot asked of another, by `softcal transfer`."""

import json

import numpy as np
import pytest
from small_project import E_TRUE, write_small_project
from wording import says

from softcal_jax.cli import main
from softcal_jax.inference import Difference
from softcal_jax.results import Transfer, plain

QUICK = (
    "[shared]\n",
    '[settings]\nintervals = 0\nnoise = "stated"\n\n'
    "[uncertain]\nmesh = 0\nrecordings = 0\nclamp = 0\n\n[shared]\n",
)
"""Standard errors by the noise, and no intervals by profile likelihood."""


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """A calibration of the small project."""
    folder = tmp_path_factory.mktemp("a")
    path = write_small_project(folder, QUICK)
    assert main(["calibrate", str(path), "-o", str(folder / "out"), "-q"]) == 0
    return folder / "out"


def asked(results, path, capsys):
    capsys.readouterr()
    assert main(["transfer", str(results), str(path), "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def test_the_same_robot_agrees_with_itself(results, tmp_path, capsys):
    path = write_small_project(tmp_path, QUICK)
    found = asked(results, path, capsys)
    assert found["agree"]
    assert found["difference"]["names"] == ["E"]
    assert found["difference"]["of_b"] == pytest.approx([E_TRUE], rel=1e-3)
    assert found["poses"] == ["weight", "pulled"]
    np.testing.assert_allclose(found["rms_of_a"], found["rms_own"], atol=1e-9)
    # Frames and displacements are known to 0.2 mm; so far both may be off.
    assert max(found["rms_own"]) < 2e-4


def test_a_robot_under_another_load_than_stated_does_not(results, tmp_path, capsys):
    """Twice the density, and so twice the modulus."""
    heavier = ('density = "1 g/cm^3"', 'density = "2 g/cm^3"')
    path = write_small_project(tmp_path, QUICK, heavier)
    found = asked(results, path, capsys)
    assert not found["agree"]
    d = found["difference"]
    variance = d["std_a"][0] ** 2 + d["std_b"][0] ** 2
    apart = d["of_b"][0] - d["of_a"][0]
    assert apart == pytest.approx(E_TRUE, rel=0.05)
    assert d["worst"] == pytest.approx([apart], rel=0.5)
    assert d["chi_squared"] > 0.2 * apart**2 / variance
    assert found["rms_of_a"][0] > 5.0 * found["rms_own"][0]
    assert says(found["verdict"], "do not agree", "E by", "standard errors")


def test_other_parameters_follow_the_values_of_the_first(results, tmp_path, capsys):
    """A load is stated as half of what acts; its factor makes up for it."""
    half = ('force = "(20, 0, -50) mN"', 'force = "(10, 0, -25) mN"')
    fitted = ('role = "validation"\n', "")
    factor = (
        '[markers]\nstd = "0.1 mm"\n',
        '[[setup]]\nload_factor = true\nlimit = 4.0\n\n[markers]\nstd = "0.1 mm"\n',
    )
    path = write_small_project(tmp_path, QUICK, half, fitted, factor)
    found = asked(results, path, capsys)
    assert found["difference"]["names"] == ["E"]
    assert found["agree"]
    np.testing.assert_allclose(found["rms_of_a"], found["rms_own"], atol=1e-5)


def test_a_robot_that_contradicts_its_own_data_agrees_with_none(
    results, tmp_path, capsys
):
    """Gravity 30 degrees from where it pulled: as B, then from the file as A."""
    tilted = ('"(0, 0, -9.81) m/s^2"', '"(0, 4.9, -8.5) m/s^2"')
    sure = ('[markers]\nstd = "0.1 mm"', '[markers]\nstd = "0.02 mm"')
    path = write_small_project(tmp_path, QUICK, tilted, sure)
    found = asked(results, path, capsys)
    assert not found["agree"]
    assert found["difference"]["contradicted"] == ["B"]
    assert says(found["verdict"], "contradicts the data of B:", "loads and shape")
    main(["calibrate", str(path), "-o", str(tmp_path / "out"), "-q"])
    found = asked(tmp_path / "out", path, capsys)
    assert found["difference"]["contradicted"] == ["A", "B"]


def test_robots_that_share_no_parameter(results, tmp_path, capsys):
    path = write_small_project(
        tmp_path, QUICK, ('field = "E"\n', 'field = "E"\nname = "modulus"\n')
    )
    assert main(["transfer", str(results), str(path), "-q"]) == 2
    assert says(capsys.readouterr().err, "no parameter of the material", "modulus")


def test_poses_that_the_values_of_the_first_do_not_carry_are_named():
    one = np.ones(1)
    found = Transfer(
        difference=Difference(
            ("E",),
            ("Pa",),
            1e5 * one,
            2e5 * one,
            1e3 * one,
            1e3 * one,
            1e4,
            1,
            one,
            100.0,
            (),
        ),
        poses=("low", "high"),
        motion=np.array([1e-3, np.nan]),
        rms_own=np.array([1e-4, 2e-4]),
        rms_of_a=np.array([1.1e-3, np.nan]),
        lost=("high",),
    )
    assert says(found, "no equilibrium was found for high ... high - 0.2 mm -")
    assert plain(found)["lost"] == ["high"]
    assert plain(found)["rms_of_a"] == [1.1e-3, None]
