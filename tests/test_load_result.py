"""Results that are loaded again: the same model, or an error that says why not."""

import dataclasses
import json
import math
import shutil

import jax.numpy as jnp
import numpy as np
import pytest
from export.handmade import make_result
from small_project import write_small_project
from wording import says

import softcal_jax as sc
from softcal_jax.cli import main
from softcal_jax.exchange.icesl import _export, _settings
from softcal_jax.fields import ParameterSpace, load_factor
from softcal_jax.mesh import mesh_files
from softcal_jax.project import load_project
from softcal_jax.results import (
    ResultError,
    ResultWarning,
    _write,
    load_result,
    write_results,
)

QUICK = (
    '[markers]\nstd = "0.1 mm"\n',
    '[settings]\nintervals = 0\n\n[markers]\nstd = "0.1 mm"\n',
)


@pytest.fixture(scope="module")
def calibrated(tmp_path_factory):
    """A calibration of the small project, and its folder."""
    folder = tmp_path_factory.mktemp("calibrated")
    path = write_small_project(folder / "robot", QUICK)
    result = load_project(path).calibrate()
    return folder, result


@pytest.fixture
def folder(calibrated, tmp_path, monkeypatch):
    """A copy of the project, with results of the calibration beside it."""
    source, result = calibrated
    monkeypatch.setattr(_write, "rendering_problem", lambda: "no pictures")
    shutil.copytree(source / "robot", tmp_path / "robot")
    return _written(tmp_path, result)


def _written(folder, result):
    source = load_project(folder / "robot" / "project.toml").source
    result = dataclasses.replace(result, source=source)
    with pytest.warns(_write.PictureWarning):
        write_results(result, folder / "out")
    return folder


def test_the_model_comes_back(folder, calibrated):
    result = calibrated[1]
    loaded = sc.load_result(folder / "out" / "result.json")
    assert loaded.content["converged"]
    assert loaded.values == {"E": result.value("E")}
    np.testing.assert_allclose(loaded.z, result.z, rtol=1e-14)
    np.testing.assert_array_equal(loaded.estimate.covariance, result.budget.covariance)
    assert loaded.space.names == ["E"]
    np.testing.assert_allclose(loaded.model.law.E, result.value("E"), rtol=1e-14)
    # The project keeps the start values.
    np.testing.assert_allclose(loaded.project.model.law.E, 200e3)
    np.testing.assert_array_equal(loaded.model.mesh.points, result.model.mesh.points)


def test_a_folder_stands_for_its_file(folder, monkeypatch):
    monkeypatch.chdir(folder)
    assert load_result("out").values == load_result("out/result.json").values


def test_source_names_files_with_what_sha256sum_says(folder):
    data = json.loads((folder / "out" / "result.json").read_text())["source"]
    assert data["project"]["file"] == "../robot/project.toml"
    assert [entry["file"] for entry in data["files"]] == ["markers.csv"]
    # Of the recordings in `small_project`, by the program sha256sum.
    digest = "339d0ebea340"
    assert data["files"][0]["sha256"].startswith(digest)
    assert data["changes"] == {}


def test_both_folders_may_move_together(folder, tmp_path):
    (tmp_path / "new").mkdir()
    for name in ("robot", "out"):
        shutil.move(folder / name, tmp_path / "new" / name)
    assert load_result(tmp_path / "new" / "out").content["converged"]


def test_a_project_that_moved_alone(folder, tmp_path):
    shutil.move(folder / "robot", tmp_path / "elsewhere")
    with pytest.raises(ResultError, match=r"(?s)project\.toml is missing.*project="):
        load_result(folder / "out")
    moved = tmp_path / "elsewhere" / "project.toml"
    assert load_result(folder / "out", project=moved).project.path == moved


def test_a_file_that_changed_is_named(folder):
    file = folder / "robot" / "markers.csv"
    file.write_text(file.read_text().replace("441.464711016", "441.5"))
    with pytest.raises(ResultError) as caught:
        load_result(folder / "out")
    text = str(caught.value)
    assert f"{file} has changed: " in text
    assert "339d0ebea340" in text
    assert "project.toml has changed" not in text
    assert "calibrate again" in text


def test_all_that_is_wrong_is_named(folder):
    (folder / "robot" / "markers.csv").rename(folder / "robot" / "marker.csv")
    project = folder / "robot" / "project.toml"
    project.write_text(project.read_text() + "\n# a comment\n")
    with pytest.raises(ResultError) as caught:
        load_result(folder / "out")
    text = str(caught.value)
    assert "project.toml has changed" in text
    assert says(text, "markers.csv is missing ... mean 'marker.csv'")


def test_changes_of_the_file_are_made_again(folder, calibrated):
    """A project that was loaded with other values is not what the file says."""
    path = folder / "robot" / "project.toml"
    changed = load_project(path, changes={"material.nu": 0.35, "settings.seed": None})
    result = dataclasses.replace(calibrated[1], source=changed.source)
    with pytest.warns(_write.PictureWarning):
        write_results(result, folder / "changed")
    loaded = load_result(folder / "changed")
    assert float(loaded.model.law.nu) == 0.35


