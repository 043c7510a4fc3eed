"""Files written by meshio, Gmsh or by hand, and what becomes of their groups."""

import warnings

import meshio
import numpy as np
import pytest
import pyvista
from wording import says

from softcal_jax.equilibrium import build_model
from softcal_jax.materials import NeoHookean
from softcal_jax.mesh import (
    MeshWarning,
    beam,
    boundary_faces,
    face_shares,
    read_mesh,
    read_tet_data,
    volumes,
)

BEAM = beam(0.1, 0.02, 0.03, (3, 2, 1))
FORMATS = {
    "gmsh22 ascii": (".msh", {"file_format": "gmsh22", "binary": False}),
    "gmsh22 binary": (".msh", {"file_format": "gmsh22", "binary": True}),
    "gmsh41 ascii": (".msh", {"file_format": "gmsh", "binary": False}),
    "gmsh41 binary": (".msh", {"file_format": "gmsh", "binary": True}),
    "vtu": (".vtu", {}),
    "vtk": (".vtk", {}),
    "vtk42": (".vtk", {"file_format": "vtk42"}),
    "abaqus": (".inp", {}),
    "med": (".med", {}),
}


def _kind(mesh):
    return "tetra" if mesh.order == 1 else "tetra10"


def _write(tmp_path, mesh, suffix, **options):
    path = tmp_path / f"beam{suffix}"
    mesh.write(path, **options)
    return path


@pytest.mark.parametrize(
    ("name", "order"), [*((name, 2) for name in FORMATS), ("med", 1), ("abaqus", 1)]
)
def test_round_trip(tmp_path, name, order, capfd):
    suffix, options = FORMATS[name]
    if suffix == ".med":
        pytest.importorskip("h5py", reason="meshio reads .med through h5py")
    mesh = beam(0.1, 0.02, 0.03, (3, 2, 1), order=order)
    raw = meshio.Mesh(1e3 * mesh.points, [(_kind(mesh), mesh.tets)])
    path = _write(tmp_path, raw, suffix, **options)
    capfd.readouterr()
    read = read_mesh(path, length_unit="mm")
    assert capfd.readouterr() == ("", "")
    np.testing.assert_allclose(read.points, mesh.points, rtol=1e-14, atol=1e-18)
    np.testing.assert_array_equal(read.tets, mesh.tets)


@pytest.mark.parametrize(
    ("unit", "metres"),
    [("m", 1.0), ("cm", 0.01), ("mm", 0.001), ("um", 1e-6), ("inch", 0.0254)],
)
def test_length_units(tmp_path, unit, metres):
    path = _write(tmp_path, meshio.Mesh(BEAM.points, [("tetra", BEAM.tets)]), ".inp")
    points = read_mesh(path, length_unit="m").points
    large = meshio.Mesh(points / metres, [("tetra", BEAM.tets)])
    path = _write(tmp_path, large, ".inp")
    read = read_mesh(path, length_unit=unit)
    np.testing.assert_allclose(read.points, BEAM.points, rtol=1e-14)


def test_order_is_converted(tmp_path):
    path = _write(tmp_path, meshio.Mesh(BEAM.points, [("tetra", BEAM.tets)]), ".inp")
    quadratic = read_mesh(path, length_unit="m", order=2)
    assert quadratic.order == 2
    raw = meshio.Mesh(quadratic.points, [("tetra10", quadratic.tets)])
    path = _write(tmp_path, raw, ".inp")
    linear = read_mesh(path, length_unit="m", order=1)
    np.testing.assert_array_equal(linear.tets, BEAM.tets)
    assert read_mesh(path, length_unit="m", order=2).n_nodes == quadratic.n_nodes


