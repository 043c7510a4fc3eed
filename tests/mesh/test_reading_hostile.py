"""Mesh files that would fill the memory, wait for ever, or lead elsewhere."""

import os

import h5py
import meshio
import pytest

from softcal_jax.mesh import beam, read_mesh, write_mesh

BEAM = beam(0.1, 0.02, 0.03, (3, 2, 1))
SUFFIXES = [".msh", ".vtu", ".vtk", ".inp", ".med"]


def refused(path, message):
    with pytest.raises((ValueError, OSError), match=message):
        read_mesh(path, length_unit="m")


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_what_is_no_file_is_not_opened(tmp_path, suffix):
    pipe, device = tmp_path / f"pipe{suffix}", tmp_path / f"device{suffix}"
    os.mkfifo(pipe)
    device.symlink_to("/dev/zero")
    refused(pipe, f"pipe{suffix} .*device")
    refused(device, f"device{suffix} .*pipe")


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_large_file_is_not_opened(tmp_path, monkeypatch, suffix):
    monkeypatch.setenv("SOFTCAL_MAX_FILE_MB", "1")
    path = tmp_path / f"large{suffix}"
    with path.open("wb") as file:
        file.truncate(2_000_000)
    refused(path, f"large{suffix}: 2 MB, .*limit of 1")


@pytest.mark.parametrize(
    ("name", "text"),
    [
        (
            "bomb.vtk",
            "# vtk DataFile Version 3.0\n\nASCII\nDATASET UNSTRUCTURED_GRID\n",
        ),
        ("bomb.msh", "$MeshFormat\n4.1 0 8\n$EndMeshFormat\n$Nodes\n1 {n} 1 {n}\n"),
    ],
)
def test_a_small_file_that_declares_a_large_array(tmp_path, name, text):
    """It takes down the process that reads it alone."""
    path = tmp_path / name
    points = f"POINTS {10**12} double\n0 0 0\n" * name.endswith(".vtk")
    path.write_text(text.format(n=10**12) + points)
    refused(path, f"{name} cannot be read")


def test_a_med_file_that_declares_a_large_array(tmp_path):
    path = tmp_path / "bomb.med"
    meshio.Mesh(BEAM.points, [("tetra", BEAM.tets)]).write(path)
    with h5py.File(path, "r+") as file:
        nodes = next(iter(file["ENS_MAA"].values()))
        nodes = next(iter(nodes.values()))["NOE"]
        del nodes["COO"]
        nodes.create_dataset("COO", shape=(10**12,), dtype="f8", chunks=True)
        nodes["COO"].attrs["NBR"] = 10**12 // 3
    assert path.stat().st_size < 100_000
    refused(path, r"bomb\.med cannot be read.*(allocate|memory)")


def test_a_script_of_gmsh_is_not_run(tmp_path):
    """Gmsh takes a file for one that does not begin as a mesh, or that ends in .opt."""
    path, script = tmp_path / "script.msh", f'SystemCall "touch {tmp_path}/run";\n'
    path.write_text(f"{script}$MeshFormat\n")
    refused(path, r"script\.msh cannot be read.*expected \$MeshFormat")
    write_mesh(BEAM, path, length_unit="m")
    path.with_name("script.msh.opt").write_text(script)
    assert read_mesh(path, length_unit="m").n_tets == BEAM.n_tets
    assert not (tmp_path / "run").exists()


def test_too_many_tets(tmp_path, monkeypatch):
    path = tmp_path / "beam.inp"
    meshio.Mesh(BEAM.points, [("tetra", BEAM.tets)]).write(path)
    monkeypatch.setenv("SOFTCAL_MAX_TETS", "35")
    refused(path, r"beam\.inp: .* 36 tets, .*limit of 35")


def included(folder, line):
    """Write an Abaqus mesh whose nodes stand in another file."""
    meshio.Mesh(BEAM.points, [("tetra", BEAM.tets)]).write(folder / "whole.inp")
    text = (folder / "whole.inp").read_text()
    nodes, elements = text.split("*ELEMENT", 1)
    (folder / "nodes.inp").write_text(nodes)
    path = folder / "mesh.inp"
    path.write_text(f"{line}\n*ELEMENT{elements}")
    return path


def test_an_include_below_the_folder_is_read(tmp_path):
    (tmp_path / "parts").mkdir()
    inner = included(tmp_path, "*INCLUDE, INPUT=whole.inp")
    inner.write_text("*INCLUDE, INPUT=parts/whole.inp\n")
    (tmp_path / "whole.inp").rename(tmp_path / "parts" / "whole.inp")
    assert read_mesh(inner, length_unit="m").n_tets == BEAM.n_tets


@pytest.mark.parametrize(
    "line",
    ["*INCLUDE, INPUT={}", "*include,input={}", "*NODE ,\nINPUT = '{}'"],
)
@pytest.mark.parametrize("target", ["/dev/zero", "/dev/tty", "../outside.inp"])
def test_an_include_does_not_leave_the_folder(tmp_path, line, target):
    folder = tmp_path / "mesh"
    folder.mkdir()
    (tmp_path / "outside.inp").write_text("*NODE\n1, 0., 0., 0.\n")
    refused(included(folder, line.format(target)), "outside the folder")


def test_an_include_of_a_link_that_leads_out(tmp_path):
    (tmp_path / "zero.inp").symlink_to("/dev/zero")
    path = included(tmp_path, "*INCLUDE, INPUT=zero.inp")
    refused(path, "outside the folder")


def test_an_include_of_what_is_no_file(tmp_path):
    os.mkfifo(tmp_path / "pipe.inp")
    path = included(tmp_path, "*INCLUDE, INPUT=pipe.inp")
    refused(path, r"\*INCLUDE of 'pipe.inp': .*device")
    path = included(tmp_path, "*INCLUDE, INPUT=node.inp")
    refused(path, r"node\.inp .* mean 'nodes\.inp'")


def test_includes_that_include_each_other(tmp_path):
    path = included(tmp_path, "*INCLUDE, INPUT=other.inp")
    (tmp_path / "other.inp").write_text("*INCLUDE, INPUT=mesh.inp\n")
    refused(path, "INCLUDE of 'mesh.inp': .*already")


def test_the_sizes_of_includes_add_up(tmp_path, monkeypatch):
    lines = ""
    for i in range(3):
        (tmp_path / f"{i}.inp").write_text("** comment\n" * 40_000)
        lines += f"*INCLUDE, INPUT={i}.inp\n"
    path = included(tmp_path, lines)
    monkeypatch.setenv("SOFTCAL_MAX_FILE_MB", "1")
    refused(path, r"includes: 1\.32\d* MB, .*limit of 1")


def test_control_characters_in_the_name_of_a_group_are_shown(tmp_path):
    path = tmp_path / "beam.inp"
    meshio.Mesh(BEAM.points, [("tetra", BEAM.tets)]).write(path)
    sets = "*NSET, NSET=\x1b[2J\n1, 2, 3\n*ELSET, ELSET=\x1b[1J\n1, 2\n"
    path.write_text(path.read_text() + sets)
    mesh = read_mesh(path, length_unit="m")
    assert set(mesh.node_groups) == {r"\x1b[2J", r"\x1b[1J"}
    assert set(mesh.tet_groups) == {r"\x1b[1J"}
