"""The packaged arm of wound silicone, and the plain one that refutes it."""

import numpy as np
import pytest
from scipy.optimize import least_squares

from benchmarks.pneumatic_arm import plain
from softcal_jax.cli import main
from softcal_jax.materials import FibreReinforced
from softcal_jax.project import load_project
from softcal_jax.robots import ready_made_path

pytest.importorskip("ezc3d")

INNER_RADIUS = 22.22 - 2.03
"""Of the outer wall [mm]."""

CHORD = 0.5
"""By which a chord between nodes of the mesh may lie inside its circle [mm]."""

OF_SILICONE, OF_THE_SETUP = ["mu", "J_m"], ["turn x", "turn y", "turn z"]

PULLED = {
    0.1: (11.1, 21.5, 31.7, 42.4, 53.0, 64.7, 76.3, 87.9, 100.1, 113.0),
    1.0: (113.0, 272.8, 444.8, 632.5, 825.4, 1017.3, 1208.0, 1400.4, 1595.5, 1766.8),
}
"""Nominal stress [kPa] at multiples of an elongation, of the README's source."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """What `softcal demo arm --write` writes."""
    folder = tmp_path_factory.mktemp("demo") / "arm"
    assert main(["demo", "arm", "--write", str(folder)]) == 0
    return folder


@pytest.fixture(scope="module")
def project(folder):
    return load_project(folder / "project.toml")


def test_the_demo_writes_all_that_is_packaged(folder, project):
    source = ready_made_path("pneumatic-arm").parent
    for file in (*project.files, folder / "README.md"):
        assert file.read_bytes() == (source / file.name).read_bytes()


def test_poses(project):
    """Held out are two pressures between the fitted ones, and two beyond them."""
    names = lambda poses: [c.name for c in poses]
    assert names(project.calibration) == ["rest", "100 mbar", "200 mbar", "300 mbar"]
    assert names(project.validation) == [f"{p} mbar" for p in (150, 250, 350, 400)]
    # Calibrated base markers leave a millimetre or so of their nominal places.
    assert max(fit.rms for fit in project.registrations.values()) < 3e-3


@pytest.mark.parametrize(
    ("pose", "millimetres"), [("100 mbar", 2.8), ("200 mbar", 7.5), ("300 mbar", 15.3)]
)
def test_motion(project, pose, millimetres):
    """As an independent reading of the recordings found the tip to move."""
    poses = {c.name: c for c in project.configurations}
    moved = poses[pose].measured - poses["rest"].measured
    mean = np.mean(np.linalg.norm(moved, axis=1))
    assert mean == pytest.approx(1e-3 * millimetres, rel=0.05)


def test_body(project):
    """Dimensions of the authors; thread around the axis, in the outer wall alone."""
    mesh, law = project.model.mesh, project.model.law
    low, high = (1e3 * end(mesh.points, axis=0) for end in (np.min, np.max))
    np.testing.assert_allclose(low, [-22.22, -22.22, 0.0], atol=0.05)
    np.testing.assert_allclose(high, [22.22, 22.22, 100.0], atol=0.05)
    assert isinstance(law, FibreReinforced)
    centroids = np.asarray(mesh.centroids)
    radius = 1e3 * np.hypot(centroids[:, 0], centroids[:, 1])
    wound = np.asarray(law.E_f) > 0.0
    assert radius[wound].min() > INNER_RADIUS - CHORD
    assert radius[~wound].max() < INNER_RADIUS
    x, y, z = np.asarray(law.fibre.direction())
    np.testing.assert_allclose(z, 0.0, atol=1e-12)
    along_radius = x * centroids[:, 0] + y * centroids[:, 1]
    np.testing.assert_allclose(along_radius, 0.0, atol=1e-12)


def gent(step, kpa):
    """Fit mu [kPa] and J_m to a pull test, whose stress is closed."""
    stretch = 1.0 + step * np.arange(1, len(kpa) + 1)
    i1 = stretch**2 + 2.0 / stretch - 3.0
    stress = lambda mu, J_m: mu * (stretch - stretch**-2) / (1.0 - i1 / J_m)
    unknown = lambda x: (np.exp(x[0]), i1.max() + np.exp(x[1]))
    fit = least_squares(lambda x: stress(*unknown(x)) - kpa, [4.0, 2.0])
    return unknown(fit.x)


def test_silicone_is_known_from_a_pull_test(project):
    """J_m is that of small or of all strains, and the start of mu that of all."""
    (_, small), (mu, large) = (gent(*test) for test in PULLED.items())
    by_name = {p.name: p for p in project.parameters}
    assert by_name["mu"].start == pytest.approx(1e3 * mu, rel=0.01)
    limit = by_name["J_m"]
    assert limit.start == pytest.approx(np.sqrt(small * large), rel=0.05)
    assert limit.prior_std == pytest.approx(0.5 * np.log(large / small), rel=0.05)


def test_plain_silicone(folder, project):
    """The same file and arm without thread, as the benchmark refutes it."""
    path = folder / "plain.toml"
    path.write_text(plain((folder / "project.toml").read_text()))
    silicone = load_project(path)
    assert type(silicone.model.law) is type(project.model.law.matrix)
    of = lambda p: [parameter.name for parameter in p.parameters]
    assert of(silicone) == [*OF_SILICONE, *OF_THE_SETUP]
    assert of(project) == [*OF_SILICONE, "E_f_wall", *OF_THE_SETUP]
    names = [c.name for c in project.configurations]
    assert [c.name for c in silicone.configurations] == names


def test_plain_silicone_has_nothing_more_to_take_out(folder):
    text = plain((folder / "project.toml").read_text())
    with pytest.raises(RuntimeError, match=r"fibre-reinforced.* not occur"):
        plain(text)
