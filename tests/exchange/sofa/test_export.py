"""The command: a calibration again for SOFA, its scene, and what both models say."""

import dataclasses
import json
import re

import jax.numpy as jnp
import numpy as np
import pytest
from anisotropic_project import write_measured_project
from scene_equilibrium import solve
from small_project import write_small_project
from wording import says

import softcal_jax as sc
from benchmarks._sofa import run
from softcal_jax.calibration import CalibrationSettings
from softcal_jax.cli import main
from softcal_jax.exchange.sofa import NotConvergedError, export_sofa
from softcal_jax.project import load_project
from softcal_jax.results import _write, load_result, write_results

pytestmark = pytest.mark.slow

QUICK = (
    '[markers]\nstd = "0.1 mm"\n',
    '[settings]\nintervals = 0\n\n[markers]\nstd = "0.1 mm"\n',
)
QUADRATIC = ('element = "linear"\n', "")
COROTATIONAL = ('law = "neo-hookean"', 'law = "corotational"')


@pytest.fixture(scope="module")
def no_pictures():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(_write, "rendering_problem", lambda: "no pictures")
        yield


@pytest.fixture(scope="module")
def results(tmp_path_factory, no_pictures):
    """Results of the small project with quadratic tets, and with linear ones."""
    folder = tmp_path_factory.mktemp("sofa")
    changes = {"quadratic": (QUICK, QUADRATIC, COROTATIONAL), "linear": (QUICK,)}
    for name, edits in changes.items():
        path = write_small_project(folder / f"{name}_project", *edits)
        with pytest.warns(_write.PictureWarning):
            write_results(load_project(path).calibrate(), folder / name)
    return folder


def test_the_command_calibrates_again_for_the_linear_mesh(results, tmp_path, capsys):
    scene = tmp_path / "scene"
    assert main(["export", "sofa", str(results / "quadratic"), "-o", str(scene)]) == 0
    said = capsys.readouterr().out
    assert "E: " in said
    assert says(said, "calibrating ... SOFA")
    assert re.search(r"^step 1 .*  E = \d+\.\d\d kPa$", said, re.MULTILINE)
    lines = said.split("\n")
    head = next(line for line in lines if line.split()[:1] == ["configuration"])
    assert head.endswith("SOFA, own values")
    (pulled,) = (line for line in lines if line.split()[:1] == ["pulled"])
    assert len(re.findall(r" \d+(?:\.\d+)? mm", pulled)) == 4
    data = json.loads((scene / "robot.json").read_text())
    calibrated = load_result(results / "quadratic").values["E"]
    (E,) = data["elasticity"]["data"]["youngModulus"]
    # Linear tets lock, so the modulus that makes up for it is lower; in kPa.
    assert 0.3 < 1e3 * E / calibrated < 0.9
    readme = (scene / "README.md").read_text()
    assert pulled in readme.split("\n")
    _, calibrated, copied, refit = map(float, re.findall(r" (\d+\.?\d*) mm", pulled))
    assert refit < 0.5 * copied
    assert refit < 3.0 * calibrated + 0.05
    for name, pose in data["configurations"].items():
        root, monitor = run(scene, "v26.06", name=name)
        x, _ = solve(root)
        monitor.state.position.value = x.tolist()
        predicted = np.array([effector["predicted"] for effector in pose["effectors"]])
        np.testing.assert_allclose(monitor.positions(), predicted, rtol=0, atol=1e-6)


def test_a_rubber_keeps_its_law_or_takes_corotational_tets(results, tmp_path):
    same = export_sofa(results / "linear", tmp_path / "same", release="v25.12")
    assert same.component == "TetrahedronHyperelasticityFEMForceField"
    # The same mesh and law, so the same value.
    calibrated = load_result(results / "linear").values["E"]
    np.testing.assert_allclose(same.result.value("E"), calibrated, rtol=1e-4)
    other = export_sofa(
        results / "linear", tmp_path / "other", law="corotational", units="SI"
    )
    assert other.component == "TetrahedronFEMForceField"
    text = (tmp_path / "other" / "README.md").read_text()
    assert other.lines[0].startswith("E: ")
    assert other.lines[0] in text
    with pytest.raises(FileExistsError, match="is not empty"):
        export_sofa(results / "linear", tmp_path / "other")


def test_a_rigid_body_is_refused_before_a_calibration_begins(results, tmp_path):
    loaded = load_result(results / "linear")
    model = loaded.project.model
    plate = [sc.RigidBody("plate", "x_max")]
    model = sc.build_model(model.mesh, model.law, density=1000.0, bodies=plate)
    project, steps = dataclasses.replace(loaded.project, model=model), []
    loaded = dataclasses.replace(loaded, project=project)
    with pytest.raises(ValueError, match=r"rigid bodies \(plate\)"):
        export_sofa(loaded, tmp_path / "scene", watch=steps.append)
    assert steps == []
    assert not (tmp_path / "scene").exists()


def test_nothing_is_written_without_convergence(results, tmp_path):
    loaded = load_result(results / "linear")
    hurried = dataclasses.replace(
        loaded.project, settings=CalibrationSettings(max_steps=1)
    )
    halved = loaded.estimate._replace(z=loaded.z + jnp.log(0.5))
    loaded = dataclasses.replace(loaded, project=hurried, estimate=halved)
    with pytest.raises(NotConvergedError, match=r"not converge .* 1 steps"):
        export_sofa(loaded, tmp_path / "scene", law="corotational")
    assert not (tmp_path / "scene").exists()


def test_a_beam_with_a_fibre_takes_what_the_plugin_computes(tmp_path, no_pictures):
    """Its E_t at two control points; E_l and the angle are known here."""
    path = write_measured_project(tmp_path / "robot")
    text = path.read_text()
    first, last = text.index('[[parameters]]\nfield = "E_l"'), text.index("[markers]\n")
    path.write_text(text[:first] + "[settings]\nintervals = 0\n\n" + text[last:])
    with pytest.warns(_write.PictureWarning):
        write_results(load_project(path).calibrate(), tmp_path / "results")
    exported = export_sofa(tmp_path / "results", tmp_path / "scene")
    assert exported.component == "TetrahedronAnisotropicForceField"
    assert says(exported.lines[-1], "E_t ... C13 ... no material constants")
    readme = (tmp_path / "scene" / "README.md").read_text()
    assert says(readme, "built from source ... -l Anisotropy")
    root, monitor = run(tmp_path / "scene", "v26.06")
    x, X = solve(root)
    monitor.state.position.value = x.tolist()
    predicted = [effector["predicted"] for effector in monitor.effectors]
    off = np.abs(np.array(monitor.positions()) - predicted).max()
    assert off < 1e-6 * np.abs(x - X).max()
