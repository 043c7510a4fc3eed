"""Files that must be refused, with what the user reads."""

import meshio
import numpy as np
import pytest

import softcal_jax as sc
from softcal_jax.mesh import beam, read_mesh

BEAM = beam(0.1, 0.02, 0.03, (3, 2, 1))
TEXT, BYTES = b"this is no mesh\n" * 9, bytes(range(256)) * 9


def _write(tmp_path, points, cells, suffix=".inp", **options):
    path = tmp_path / f"bad{suffix}"
    meshio.Mesh(points, cells).write(path, **options)
    return path


def test_missing(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"no\.msh .*not exist"):
        read_mesh(tmp_path / "no.msh", length_unit="m")


def test_directory(tmp_path):
    with pytest.raises(ValueError, match="is a directory"):
        read_mesh(tmp_path, length_unit="m")


def test_extension(tmp_path):
    path = tmp_path / "beam.step"
    path.write_text("ISO-10303-21;")
    with pytest.raises(ValueError, match=r"'\.step'.* \.msh, \.vtu"):
        read_mesh(path, length_unit="m")


@pytest.mark.parametrize(
    ("suffix", "content"),
    [
        *((".inp", content) for content in (b"", TEXT, BYTES)),
        *((".msh", content) for content in (b"", TEXT)),
        (".vtu", BYTES),
        (".vtk", TEXT),
        (".med", TEXT),
    ],
)
def test_garbage(tmp_path, suffix, content, capfd):
    path = tmp_path / f"garbage{suffix}"
    path.write_bytes(content)
    with pytest.raises(ValueError, match=r"garbage.*(read as|no tetra|needs)") as bad:
        read_mesh(path, length_unit="m")
    assert "truncated" not in str(bad.value)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    ("suffix", "part", "options"),
    [
        (".msh", 0.3, {"file_format": "gmsh22", "binary": False}),
        (".msh", 0.9, {"file_format": "gmsh", "binary": True}),
        (".vtu", 0.6, {}),
        (".vtk", 0.9, {}),
        *((".inp", part, {}) for part in (0.3, 0.6, 0.9)),
    ],
)
def test_truncated(tmp_path, suffix, part, options, capfd):
    path = _write(tmp_path, BEAM.points, [("tetra", BEAM.tets)], suffix, **options)
    content = path.read_bytes()
    path.write_bytes(content[: int(part * len(content))])
    capfd.readouterr()
    with pytest.raises(ValueError, match=str(path)):
        read_mesh(path, length_unit="m")
    assert capfd.readouterr() == ("", "")


def test_arguments(tmp_path):
    path = _write(tmp_path, BEAM.points, [("tetra", BEAM.tets)])
    with pytest.raises(ValueError, match=r"length unit 'in'.* mean 'inch'"):
        read_mesh(path, length_unit="in")
    with pytest.raises(ValueError, match=r"order .* 1, 2 or None, got 3"):
        read_mesh(path, length_unit="m", order=3)
    with pytest.raises(ValueError, match=r"unused nodes 'drp'.* mean 'drop'"):
        read_mesh(path, length_unit="m", unused="drp")


def test_no_tets(tmp_path):
    path = _write(tmp_path, BEAM.points, [("hexahedron", [range(8)])])
    with pytest.raises(ValueError, match=r"no tetra.* 1 hexahedron.*split"):
        read_mesh(path, length_unit="m")


@pytest.mark.parametrize("groups", [{}, {"gmsh:physical": [np.ones(1, int)]}])
def test_a_surface_says_what_is_missing(tmp_path, groups):
    """Also that of a volume which Gmsh left out, since only its surface is a group."""
    cells = [("triangle", [[0, 1, 2]])]
    path = tmp_path / "shell.msh"
    meshio.Mesh(BEAM.points, cells, cell_data=groups).write(path, file_format="gmsh22")
    with pytest.raises(ValueError, match=r"1 triangle\. .*surfaces .*physical group"):
        read_mesh(path, length_unit="m")


def test_mixed_orders(tmp_path):
    quadratic = beam(0.1, 0.02, 0.03, (3, 2, 1), order=2)
    cells = [("tetra", BEAM.tets[:7]), ("tetra10", quadratic.tets[7:])]
    path = _write(tmp_path, quadratic.points, cells)
    with pytest.raises(ValueError, match=r"7 linear .* 29 quadratic"):
        read_mesh(path, length_unit="m")


def test_unused_nodes(tmp_path):
    points = np.vstack([[[1.0, 1.0, 1.0]], BEAM.points, [[2.0, 2.0, 2.0]]])
    path = _write(tmp_path, points, [("tetra", 1 + BEAM.tets)])
    message = r'2 of its 26 nodes .*\[0, 25\] .*unused="drop"'
    with pytest.raises(ValueError, match=message):
        read_mesh(path, length_unit="m")
    mesh = read_mesh(path, length_unit="m", unused="drop")
    np.testing.assert_array_equal(mesh.points, BEAM.points)
    np.testing.assert_array_equal(mesh.tets, BEAM.tets)


