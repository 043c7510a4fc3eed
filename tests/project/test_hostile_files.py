"""Files that nobody meant as ours: refused with the key, not with a traceback."""

import difflib
import os
from pathlib import Path

import numpy as np
import pytest
from small_project import MARKERS, write_small_project
from wording import says

from softcal_jax.project import (
    ProjectError,
    guesses_left,
    load_project,
    quantities_as_read,
)
from softcal_jax.readings import _table

CELLS = "cells = [3, 1, 1]"
SETTINGS = "\n[settings]\n"
NEWTON = "\n[newton]\n"


def refusal(path: Path) -> str:
    """Load a project and return why it was refused, without the file."""
    with pytest.raises(ProjectError) as caught:
        load_project(path)
    text = str(caught.value)
    assert text.startswith(f"{path}")
    return text.removeprefix(f"{path}").lstrip(":, ")


def with_more(folder: Path, more: str) -> Path:
    path = write_small_project(folder)
    path.write_text(path.read_text() + more)
    return path


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (
            "\nx = " + "[\n" * 2000 + "]\n" * 2000,
            "cannot be read as TOML",
        ),
        (
            "\nx = " + "{a=" * 2000 + "1" + "}" * 2000,
            "cannot be read as TOML",
        ),
        ("\n[" + ".".join(["a"] * 200) + "]\n", "a: unknown key"),
        ("\n[" + ".".join(["a"] * 3000) + "]\n", "cannot be read as TOML"),
        ("\n[uncertain]\nnu = " + "9" * 5000, "cannot be read as TOML"),
    ],
)
def test_deep_or_endless(tmp_path, more, message):
    assert says(refusal(with_more(tmp_path, more)), message)


@pytest.mark.parametrize("when", ["1979-05-27", "1979-05-27T07:32:00Z"])
def test_a_date(tmp_path, when):
    text = refusal(write_small_project(tmp_path, ("nu = 0.3", f"nu = {when}")))
    assert says(text, f"material.nu: got {when[:10]}", "quotes")


def test_a_time(tmp_path):
    text = refusal(write_small_project(tmp_path, ("nu = 0.3", "nu = 07:32:00")))
    assert says(text, "material.nu: got 07:32:00")


@pytest.mark.parametrize(
    ("change", "where"),
    [
        (('name = "pulled"', r'name = "\u001b[2J"'), r"configurations.\x1b[2J.name"),
        (('tip = "(60, 10', r'"\u009b" = "(60, 10'), "markers.positions"),
        (
            ('run = "pulled"', r'run = "\u0000"'),
            "configurations.pulled.measured.record",
        ),
    ],
)
def test_a_control_character(tmp_path, change, where):
    text = refusal(write_small_project(tmp_path, change))
    assert where in text
    assert "control character '\\x" in text
    assert text.isprintable()


def test_few_of_many_problems_are_listed(tmp_path):
    keys = "\n".join(f"x{i} = 1979-05-27" for i in range(100))
    text = refusal(with_more(tmp_path, f"\n[uncertain]\n{keys}\n"))
    assert text.startswith("more than 30 problems.")
    assert text.count("\n- ") == 31


@pytest.mark.parametrize("n", ["1000000000000000", "2000000000", "400000"])
def test_too_many_cells(tmp_path, n):
    text = refusal(write_small_project(tmp_path, (CELLS, f"cells = [{n}, 1, 1]")))
    assert text.startswith(f"mesh: cells = [{n}, 1, 1]: ")
    assert says(text, "2 000 000 ... raise ... SOFTCAL_MAX_TETS")


def test_the_limit_of_cells_holds_for_the_pattern(tmp_path, monkeypatch):
    monkeypatch.setenv("SOFTCAL_MAX_TETS", "18")
    load_project(write_small_project(tmp_path))  # three cells of six tets
    centred = (CELLS, f'{CELLS}, pattern = "centred"')
    text = refusal(write_small_project(tmp_path, centred))
    assert says(text, "mesh: cells = [3, 1, 1]: 72 tets ... 18")