def test_one_that_did_not_converge_says_so(folder, calibrated, capsys):
    result = dataclasses.replace(
        calibrated[1], source=load_result(folder / "out").project.source
    )
    with pytest.warns(_write.PictureWarning):
        write_results(dataclasses.replace(result, converged=False), folder / "early")
    with pytest.warns(ResultWarning, match=r"early.*not converge"):
        loaded = load_result(folder / "early")
    assert not loaded.content["converged"]
    argv = ["export", "inp", str(folder / "early"), "-o", str(folder / "job.inp")]
    assert main([*argv, "--configuration", "weight"]) == 0
    text = capsys.readouterr().out
    assert says(text, f"warning: {folder / 'early' / 'result.json'} ... not converge")


def test_what_the_calibration_doubts_is_said_by_exports(folder, capsys):
    path = folder / "out" / "result.json"
    reasons = json.loads(path.read_text())["assessment"]["reasons"]
    assert reasons
    argv = ["export", "inp", str(path), "-o", str(folder / "doubted.inp")]
    assert main([*argv, "--configuration", "weight"]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert says(said, f"with care: {reasons[0]}")


def test_made_in_python(tmp_path, monkeypatch):
    monkeypatch.setattr(_write, "rendering_problem", lambda: "no pictures")
    with pytest.warns(_write.PictureWarning):
        write_results(make_result(), tmp_path / "out")
    assert json.loads((tmp_path / "out" / "result.json").read_text())["source"] is None
    with pytest.raises(ResultError, match="made in Python"):
        load_result(tmp_path / "out")


def edited(folder, change):
    path = folder / "out" / "result.json"
    data = json.loads(path.read_text())
    change(data)
    path.write_text(json.dumps(data))
    return path


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: d.pop("source"), r"source: Field required"),
        (lambda d: d.update(format="softcal_jax.result/1"), "format is 'softcal_jax.r"),
        (lambda d: d.update(format="softcal_jax.simulation/1"), "softcal_jax.simula"),
        (lambda d: d.pop("format"), "format is None"),
        (lambda d: d["parameters"][0].update(value=None), r"parameters\.0\.value: "),
        (lambda d: d["parameters"][0].update(value=math.nan), "value of E is nan"),
        (lambda d: d["parameters"][0].update(value=-3e5), "value of E is -3"),
        (lambda d: d["parameters"][0].update(name="G"), "parameters were G and are E"),
        (
            lambda d: (d["parameters"].clear(), d["budget"].update(covariance=[])),
            "parameters were none and are E",
        ),
        (lambda d: d["solver"].update(n_tets=7), "n_tets was 7 and is 18"),
        (lambda d: d.update(converged="true"), "converged is 'true', expected a bool"),
        (lambda d: d["assessment"].update(reasons="no"), "reasons is 'no'.* a list"),
        (lambda d: d["assessment"].update(reasons=[1]), "reasons is 1, expected a str"),
        (lambda d: d["assessment"].update(contradicted=0), "contradicted is 0"),
    ],
)
def test_what_is_no_result(folder, change, message):
    with pytest.raises(ResultError, match=message):
        load_result(edited(folder, change))


def test_files_that_cannot_be_read(tmp_path):
    (tmp_path / "result.json").write_text("{")
    with pytest.raises(ResultError, match=r"result\.json"):
        load_result(tmp_path)
    (tmp_path / "result.json").write_bytes(b"\xff\xfe")
    with pytest.raises(ResultError, match="codec"):
        load_result(tmp_path / "result.json")
    with pytest.raises(FileNotFoundError, match=r"result file .*nothing\.json"):
        load_result(tmp_path / "nothing.json")


def test_a_configuration_with_calibrated_loads(folder):
    """Factors of the setup are in its arrays; a name is needed where there are two."""
    loaded = load_result(folder / "out")
    with pytest.raises(ValueError, match="configurations 'weight' and 'pulled'"):
        loaded.posed()
    with pytest.raises(ValueError, match=r"unknown configuration 'pull'.*'pulled'"):
        loaded.posed("pull")
    configuration, arrays = loaded.posed("pulled")
    assert configuration.name == "pulled"
    total = np.asarray(arrays.dead_loads).sum(axis=0)
    np.testing.assert_allclose(total, [0.02, 0.0, -0.05], atol=1e-15)
    # As if the load had been calibrated as well, to 1.2 times what is stated.
    more = ParameterSpace((*loaded.space.entries, load_factor(prior_std=0.1)))
    z = more.to_scaled(jnp.array([loaded.values["E"], 1.2]))
    two = loaded.estimate._replace(space=more, z=z)
    heavier = dataclasses.replace(loaded, estimate=two).posed("pulled")[1]
    total = np.asarray(heavier.dead_loads).sum(axis=0)
    np.testing.assert_allclose(total, [0.024, 0.0, -0.06], atol=1e-15)