def _with_physical_groups(order):
    """Gmsh 2 groups: two volumes, one surface wound inwards, a line and a point."""
    mesh = beam(0.1, 0.02, 0.03, (3, 2, 1), order=order)
    inwards = mesh.faces("x_min")[:, :3][:, [0, 2, 1]]
    if order == 2:
        inwards = mesh.faces("x_min")[:, [0, 2, 1, 5, 4, 3]]
    half = mesh.n_tets // 2
    kind = _kind(mesh)
    edge = mesh.nodes("x_max")[:2].reshape(1, 2)
    cells = [
        ("vertex", [[int(mesh.nodes("x_max")[0])]]),
        ("line", edge),
        ("triangle" if order == 1 else "triangle6", inwards),
        (kind, mesh.tets[:half]),
        (kind, mesh.tets[half:]),
    ]
    tags = [[9], [8], [1] * len(inwards), [2] * half, [5] * (mesh.n_tets - half)]
    names = {"tip": [9, 0], "edge": [8, 1], "clamp": [1, 2], "soft": [2, 3]}
    data = [np.array(t, dtype=np.int32) for t in tags]
    return mesh, meshio.Mesh(
        mesh.points,
        cells,
        cell_data={"gmsh:physical": data, "gmsh:geometrical": data},
        field_data={name: np.array(entry) for name, entry in names.items()},
    )


@pytest.mark.parametrize("binary", [False, True])
@pytest.mark.parametrize("order", [1, 2])
def test_gmsh_2_physical_groups(tmp_path, order, binary):
    mesh, raw = _with_physical_groups(order)
    path = _write(tmp_path, raw, ".msh", file_format="gmsh22", binary=binary)
    read = read_mesh(path, length_unit="m")
    half = mesh.n_tets // 2
    assert set(read.surface_groups) == {"clamp"}
    # A volume without a name is called after its tag.
    assert set(read.tet_groups) == {"soft", "volume_5"}
    assert set(read.node_groups) == {"tip", "edge", "clamp", "soft", "volume_5"}
    np.testing.assert_array_equal(read.tets_of("soft"), np.arange(half))
    np.testing.assert_array_equal(
        read.tets_of("volume_5"), np.arange(half, mesh.n_tets)
    )
    np.testing.assert_array_equal(read.nodes("clamp"), mesh.nodes("x_min"))
    np.testing.assert_array_equal(read.nodes("edge"), mesh.nodes("x_max")[:2])
    np.testing.assert_array_equal(read.nodes("tip"), mesh.nodes("x_max")[:1])
    # The faces are turned outwards, as those of the tets are.
    want = {tuple(face) for face in mesh.faces("x_min").tolist()}
    assert {tuple(face) for face in read.faces("clamp").tolist()} == want


GMSH_41 = """$MeshFormat
4.1 0 8
$EndMeshFormat
$PhysicalNames
2
2 1 "clamp"
3 7 "body"
$EndPhysicalNames
$Entities
1 0 1 1
1 5 5 5 0
1 0 0 0 1 1 0 1 1 0
1 0 0 0 1 1 1 1 7 1 1
$EndEntities
$Nodes
2 5 1 6
0 1 0 1
6
5 5 5
3 1 0 4
1
2
3
4
0 0 0
1 0 0
0 1 0
0 0 1
$EndNodes
$Elements
{elements}
$EndElements
"""


def test_gmsh_4_physical_groups(tmp_path):
    """Numbered with a gap, as Gmsh may."""
    path = tmp_path / "tet.msh"
    elements = "2 2 1 2\n2 1 2 1\n1 1 2 3\n3 1 4 1\n2 1 2 3 4"
    text = GMSH_41.replace("{elements}", elements)
    text = text.replace("2 5 1 6\n0 1 0 1\n6\n5 5 5\n", "1 4 1 4\n")
    path.write_text(text)
    mesh = read_mesh(path, length_unit="cm")
    assert set(mesh.node_groups) == {"clamp", "body"}
    np.testing.assert_array_equal(mesh.nodes("clamp"), [0, 1, 2])
    np.testing.assert_array_equal(mesh.tets_of("body"), [0])
    assert mesh.surface_groups["clamp"].tolist() == [[0, 2, 1]]
    np.testing.assert_allclose(volumes(mesh), 1e-6 / 6.0, rtol=1e-14)


