"""The packaged beam: its data are the published averages, and they are in the wheel."""

import numpy as np

from softcal_jax.project import load_project
from softcal_jax.readings import read_markers
from softcal_jax.robots import ready_made_path


def test_files():
    folder = ready_made_path("beam").parent
    assert {"project.toml", "markers.csv", "README.md"} <= {
        path.name for path in folder.iterdir()
    }
    source = (folder / "README.md").read_text()
    assert "srl-ethz/diffPD_sim2real" in source
    assert "MIT licence" in source
    assert "MIT License" in (folder / "LICENSE-recordings.txt").read_text()


def test_figures():
    """One line of the source's table, typed by hand."""
    markers = read_markers(
        ready_made_path("beam").with_name("markers.csv"),
        select={"run": "load101", "phase": "loaded"},
    )
    assert markers.names == ("1", "2", "3", "4", "5", "6")
    np.testing.assert_allclose(
        markers.positions_of(["1"]), [[0.045221, 0.032398, 0.075402]], rtol=1e-12
    )


def test_project():
    """The body and the loads of the paper; registration to about a millimetre."""
    project = load_project(ready_made_path("beam"))
    assert [c.name for c in project.calibration] == ["gravity", "load101"]
    assert [c.name for c in project.validation] == ["load52"]
    mesh = project.model.mesh
    assert mesh.order == 2
    np.testing.assert_allclose(mesh.points.min(axis=0), [-0.1, 0.0, 0.0], atol=1e-15)
    np.testing.assert_allclose(mesh.points.max(axis=0), [0.0, 0.03, 0.03], atol=1e-15)
    pull = project.validation[0].loads[0].nodal_forces(mesh).sum(axis=0)
    np.testing.assert_allclose(pull, [0.0, 0.0, -0.51012], atol=1e-12)
    assert set(project.registrations) == {"gravity", "load101", "load52"}
    for registration in project.registrations.values():
        assert 0.5e-3 < registration.rms < 1.5e-3
    # Down by about 17 mm, as the data's README says.
    measured, at_rest = project.validation[0].measured, project.validation[0].markers
    assert measured is not None
    assert at_rest is not None
    down = (measured - at_rest.positions).mean(axis=0)
    assert -0.018 < down[2] < -0.016