def test_included_files_of_a_mesh_belong_to_it(tmp_path):
    (tmp_path / "nodes.inp").write_text("*NODE\n1, 0., 0., 0.\n")
    (tmp_path / "body.inp").write_text("*INCLUDE, INPUT=nodes.inp\n")
    files = mesh_files(tmp_path / "body.inp")
    assert [path.name for path in files] == ["body.inp", "nodes.inp"]


def test_export_of_an_input_file(folder, capsys):
    """The calibrated modulus is in it; nothing is replaced unasked."""
    job = folder / "job.inp"
    argv = ["export", "inp", str(folder / "out"), "-o", str(job)]
    assert main(argv) == 2
    assert says(capsys.readouterr().err, "configurations 'weight' and 'pulled'")
    assert main([*argv, "--configuration", "pulled"]) == 0
    text, errors = capsys.readouterr()
    assert errors == ""
    assert says(text, "NEO HOOKE ... volume")
    assert f"Wrote {job}." in text
    lines = job.read_text().splitlines()
    assert lines[1] == "small: pulled"
    C10 = float(lines[lines.index("*HYPERELASTIC, NEO HOOKE") + 1].split(",")[0])
    E = sc.load_result(folder / "out").values["E"]
    np.testing.assert_allclose(C10, E / 2.6 / 2)

    assert main([*argv, "--configuration", "weight"]) == 2
    assert "job.inp exists already" in capsys.readouterr().err
    assert main([*argv, "--configuration", "weight", "--force"]) == 0
    assert job.read_text().splitlines()[1] == "small: weight"
    argv[-1] = str(folder / "none" / "job.inp")
    assert main([*argv, "--configuration", "weight"]) == 2
    assert "make it, or give a file in another one" in capsys.readouterr().err


def test_export_without_a_format(capsys):
    with pytest.raises(SystemExit):
        main(["export"])
    assert "FORMAT" in capsys.readouterr().err


def test_export_of_what_has_changed(folder, capsys):
    """A changed file is bad input; the text is that of the library."""
    (folder / "robot" / "markers.csv").write_text("")
    job = folder / "job.inp"
    argv = ["export", "inp", str(folder / "out"), "-o", str(job)]
    assert main([*argv, "--configuration", "weight"]) == 2
    assert "markers.csv has changed" in capsys.readouterr().err
    assert not job.exists()


@pytest.fixture
def coarse(monkeypatch):
    """Fewer voxels of foam than the slicer takes."""
    for module in (_export, _settings):
        monkeypatch.setattr(module, "N_VOXELS", 8)


@pytest.mark.usefixtures("coarse")
def test_a_loaded_modulus_as_foam(folder, calibrated, capsys, monkeypatch):
    """Isotropic: the density whose published modulus is the calibrated one."""
    monkeypatch.chdir(folder)
    assert main(["export", "icesl", "out", "-o", "print"]) == 0
    said = capsys.readouterr().out
    assert "Wrote print." in said
    about = json.loads((folder / "print" / "icesl.json").read_text())
    settings = {setting["name"]: setting["constant"] for setting in about["settings"]}
    E = calibrated[1].value("E") / 12e6
    # Between the first two published samples E is a power of the density.
    power = np.log(0.0436 / 0.0247) / np.log(0.1534 / 0.0901)
    density = 0.0901 * (E / 0.0247) ** (1.0 / power)
    np.testing.assert_allclose(settings["infill_percentage"], 100 * density, rtol=0.02)
    np.testing.assert_allclose(settings["kgon_x_shrink"], 1.0, rtol=1e-6)
    assert main(["export", "icesl", "out", "-o", "print"]) == 2
    assert says(capsys.readouterr().err, "print is not empty")


@pytest.mark.usefixtures("coarse")
def test_a_project_file_as_foam(folder, capsys, monkeypatch):
    """Its start values are a design: 200 kPa is softer than any foam of the table."""
    monkeypatch.chdir(folder)
    options = ["--solid-modulus", "24 MPa", "--angle-offset", "90 deg", "--clockwise"]
    options += ["--plane", "xz", "--angle-marks", "stiff"]
    where = ["robot/project.toml", "-o", "print"]
    assert main(["export", "icesl", *where, *options]) == 0
    said = capsys.readouterr().out
    assert says(said, "100 % ... moduli ... foam")
    about = json.loads((folder / "print" / "icesl.json").read_text())
    assert about["angle"] == {"marks": "stiff", "offset_deg": 90.0, "clockwise": True}
    assert about["bed"]["size_mm"] == pytest.approx([60.0, 20.0, 20.0])
    assert about["bed"]["rotation"][2] == [0.0, -1.0, 0.0]
    assert main(["export", "icesl", *where, "--force", "--infill", "phasor"]) == 2
    assert says(capsys.readouterr().err, "no moduli of Phasor")
    both = ["--table", "foam.csv", "--solid-modulus", "1 MPa", "--force"]
    assert main(["export", "icesl", *where, *both]) == 2
    assert says(capsys.readouterr().err, "--solid-modulus", "--table", "Give one")
    assert main(["export", "icesl", *where, "--force", "--angle-offset", "90"]) == 2
    assert "--angle-offset: 90 has no unit" in capsys.readouterr().err