def test_helper_points_of_gmsh_go_with_their_cells(tmp_path):
    """A circle centre is a vertex cell and a node of no tet."""
    points = np.vstack([[[5.0, 5.0, 5.0]], BEAM.points])
    cells = [("vertex", [[0]]), ("tetra", 1 + BEAM.tets)]
    path = _write(tmp_path, meshio.Mesh(points, cells), ".vtu")
    with pytest.warns(MeshWarning, match=r"left out: 1 vertex\."):
        mesh = read_mesh(path, length_unit="m")
    np.testing.assert_array_equal(mesh.points, BEAM.points)
    np.testing.assert_array_equal(mesh.tets, BEAM.tets)


def test_other_cells_are_named(tmp_path):
    outer = boundary_faces(BEAM)
    cells = [
        ("triangle", outer),
        ("tetra", BEAM.tets),
        ("line", [[0, 1], [1, 2]]),
    ]
    path = _write(tmp_path, meshio.Mesh(BEAM.points, cells), ".vtu")
    message = f"left out: {len(outer)} triangle, 2 line"
    with pytest.warns(MeshWarning, match=message):
        mesh = read_mesh(path, length_unit="m")
    assert mesh.n_nodes == BEAM.n_nodes
    assert mesh.surface_groups == {}


def test_polygons_of_any_number_of_sides_are_left_out(tmp_path):
    kinds = [pyvista.CellType.TETRA] * BEAM.n_tets + [pyvista.CellType.POLYGON] * 2
    polygons = [5, *range(5), 6, *range(6)]
    cells = np.concatenate([np.insert(BEAM.tets, 0, 4, axis=1).ravel(), polygons])
    path = tmp_path / "polygons.vtu"
    pyvista.UnstructuredGrid(cells, np.array(kinds), BEAM.points).save(path)
    with pytest.warns(MeshWarning, match=r"left out: 2 polygon\."):
        mesh = read_mesh(path, length_unit="m")
    np.testing.assert_array_equal(mesh.tets, BEAM.tets)


def test_triangles_that_are_no_faces(tmp_path):
    mesh, raw = _with_physical_groups(1)
    triangles = raw.cells[2].data.copy()
    triangles[0] = [0, 5, mesh.n_nodes - 1]
    raw.cells[2].data = triangles
    path = _write(tmp_path, raw, ".msh", file_format="gmsh22")
    with pytest.warns(MeshWarning, match=r"1 of the 4 .*'clamp'"):
        read = read_mesh(path, length_unit="m")
    assert len(read.faces("clamp")) == 3


def test_group_without_a_tet(tmp_path):
    points = np.vstack([BEAM.points, [[1.0, 1.0, 1.0]]])
    raw = meshio.Mesh(
        points, [("tetra", BEAM.tets)], point_sets={"rig": [24], "tip": [23]}
    )
    path = _write(tmp_path, raw, ".inp")
    with pytest.warns(MeshWarning, match=r"group 'rig', .*no node"):
        mesh = read_mesh(path, length_unit="m", unused="drop")
    assert set(mesh.node_groups) == {"tip"}


@pytest.fixture(scope="module")
def gmsh():
    """Two boxes that share a face; the clamp is reversed, the body in two groups."""
    gmsh = pytest.importorskip("gmsh")
    gmsh.initialize(readConfigFiles=False, interruptible=False)
    gmsh.option.setNumber("General.Terminal", 0)
    shape, model = gmsh.model.occ, gmsh.model
    boxes = [(3, shape.addBox(x, 0, 0, 10, 10, 10)) for x in (0, 10)]
    shape.fragment(boxes[:1], boxes[1:])
    shape.synchronize()
    gmsh.option.setNumber("Mesh.MeshSizeMin", 10)
    model.mesh.generate(3)
    model.addPhysicalGroup(2, [-1], 5, "clamp")
    model.addPhysicalGroup(3, [1], 6, "soft")
    model.addPhysicalGroup(3, [1, 2], 7, "body")
    yield gmsh
    gmsh.finalize()


