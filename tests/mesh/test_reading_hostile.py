"""Mesh files that would fill the memory, wait for ever, or lead elsewhere."""

import os

import h5py
import meshio
import numpy as np
import pytest

from softcal_jax.mesh import beam, read_mesh

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


@pytest.mark.parametrize("compression", ["zlib", "lzma"])
def test_a_small_file_that_unpacks_to_a_large_one(tmp_path, monkeypatch, compression):
    """Ten megabytes of zeros in each of two arrays, in a file of some kilobytes."""
    path = tmp_path / "bomb.vtu"
    mesh = meshio.Mesh(BEAM.points, [("tetra", BEAM.tets)])
    for name in ("a", "b"):
        mesh.point_data[name] = np.zeros(
            (BEAM.n_nodes, 10_000_000 // 8 // BEAM.n_nodes)
        )
    meshio.vtu.write(path, mesh, compression=compression)
    assert path.stat().st_size < 200_000
    monkeypatch.setenv("SOFTCAL_MAX_FILE_MB", "19")
    refused(path, r"bomb\.vtu, unpacked: 20\.\d+ MB.*limit of 19")
    monkeypatch.setenv("SOFTCAL_MAX_FILE_MB", "21")
    assert read_mesh(path, length_unit="m").n_tets == BEAM.n_tets


def test_a_med_file_that_declares_a_large_array(tmp_path):
    path = tmp_path / "bomb.med"
    with h5py.File(path, "w") as file:
        file.create_dataset("a", shape=(10**12,), dtype="f8", chunks=True)
    assert path.stat().st_size < 100_000
    refused(path, r"bomb\.med, unpacked: 8 000 000 MB, .*limit of 100")


def test_too_many_tets(tmp_path, monkeypatch):
    path = tmp_path / "beam.vtu"
    meshio.Mesh(BEAM.points, [("tetra", BEAM.tets)]).write(path)
    monkeypatch.setenv("SOFTCAL_MAX_TETS", "35")
    refused(path, r"beam\.vtu: .* 36 tets, .*limit of 35")


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
    ["*INCLUDE, INPUT={}", "*include,input={}", "INCLUDE , INPUT={}", "*IN*CLUDE, ={}"],
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
