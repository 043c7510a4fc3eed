import numpy as np
import pytest

from softcal_jax.mesh import TetMesh, beam, quality_report

REGULAR = np.array([[1, 1, 1], [-1, 1, -1], [1, -1, -1], [-1, -1, 1]], dtype=float)


def test_regular_tet_is_the_best():
    report = quality_report(TetMesh(REGULAR, [[0, 1, 2, 3]]))
    np.testing.assert_allclose(report.mean_ratio, 1.0, rtol=1e-14)
    np.testing.assert_allclose(report.min_dihedral, np.arccos(1.0 / 3.0), rtol=1e-14)
    np.testing.assert_allclose(report.edge_length, np.sqrt(8.0), rtol=1e-14)
    np.testing.assert_allclose(report.volume, 8.0 / 3.0, rtol=1e-14)


def test_corner_of_a_cube():
    """Three edges of 1 and three of sqrt(2); faces meet at 90 and 54.7 degrees."""
    mesh = TetMesh(np.vstack([np.zeros(3), np.eye(3)]), [[0, 1, 2, 3]])
    report = quality_report(mesh)
    np.testing.assert_allclose(
        report.mean_ratio.min, 12 * 0.5 ** (2 / 3) / 9, rtol=1e-14
    )
    np.testing.assert_allclose(
        report.min_dihedral.min, np.arctan(np.sqrt(2.0)), rtol=1e-14
    )


def test_median_and_worst():
    points = np.vstack([REGULAR, [[0.6, 0.6, -0.6]], [[-3.0, -3.0, -3.1]]])
    report = quality_report(TetMesh(points, [[0, 1, 2, 3], [1, 0, 2, 4], [1, 2, 3, 5]]))
    assert report.mean_ratio.min < report.mean_ratio.median < report.mean_ratio.max
    assert report.worst_tets.tolist() == [1, 2, 0]
    np.testing.assert_allclose(report.mean_ratio.max, 1.0, rtol=1e-14)


def test_inverted_and_flat_tets_are_reported_not_refused():
    inverted = quality_report(TetMesh(REGULAR, [[0, 2, 1, 3]]))
    np.testing.assert_allclose(inverted.mean_ratio.min, -1.0, rtol=1e-14)
    flat = quality_report(TetMesh(REGULAR, [[0, 1, 2, 2]]))
    assert flat.mean_ratio.min == 0.0


@pytest.mark.parametrize("order", [1, 2])
def test_table(order):
    text = str(quality_report(beam(0.1, 0.02, 0.02, (5, 1, 1), order=order)))
    kind = {1: "24 nodes, 30 linear tets", 2: "99 nodes, 30 quadratic tets"}[order]
    assert text.startswith(f"{kind}, volume 40000 mm^3\n")
    lines = text.splitlines()
    assert lines[2].split() == ["edge", "length", "[mm]", "20", "20", "34.64"]
    assert lines[5].split()[-3:] == ["45", "45", "45"]
    assert len(lines[-1].split(", ")) == 5


def test_number_of_worst_tets():
    mesh = beam(0.1, 0.02, 0.02, (5, 1, 1))
    assert len(quality_report(mesh, n_worst=2).worst_tets) == 2
    with pytest.raises(ValueError, match="n_worst must not be negative, got -1"):
        quality_report(mesh, n_worst=-1)