@pytest.mark.parametrize(
    ("table", "line", "message"),
    [
        (
            SETTINGS,
            "starts = 1_000_000_000_000",
            "settings.starts: starts = 1000000000000",
        ),
        (SETTINGS, "starts = 0", "settings.starts: ... got 0"),
        (SETTINGS, "intervals = 1e-300", "settings.intervals: ... 0.01 ... 1e-300"),
        (SETTINGS, "intervals = 1.0", "settings.intervals: ... 0.9999 ... got 1"),
        (
            "\n[parameter_space]\n",
            'order = [["E", "E"]]',
            "parameter_space: order ('E', 'E'): ... two",
        ),
        (SETTINGS, "seed = -1", "settings.seed: got -1 ... 0"),
        (SETTINGS, "precision = inf", "settings.precision: got inf"),
        (
            SETTINGS,
            "step_bound = inf",
            "settings: step_bound ... positive",
        ),
        (SETTINGS, "max_step_bound = inf", "settings: max_step_bound ... positive"),
        (
            SETTINGS,
            "damping = 1e300",
            "settings: damping ... (0, 1], got 1e+300",
        ),
        (
            NEWTON,
            "smallest_load_step = nan",
            "newton: smallest_load_step",
        ),
        (
            NEWTON,
            "smallest_load_step = 2.0",
            "newton: smallest_load_step",
        ),
        (
            NEWTON,
            "smallest_load_step = 0.0",
            "newton: smallest_load_step",
        ),
        ("\n[uncertain]\n", "nu = inf", "uncertain.nu: got inf"),
        (
            "\n[uncertain]\n",
            "gravity = 1e300",
            "uncertain.gravity: 1e+300 has no unit",
        ),
    ],
)
def test_numbers_out_of_range(tmp_path, table, line, message):
    assert says(refusal(with_more(tmp_path, table + line)), message)


@pytest.mark.parametrize(
    ("old", "new", "where"),
    [
        ("(20, 0, -50) mN", "(1e300, 0, 0) N", "configurations.pulled.loads"),
        ("(20, 0, -50) mN", "(0, 0, 1e6) N", "configurations.pulled.loads"),
        ("(0, 0, -9.81) m/s^2", "(0, 0, 1e200) m/s^2", "configurations.weight.gravity"),
    ],
)
def test_what_no_body_bears_is_refused_at_once(tmp_path, old, new, where):
    """It was computed for minutes; 880 N are the modulus times the size squared."""
    text = refusal(write_small_project(tmp_path, (old, new)))
    assert says(text, f"{where}: ... 100 times ... 880 N ... 200 kPa ... units")


def test_a_pressure_that_no_body_bears(tmp_path):
    push = """
[actuators.push]
type = "surface-pressure"
surface = "z_min"

[[configurations]]
name = "pushed"
role = "validation"
measured.recording = { run = "pulled" }
actuation.push = "1 GPa"
"""
    text = refusal(with_more(tmp_path, push))
    assert says(text, "configurations.pushed.actuation.push: 1 GPa ... about 200 kPa")


def test_a_prior_of_infinite_width(tmp_path):
    change = ('upper = "1 MPa"', 'upper = "1 MPa"\nprior_std = inf')
    text = refusal(write_small_project(tmp_path, change))
    assert says(
        text, "parameters.E: ... prior_std ... finite, got inf ... leave it out"
    )


@pytest.mark.parametrize("number", ["2_00", "\u0662\u0660\u0660"])
def test_digits_that_only_python_reads(tmp_path, number):
    text = refusal(write_small_project(tmp_path, ("200 kPa", f"{number} kPa")))
    assert says(text, f'material.E: ... "{number} kPa"')
    path = write_small_project(tmp_path)
    path.with_name("markers.csv").write_text(MARKERS.replace("124.", f"{number}."))
    assert says(refusal(path), f"'{number}.627615364', not a number")


def test_bare_carriage_returns_are_no_toml(tmp_path):
    path = write_small_project(tmp_path)
    lines = path.read_bytes().splitlines()
    path.write_bytes(b"\r\n".join(lines))
    load_project(path)
    path.write_bytes(b"\r".join(lines))
    assert says(refusal(path), "cannot be read as TOML")


@pytest.mark.parametrize("name", ["project.toml", "markers.csv"])
def test_a_byte_order_mark(tmp_path, name):
    """Editors of Windows put one before a text."""
    path = write_small_project(tmp_path)
    file = path.with_name(name)
    file.write_bytes(b"\xef\xbb\xbf" + file.read_bytes())
    load_project(path)
    assert quantities_as_read(path)
    assert guesses_left(path) == ()


def test_a_table_is_split_once_for_all_poses(tmp_path, monkeypatch):
    """Six windows and selections; and again if it has changed, at the same size."""
    lines, split = [], _table.read_lines
    read = lambda *given: lines.append(given) or split(*given)
    monkeypatch.setattr(_table, "read_lines", read)
    path = write_small_project(tmp_path)
    before = load_project(path).calibration[0].measured
    assert len(lines) == 1
    table = path.with_name("markers.csv")
    assert "441.464711016" in table.read_text()
    table.write_text(table.read_text().replace("441.464711016", "441.464711017"))
    assert not np.array_equal(load_project(path).calibration[0].measured, before)
    assert len(lines) == 2


