"""The file of a checkpoint belongs to one robot and version, and is not edited."""

import jax
import numpy as np
import pytest

from softcal_jax.actuators import Cable
from softcal_jax.calibration import CalibrationSettings, _checkpoint, build_problem
from softcal_jax.calibration._checkpoint import Journal
from softcal_jax.configurations import Configuration, Markers
from softcal_jax.equilibrium import build_model
from softcal_jax.fields import Parameter
from softcal_jax.materials import NeoHookean
from softcal_jax.mesh import beam as beam_mesh

MESH = beam_mesh(0.1, 0.02, 0.02, (1, 1, 1), order=2)
STATE = np.ones(2), np.arange(3.0)


def journal(path, guide=0.02, **options):
    """The checkpoint of a beam that a cable pulls, whose modulus is calibrated."""
    cable = Cable("cable", [(0.0, 0.01, 0.02), (0.1, 0.01, guide)])
    law = NeoHookean(3e5, 0.3)
    model = build_model(MESH, law, density=1e3, actuators=[cable], **options)
    tip = Markers(["tip"], [(0.1, 0.01, 0.01)])
    pose = Configuration("pose", "x_min", markers=tip, measured=tip.positions)
    E = Parameter("E", "E", 3e5, 1e5, 1e6)
    problem = build_problem(model, E, pose)
    return Journal(problem, CalibrationSettings(), path, search=())


def saved(folder):
    """The checkpoint of that beam, with a state of two arrays."""
    path = folder / "fit.npz"
    with journal(path) as first:
        first.keep("state", STATE)
    return path


@pytest.mark.parametrize(
    "changed",
    [{"guide": 0.015}, {"formulation": "mean-dilatation"}, {"solver": "klu"}],
)
def test_checkpoint_of_another_robot_is_refused(tmp_path, changed):
    """The mesh, the law, the configurations and what was measured are the same."""
    path = saved(tmp_path)
    with journal(path) as again:
        kept = again.kept("state", jax.tree.map(np.zeros_like, STATE))
    for ours, theirs in zip(kept, STATE, strict=True):
        np.testing.assert_array_equal(ours, theirs)
    with (
        pytest.raises(ValueError, match=r"fit\.npz .*another calibration"),
        journal(path, **changed),
    ):
        pass


def test_a_checkpoint_names_the_version_that_wrote_it(tmp_path, monkeypatch):
    path = saved(tmp_path)
    monkeypatch.setattr(_checkpoint, "version", lambda name: "9.0")
    message = r"fit\.npz.*softcal_jax .*9\.0.*remove"
    with pytest.raises(ValueError, match=message), journal(path):
        pass


def edited_array(content):
    content["state_0"] = content["state_0"] + 1e-9


def edited_history(content):
    content["history"] = np.array("[ ]")


def without_an_array(content):
    del content["state_1"]


def of_another_kind(content):
    content["state_0"] = np.array("seven")


@pytest.mark.parametrize(
    ("edit", "key"),
    [
        (edited_array, "state_0"),
        (edited_history, "history"),
        (without_an_array, "state_1"),
        (of_another_kind, "state_0"),
    ],
)
def test_a_checkpoint_that_was_edited_is_refused_and_kept(tmp_path, edit, key):
    path = saved(tmp_path)
    changed = edit_saved(path, edit)
    message = rf"fit\.npz.*: {key} differ"
    with pytest.raises(ValueError, match=message), journal(path):
        pass
    assert path.read_bytes() == changed


def edit_saved(path, edit):
    """Edit what a checkpoint holds, and return its new bytes."""
    with np.load(path) as file:
        content = {name: file[name] for name in file.files}
    edit(content)
    np.savez(path, **content)
    return path.read_bytes()


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("history", "[" * 100_000),
        ("history", '[{"lambda_p": 3}]'),
        ("history", "[7]"),
        ("history", "{}["),
        ("digests", "[1, 2]"),
        ("digests", "null"),
    ],
)
def test_a_checkpoint_whose_texts_are_nonsense_is_refused(tmp_path, value, name):
    path = saved(tmp_path)
    edit_saved(path, lambda content: content.update({name: np.array(value)}))
    message = r"fit\.npz .*not a checkpoint.*give another"
    with pytest.raises(ValueError, match=message), journal(path):
        pass


def text(path):
    path.write_text("E_t = 7e5\n")


def empty(path):
    path.write_bytes(b"")


def truncated(path):
    path.write_bytes(path.read_bytes()[:-40])


def flipped(path):
    content = bytearray(path.read_bytes())
    content[200] ^= 0xFF
    path.write_bytes(bytes(content))


def other_arrays(path):
    with path.open("wb") as file:
        np.savez(file, z=np.zeros(6))


def one_array(path):
    with path.open("wb") as file:
        np.save(file, np.zeros(6))


def test_a_checkpoint_of_another_development_version_is_refused(tmp_path):
    """Its arrays are others, though the number of the version is the same."""
    path = saved(tmp_path)
    a, b = STATE
    for other in ((a, b, b), (a, np.zeros(4)), (a, b.astype(int))):
        with (
            journal(path) as again,
            pytest.raises(ValueError, match=r"fit\.npz.*another version"),
        ):
            again.kept("state", other)


@pytest.mark.parametrize(
    "damage", [text, empty, truncated, flipped, other_arrays, one_array]
)
def test_a_file_that_is_no_checkpoint_is_refused_and_kept(tmp_path, damage):
    path = saved(tmp_path)
    damage(path)
    before = path.read_bytes()
    message = r"fit\.npz is not a checkpoint"
    with pytest.raises(ValueError, match=message), journal(path):
        pass
    assert path.read_bytes() == before
    assert [file.name for file in tmp_path.iterdir()] == ["fit.npz"]