@pytest.mark.parametrize(
    ("suffix", "file_format"), [(".msh", "gmsh"), (".inp", "abaqus")]
)
def test_inverted(tmp_path, suffix, file_format):
    tets = BEAM.tets[:, [1, 0, 2, 3]]
    path = _write(
        tmp_path, BEAM.points, [("tetra", tets)], suffix, file_format=file_format
    )
    with pytest.raises(ValueError, match=r"bad\..* 36 of 36 .*inverted"):
        read_mesh(path, length_unit="m")


def test_disconnected(tmp_path):
    points = np.vstack([BEAM.points, BEAM.points + 0.2])
    tets = np.vstack([BEAM.tets, BEAM.tets + BEAM.n_nodes])
    path = _write(tmp_path, points, [("tetra", tets)])
    with pytest.raises(ValueError, match=r"2 parts .* 36, 36 tets.*linked"):
        read_mesh(path, length_unit="m")
    with pytest.raises(ValueError, match=r"parts 'two'.* 'linked', 'one'"):
        read_mesh(path, length_unit="m", parts="two")
    # A rigid body may link them: that is for the model to know.
    linked = read_mesh(path, length_unit="m", parts="linked")
    assert linked.n_tets == 2 * BEAM.n_tets
    with pytest.raises(ValueError, match="disconnected: 2 parts"):
        sc.build_model(linked, sc.NeoHookean(1e5, 0.3), density=1000.0)


def test_nan(tmp_path):
    points = BEAM.points.copy()
    points[5, 1] = np.nan
    path = _write(tmp_path, points, [("tetra", BEAM.tets)])
    with pytest.raises(ValueError, match=r"node 5 .*nan"):
        read_mesh(path, length_unit="m")


def test_volumes_beside_tets_are_refused(tmp_path):
    """Without them the body would be lighter, and have holes."""
    points = np.vstack([BEAM.points, BEAM.points[:8] + np.array([0.2, 0.0, 0.0])])
    cells = [("hexahedron", [range(24, 32)]), ("tetra", BEAM.tets)]
    for suffix in (".vtu", ".inp"):
        path = _write(tmp_path, points, cells, suffix)
        with pytest.raises(ValueError, match=r"1 hexahedron.* split"):
            read_mesh(path, length_unit="m")


@pytest.mark.parametrize("dimensions", [(2, 3), (2, 2)])
def test_one_name_of_two_groups(tmp_path, dimensions):
    """Also of a surface and a volume: a support on it would hold the whole body."""
    cells = [("triangle", [[0, 1, 2]]), ("tetra", BEAM.tets)]
    tags = [np.full(len(rows), k + 1) for k, (_, rows) in enumerate(cells)]
    names = {f"clamp{k}": np.array([k + 1, dim]) for k, dim in enumerate(dimensions)}
    path = tmp_path / "same.msh"
    data = {"gmsh:physical": tags, "gmsh:geometrical": tags}
    mesh = meshio.Mesh(BEAM.points, cells, cell_data=data, field_data=names)
    mesh.write(path, file_format="gmsh22", binary=False)
    path.write_text(path.read_text().replace("clamp0", "clamp1"))
    with pytest.raises(ValueError, match=r"same\.msh .*two .* 'clamp1'"):
        read_mesh(path, length_unit="m")


TET_INP = """*NODE
1, 0., 0., 0.
2, 1., 0., 0.
3, 0., 1., 0.
4, 0., 0., 1.
*ELEMENT, TYPE=C3D4, ELSET=BODY
1, 1, 2, 3, 4
"""


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{}*NODE\n1, 0., 0., 1.\n", "1 is defined twice"),
        ("*PART, NAME=A\n{}*PART, NAME=B\n", r"\*PART.*flat"),
        ("{}*INSTANCE, PART=A\n*INSTANCE, PART=A\n", r"\*INSTANCE.*flat"),
        ("{}*INSTANCE, PART=A\n0., 5., 0.\n", r"\*INSTANCE.*flat"),
        ("{}*NGEN\n1, 4\n", r"\*NGEN.*flat"),
        ("{}*NSET, NSET=A\n1\n*ASSEMBLY\n*NSET, NSET=a\n2\n", "a is a set .*rename"),
        ("{}*NSET, NSET=A\nB\n", r"\*NSET.*'B'"),
        ("{}*NSET, NSET=A\n9\n", "node 9"),
        ("{}*ELSET, ELSET=A\n9\n", "element 9"),
        ("{}*SURFACE, NAME=A\nBODY\n", "BODY.*S1 to S4"),
        ("{}*SURFACE, NAME=BODY\n1, S1\n", "BODY.*rename"),
        ("{}*ELEMENT\n2, 1, 2, 3, 4\n", r"\*ELEMENT.*'TYPE'"),
        ("{}*ELEMENT, TYPE=C3D4\n2, 1, 2, 3\n", "element 2 has 3 nodes"),
    ],
)
def test_abaqus_files_that_would_be_read_wrong(tmp_path, text, message):
    path = tmp_path / "bad.inp"
    path.write_text(text.format(TET_INP))
    with pytest.raises(ValueError, match=rf"bad\.inp .*{message}"):
        read_mesh(path, length_unit="m")


def test_node_that_is_not_there(tmp_path):
    tets = BEAM.tets.copy()
    tets[0, 0] = 24
    path = _write(tmp_path, BEAM.points, [("tetra", tets)], ".vtu")
    with pytest.raises(ValueError, match=r"tetra cell .*not there"):
        read_mesh(path, length_unit="m")