LONG, SPACED = 5000 * "x", 1250 * "x y "


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("[material]", f"[material]\n{LONG} = 1"), "unknown key ... Known here"),
        (("[material]", f'[material]\n"{SPACED}" = 1'), "unknown key ... Known here"),
        (("x_min", LONG), "supports[1]: unknown group ... 'x_min'"),
        (("x_min", SPACED), "supports[1]: unknown group ... 'x_min'"),
        (('"tip", "side"', f'"{LONG}"'), "there is no marker ... side"),
        (('name = "weight"', f'name = "{LONG}"\nx = 1'), "unknown key. Known here"),
        (('field = "E"', f'field = "{LONG}"'), 'one of "E"'),
        (("200 kPa", f"200 {LONG}"), "material.E: ... like"),
        (("markers.csv", LONG), "configurations.weight.measured"),
    ],
)
def test_names_without_end_leave_room_for_the_message(tmp_path, change, message):
    text = refusal(write_small_project(tmp_path, change))
    assert len(text) < 700
    assert says(text, message)


def test_many_unknown_keys_are_refused_at_once(tmp_path, monkeypatch):
    """A known key is sought for those that are listed: for 100 000 it took 14 s."""
    sought, close = [], difflib.get_close_matches
    seek = lambda name, *rest, **more: sought.append(name) or close(name, *rest, **more)
    monkeypatch.setattr(difflib, "get_close_matches", seek)
    keys = "\n".join(f"x{i} = 1" for i in range(1000))
    text = refusal(with_more(tmp_path, f"\n[uncertain]\n{keys}\n"))
    assert text.startswith("more than 30 problems.")
    assert len(sought) == 31


def test_a_cell_without_end(tmp_path):
    path = write_small_project(tmp_path)
    path.with_name("markers.csv").write_text(
        f"{MARKERS}weight,rest,{'x' * 131_073},1,2,3"
    )
    assert says(refusal(path), "markers.csv, line 22: ... limit (131072)")


@pytest.mark.parametrize("name", ["project.toml", "markers.csv"])
@pytest.mark.parametrize("kind", ["pipe", "device"])
def test_a_file_that_is_none(tmp_path, name, kind):
    """Opened, a pipe would wait for ever, and /dev/zero would fill the memory."""
    path = write_small_project(tmp_path)
    other = path.with_name(name)
    other.unlink()
    os.mkfifo(other) if kind == "pipe" else other.symlink_to("/dev/zero")
    with pytest.raises(ProjectError) as caught:
        load_project(path)
    assert says(caught.value, f"{other} ... pipe ... device")


@pytest.mark.parametrize("name", ["project.toml", "markers.csv"])
def test_a_file_that_is_too_large(tmp_path, monkeypatch, name):
    monkeypatch.setenv("SOFTCAL_MAX_FILE_MB", "10")
    path = write_small_project(tmp_path)
    with path.with_name(name).open("r+b") as file:
        file.truncate(11_000_000)
    with pytest.raises(ProjectError, match=rf"{name}: 11 MB.* limit of 10"):
        load_project(path)


def test_a_misspelt_file_is_found_in_its_folder(tmp_path):
    text = refusal(write_small_project(tmp_path, ('"markers.csv"', '"makers.csv"')))
    assert says(text, "makers.csv ... mean 'markers.csv'")
    elsewhere = ('"markers.csv"', '"data/markers.csv"')
    text = refusal(write_small_project(tmp_path, elsewhere))
    assert says(text, f"no folder {tmp_path / 'data'}")
    with pytest.raises(FileNotFoundError, match=r"mean 'project\.toml'\?"):
        load_project(tmp_path / "projct.toml")


def test_a_negative_std_names_the_marker_and_what_was_typed(tmp_path):
    change = ('std = "0.2 mm"', 'std = "-0.2 mm"')
    text = refusal(write_small_project(tmp_path, change))
    assert says(text, 'markers.positions.side.std: got "-0.2 mm" ... above zero')


@pytest.mark.parametrize(
    ("old", "new", "where"),
    [
        ("(60, 20, 20) mm", "(60, -20, 20) mm", "mesh.beam.size"),
        ("1 g/cm^3", "-1 g/cm^3", "material.density"),
        ("200 kPa", "-200 kPa", "material.E"),
        ("200 kPa", "inf kPa", "material.E"),
        ("(60, 10, 10) mm", "(inf, 10, 10) mm", "markers.positions.tip"),
        ("(20, 0, -50) mN", "(inf, 0, 0) mN", "configurations.pulled.loads[1].force"),
        ("(0, 0, -9.81) m/s^2", "(0, 0, inf) m/s^2", "shared.gravity"),
    ],
)
def test_messages_quote_what_was_typed(tmp_path, old, new, where):
    text = refusal(write_small_project(tmp_path, (f'"{old}"', f'"{new}"')))
    assert says(text, f'{where}: got "{new}" ... finite')


def test_a_place_without_nodes_is_described(tmp_path):
    change = ('point = "(60, 0, 0) mm"', 'point = "(61, 0, 0) mm"')
    text = refusal(write_small_project(tmp_path, change))
    assert says(text, "groups.tip: no node ... plane ... (61, 0, 0) mm ... (1, 0, 0)")
    assert says(text, "(0, 0, 0) m to (60, 20, 20) mm", "1 mm away", "unit")