@pytest.mark.parametrize(
    ("version", "option"),
    [
        *((version, "") for version in (1, 2.2, 4.0, 4.1)),
        *((4.1, option) for option in ("SaveAll", "SaveParametric", "partitions")),
        (2.2, "partitions"),
    ],
)
def test_every_version_of_gmsh(gmsh, tmp_path, version, option):
    """With several groups on one volume, and what its window appends."""
    path = tmp_path / "two.msh"
    gmsh.option.setNumber("Mesh.MshFileVersion", version)
    if option == "partitions":
        gmsh.model.mesh.partition(2)
    elif option:
        gmsh.option.setNumber(f"Mesh.{option}", 1)
    gmsh.write(str(path))
    gmsh.model.mesh.unpartition()
    gmsh.option.restoreDefaults()
    gmsh.option.setNumber("General.Terminal", 0)
    with path.open("a") as file:
        file.write("//+\nMesh.SurfaceFaces = 1;\n")
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "(?s).*left out: .* line", MeshWarning)
        mesh = read_mesh(path, length_unit="mm")
    clamp, soft, body = "clamp", "soft", "body"
    if version == 1:  # knows no names
        clamp, soft, body = "surface_5", "volume_6", "volume_7"
    assert set(mesh.surface_groups) == {clamp}
    assert set(mesh.tet_groups) == {soft, body}
    np.testing.assert_array_equal(mesh.points[mesh.nodes(clamp), 0], 0.0)
    assert face_shares(mesh, mesh.faces(clamp)).sum() == pytest.approx(0.01**2)
    assert len(mesh.tets_of(body)) == mesh.n_tets
    inner = volumes(mesh)[mesh.tets_of(soft)].sum()
    assert inner == pytest.approx(0.01**3)
    assert volumes(mesh).sum() == pytest.approx(2 * 0.01**3)


def test_values_of_tets_go_by_the_numbers_of_elements(gmsh, tmp_path):
    path, model = tmp_path / "data.msh", gmsh.model
    tets, view = model.mesh.getElementsByType(4)[0], gmsh.view.add("x")
    x = model.mesh.getBarycenters(4, -1, False, False)[::3]
    values, name = x[::-1, None].tolist(), model.getCurrent()
    gmsh.view.addModelData(view, 0, name, "ElementData", tets[::-1], values)
    gmsh.option.setNumber("PostProcessing.SaveMesh", 0)
    gmsh.write(str(path))
    gmsh.view.write(view, str(path), append=True)
    gmsh.view.remove(view)
    centroids = read_mesh(path, length_unit="m").centroids
    np.testing.assert_allclose(read_tet_data(path, "x"), centroids[:, :1], rtol=1e-12)


def test_without_gmsh_what_meshio_reads_wrong_is_refused(tmp_path, monkeypatch):
    """Files are read in a process of their own, which finds this instead of it."""
    (tmp_path / "gmsh.py").write_text("raise ImportError")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    mesh, raw = _with_physical_groups(1)
    path = _write(tmp_path, raw, ".msh", file_format="gmsh22", binary=False)
    assert read_mesh(path, length_unit="m").n_nodes == mesh.n_nodes
    path.write_text(GMSH_41)
    with pytest.raises(ValueError, match=r"version 2\.2"):
        read_mesh(path, length_unit="m")


INP = """*NODE, NSET=ALL
1, 0., 0., 0.
2, 1., 0., 0.
3, 0., 1., 0.
4, 0., 0., 1.
9, 1., 1., 1.
*ELEMENT, TYPE=S3
1, 1, 2, 3
*Element, type=C3D4, ELSET=SOFT
2, 1, 2, 3, 4
*ELEMENT, TYPE=C3D4, ELSET=HARD
3, 2, 9, 3, 4
*NSET, NSET=CLAMP
1, 2, 3
*ELSET, ELSET=SKIN
1
"""


def test_abaqus_sets(tmp_path):
    """Sets of *ELEMENT lines stay with their own section, with or without ELSET."""
    path = tmp_path / "two.inp"
    path.write_text(INP)
    mesh = read_mesh(path, length_unit="cm")
    np.testing.assert_array_equal(mesh.tets_of("SOFT"), [0])
    np.testing.assert_array_equal(mesh.tets_of("HARD"), [1])
    np.testing.assert_array_equal(mesh.nodes("CLAMP"), [0, 1, 2])
    np.testing.assert_array_equal(mesh.nodes("HARD"), [1, 2, 3, 4])
    assert mesh.faces("SKIN").tolist() == [[0, 2, 1]]


TET_INP = """*NODE
1, 0., 0., 0.
2, 1., 0., 0.
3, 0., 1., 0.
4, 0., 0., 1.
5, 1., 1., 1.
*ELEMENT, TYPE=C3D4H, ELSET=BODY
1, 1, 2, 3, 4
2, 2, 5, 3, 4
"""


@pytest.mark.parametrize(
    ("lines", "nodes"),
    [
        ("*NSET, NSET=A\n1, 2\n*NSET, NSET=B\n3\n*NSET, NSET=GROUP\na, B,", [0, 1, 2]),
        ("*ELSET, ELSET=A\n1\n*NSET, NSET=GROUP, ELSET=A", [0, 1, 2, 3]),
        ("*ELSET, ELSET=A\n2\n*ELSET, ELSET=GROUP\nA,", [1, 2, 3, 4]),
        ("*NSET, NSET=GROUP, GENERATE\n1, 5, 2", [0, 2, 4]),
        ("*NSET, NSET=GROUP\n1\n*ELSET, ELSET=GROUP\n2", [0]),
        ("*SURFACE, NAME=GROUP\nBODY, S1", [0, 1, 2, 4]),
        ("*SURFACE, NAME=GROUP, TYPE=ELEMENT\n1, S2", [0, 1, 3]),
        ("*SURFACE, NAME=GROUP, TYPE=ELEMENT\n1, S4", [0, 2, 3]),
        ("*SURFACE, NAME=GROUP, TYPE=NODE\n2, 1.0", [1]),
        ("*NSET, INSTANCE=P-1,\nNSET=GROUP\n P-1.ALL", [0, 1, 2, 3, 4]),
    ],
)
def test_abaqus_groups(tmp_path, lines, nodes):
    """Of a flat file, and of one with a part and its instance."""
    path = tmp_path / "tets.inp"
    flat = TET_INP.replace("*NODE\n", "*NODE, NSET=ALL\n") + lines
    path.write_text(flat)
    np.testing.assert_array_equal(
        read_mesh(path, length_unit="cm").nodes("GROUP"), nodes
    )
    path.write_text(
        f"*PART, NAME=P\n{flat}\n*END PART\n*ASSEMBLY, NAME=A\n"
        "*INSTANCE, NAME=P-1, PART=P\n-0., 0., 0.\n*END INSTANCE\n"
    )
    mesh = read_mesh(path, length_unit="cm")
    np.testing.assert_array_equal(mesh.nodes("GROUP"), nodes)
    if "*SURFACE, NAME=GROUP, TYPE=ELEMENT" in lines:
        assert sorted(mesh.faces("GROUP")[0].tolist()) == nodes


def test_abaqus_quadratic_tets_in_several_files(tmp_path):
    """Elements before nodes, elements over two lines, a surface with its mid nodes."""
    mesh = beam(0.1, 0.02, 0.03, (1, 1, 1), order=2)
    row = lambda k, values: ", ".join(map(str, [k + 1, *values]))
    nodes = [row(k, x) for k, x in enumerate(mesh.points.tolist())]
    tets = [row(k, n) for k, n in enumerate((1 + mesh.tets[:, ABAQUS_10]).tolist())]
    tets[0] = tets[0].replace(", ", ",\n", 6)
    (tmp_path / "nodes.txt").write_text("\n".join(nodes))
    path = tmp_path / "two.inp"
    path.write_text(
        "*ELEMENT, TYPE=C3D10MH\n" + "\n".join(tets) + "\n*NODE, INPUT=nodes.txt\n"
        "*SURFACE, NAME=FACE\n1, S3\n"
    )
    read = read_mesh(path, length_unit="m")
    np.testing.assert_array_equal(read.tets, mesh.tets)
    np.testing.assert_array_equal(read.points, mesh.points)
    (face,) = read.faces("FACE")
    assert set(face[:3]) == set(mesh.tets[0, 1:4])
    assert set(face) <= set(mesh.tets[0])


ABAQUS_10 = np.arange(10)  # numbered as VTK does

VTK = """# vtk DataFile Version 5.1
vtk output
ASCII
DATASET UNSTRUCTURED_GRID
POINTS 4 double
0 0 0 1 0 0 0 1 0 0 0 1
CELLS 2 4
OFFSETS vtktypeint64
0 4
CONNECTIVITY vtktypeint64
0 1 2 3
CELL_TYPES 1
10
CELL_DATA 1
SCALARS a%20part long
LOOKUP_TABLE default
7
"""


def test_vtk_with_long_integers(tmp_path):
    path = tmp_path / "tet.vtk"
    path.write_text(VTK)
    assert read_mesh(path, length_unit="cm").n_tets == 1
    assert read_tet_data(path, "a part").tolist() == [[7.0]]


@pytest.mark.parametrize("order", [1, 2])
def test_lagrange_tets_in_xml_whatever_the_name(tmp_path, order):
    mesh = beam(0.1, 0.02, 0.03, (1, 1, 1), order=order)
    kinds = np.full(mesh.n_tets, pyvista.CellType.LAGRANGE_TETRAHEDRON)
    cells = np.insert(mesh.tets, 0, mesh.tets.shape[1], axis=1)
    grid = pyvista.UnstructuredGrid(cells.ravel(), kinds, mesh.points)
    grid.save(tmp_path / "tets.vtu")
    path = (tmp_path / "tets.vtu").rename(tmp_path / "tets.vtk")
    read = read_mesh(path, length_unit="m")
    np.testing.assert_array_equal(read.tets, mesh.tets)
    np.testing.assert_array_equal(read.points, mesh.points)


def test_med_families_and_numbering(tmp_path):
    """MED numbers a tet the other way round, and names groups through families."""
    pytest.importorskip("h5py", reason="meshio reads .med through h5py")
    mesh = beam(0.1, 0.02, 0.03, (3, 2, 1), order=2)
    left_handed = mesh.tets[:, [0, 2, 1, 3, 6, 5, 4, 7, 9, 8]]
    clamp = np.zeros(mesh.n_nodes, dtype=int)
    clamp[mesh.nodes("x_min")] = 3
    families = np.zeros(mesh.n_tets, dtype=int)
    families[:5] = -4
    raw = meshio.Mesh(
        mesh.points,
        [("tetra10", left_handed)],
        point_data={"point_tags": clamp},
        cell_data={"cell_tags": [families]},
    )
    raw.point_tags, raw.cell_tags = {3: ["clamp"]}, {-4: ["root", "soft"]}
    read = read_mesh(_write(tmp_path, raw, ".med"), length_unit="m")
    np.testing.assert_array_equal(read.tets, mesh.tets)
    np.testing.assert_array_equal(read.nodes("clamp"), mesh.nodes("x_min"))
    for name in ("root", "soft"):
        np.testing.assert_array_equal(read.tets_of(name), np.arange(5))


def test_unlikely_unit(tmp_path):
    path = _write(tmp_path, meshio.Mesh(BEAM.points, [("tetra", BEAM.tets)]), ".inp")
    with pytest.warns(MeshWarning, match=r"0\.000106 m across.*in 'mm'"):
        read_mesh(path, length_unit="mm")


def test_millimetres_that_are_read_as_metres_are_told_once(tmp_path):
    raw = meshio.Mesh(1e3 * BEAM.points, [("tetra", BEAM.tets)])
    path, law = _write(tmp_path, raw, ".inp"), NeoHookean(1e5, 0.3)
    with pytest.warns(MeshWarning) as caught:
        build_model(read_mesh(path, length_unit="m"), law, density=1.0, solver="none")
    (warning,) = caught
    assert says(warning.message, "100 m across", 'length_unit = "mm"')
