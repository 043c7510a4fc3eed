"""Whatever stands in a project file, table or checkpoint: a clear error, or none."""

import json
import math
import tomllib
import warnings
import zipfile
from functools import partial

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from recordings import (
    motion,
    write_motive,
    write_qualisys,
    write_vicon,
)
from small_project import MARKERS, PROJECT, write_small_project

from softcal_jax.calibration._checkpoint import read_checkpoint, write_checkpoint
from softcal_jax.exchange.camera import read_photo, tag_cells
from softcal_jax.project import ProjectError, load_project
from softcal_jax.readings import read_markers, read_recording
from softcal_jax.results import ResultError, load_values
from softcal_jax.sweeps import grid, read_sweep, run_sweep


def number_of_examples(few, many):
    """A few by default; `-m slow` tries more."""
    several = [few, pytest.param(many, marks=pytest.mark.slow)]
    return pytest.mark.parametrize("n", several)


def check(n, strategy, function):
    """Call a function with n examples, which are the same in every run."""
    alike = settings(max_examples=n, deadline=None, derandomize=True, database=None)
    alike(given(strategy)(function))()


def result_or_refusal(error, call):
    """What a call returns, and the text of the error that it ends with instead."""
    try:
        return call(), ""
    except error as refused:
        return None, str(refused)


def keys(table, path=()):
    """All keys and indices of a parsed file, as paths."""
    pairs = table.items() if isinstance(table, dict) else enumerate(table)
    for key, value in pairs:
        yield (*path, key)
        if isinstance(value, dict | list):
            yield from keys(value, (*path, key))


def as_toml(value):
    """A value of a TOML file; tables are written inline."""
    if isinstance(value, dict):
        pairs = (f"{as_toml(k)} = {as_toml(v)}" for k, v in value.items())
        return "{ " + ", ".join(pairs) + " }"
    if isinstance(value, list):
        return "[" + ", ".join(map(as_toml, value)) + "]"
    if isinstance(value, float):
        return repr(value)
    return json.dumps(value, ensure_ascii=False)


SMALL = tomllib.loads(PROJECT)
WORDS = st.text(
    st.characters(codec="utf-8", exclude_categories=["Cs", "Cc"]), max_size=8
)
QUANTITIES = st.builds(
    "{} {}".format,
    st.floats() | st.integers(-9, 9) | st.sampled_from(["(1, 2, 3)", "(0, nan, 1)"]),
    st.sampled_from(["kPa", "mm", "N", "kg/m^3", "m/s^2", "deg", "", "%", "1/0 m"]),
)
SCALARS = (
    st.none().map(lambda _: {})
    | st.booleans()
    | st.integers(-(2**63), 2**63 - 1)
    | st.floats()
    | WORDS
    | QUANTITIES
    | st.sampled_from(["x_min", "tip", "weight", "E", "neo-hookean", "markers.csv"])
)
VALUES = st.recursive(
    SCALARS,
    lambda inner: (
        st.lists(inner, max_size=4) | st.dictionaries(WORDS, inner, max_size=3)
    ),
    max_leaves=4,
)
CHANGES = st.lists(
    st.tuples(st.sampled_from(sorted(keys(SMALL), key=repr)), VALUES),
    min_size=1, max_size=2,
)  # fmt: skip


def changed(changes):
    """The small project with values exchanged, where their places are left."""
    table = tomllib.loads(PROJECT)
    for path, value in changes:
        inside = table
        for key in path[:-1]:
            inside = inside[key] if _has(inside, key) else None
        if _has(inside, path[-1]):
            inside[path[-1]] = value
    return "\n".join(f"{as_toml(k)} = {as_toml(v)}" for k, v in table.items())


def _has(table, key):
    if isinstance(table, dict):
        return key in table
    return isinstance(table, list) and isinstance(key, int) and key < len(table)


@number_of_examples(60, 3000)
@pytest.mark.usefixtures("unchecked")
def test_any_value_in_a_project_file(tmp_path, n):
    path = write_small_project(tmp_path)

    def load(changes):
        path.write_text(changed(changes), encoding="utf-8")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # numbers that are hard to believe
            project, text = result_or_refusal(ProjectError, lambda: load_project(path))
        assert project is not None or text.startswith(str(path))

    load([])
    check(n, CHANGES, load)


RESULT = {
    "format": "softcal_jax.result/2",
    "converged": True,
    "source": None,
    "parameters": [{"name": "E", "value": 2e5, "lower": 1e5, "upper": 1e6}],
    "configurations": [{"name": "pulled", "rms_after_mm": 0.1}],
    "solver": {"n_tets": 18},
    "budget": {"covariance": [[1e-4]]},
    "assessment": {"reasons": []},
    "versions": {"softcal_jax": "0.1.0"},
}
"""The least that is read of a calibration."""


@pytest.mark.parametrize("bad", [math.nan, math.inf, 0.0, -2e5, True, "2e5", None, []])
def test_a_value_that_no_calibration_gives(tmp_path, bad):
    path = tmp_path / "result.json"
    changed = RESULT["parameters"][0] | {"value": bad}
    path.write_text(json.dumps(RESULT | {"parameters": [changed]}))
    with pytest.raises(ResultError, match=r"result\.json: .*(value of E|0\.value)"):
        load_values(path)


@pytest.mark.parametrize(
    ("key", "bad"),
    [
        ("budget", {"covariance": [[1e-4, 0.0], [0.0, 1e-4]]}),
        ("budget", {"covariance": [[]]}),
        ("budget", {"covariance": [[-1e-4]]}),
        ("converged", "yes"),
        ("converged", 1),
        ("format", 2),
    ],
)
def test_a_result_that_no_calibration_writes(tmp_path, key, bad):
    path = tmp_path / "result.json"
    path.write_text("\ufeff" + json.dumps(RESULT), encoding="utf-8")
    assert load_values(path) == {"E": 2e5}
    path.write_text(json.dumps(RESULT | {key: bad}))
    with pytest.raises(ResultError, match=rf"result\.json: .*{key}"):
        load_values(path)


def test_a_result_that_is_nested_without_end(tmp_path):
    path = tmp_path / "result.json"
    path.write_text('{"a": ' * 100_000 + "1" + "}" * 100_000)
    with pytest.raises(ResultError, match="recursion"):
        load_values(path)


@number_of_examples(60, 3000)
@pytest.mark.filterwarnings("ignore::softcal_jax.results.ResultWarning")
def test_any_value_in_a_result(tmp_path, n):
    path = tmp_path / "result.json"

    def change(path_and_value):
        where, value = path_and_value
        content = json.loads(json.dumps(RESULT))
        inside = content
        for key in where[:-1]:
            inside = inside[key]
        inside[where[-1]] = value
        path.write_text(json.dumps(content))
        values, text = result_or_refusal(ResultError, lambda: load_values(path))
        if values is None:
            assert text.startswith(str(path))
        else:
            assert all(1e5 <= value <= 1e6 for value in values.values())

    places = st.sampled_from(sorted(keys(RESULT), key=repr))
    kept = places.filter(
        lambda place: place[-1] not in ("lower", "upper", "parameters", 0)
    )
    check(n, st.tuples(kept, VALUES), change)


CELLS = st.text(max_size=6) | st.sampled_from(["", "nan", "1,5", '"', ";", "#", "=1+1"])


@number_of_examples(200, 5000)
def test_any_table(tmp_path, n):
    path = tmp_path / "markers.csv"
    lines = MARKERS.splitlines()

    def change_it(change):
        row, column, cell = change
        cells = lines[row].split(",")
        cells[column] = cell
        text = "\n".join([*lines[:row], ",".join(cells), *lines[row + 1 :]])
        path.write_text(text, encoding="utf-8", errors="surrogatepass")
        rest = {"run": "weight", "phase": "rest"}
        read = lambda: read_markers(path, select=rest)
        table, refused = result_or_refusal(ValueError, read)
        if table is None:
            assert refused.startswith(str(path))
        else:
            assert table.positions.shape == (len(table.names), 3)

    places = st.integers(0, len(lines) - 1), st.integers(0, 5)
    check(n, st.tuples(*places, CELLS), change_it)


@number_of_examples(100, 5000)
def test_any_bytes_as_a_table(tmp_path, n):
    path = tmp_path / "markers.csv"

    def read(content):
        path.write_bytes(content)
        with pytest.raises(ValueError, match=r"markers\.csv"):
            read_markers(path)

    check(n, st.binary(max_size=300), read)


@number_of_examples(200, 10_000)
def test_any_checkpoint(tmp_path, n):
    """One that was changed is refused, or none of what it holds has changed."""
    path = tmp_path / "fit.npz"
    write_checkpoint(path, "mark", {"state_0": np.arange(3.0)}, [])
    whole = path.read_bytes()

    def change_it(change):
        at, new, cut = change
        path.write_bytes((whole[:at] + new + whole[at + len(new) :])[:cut])
        read = lambda: read_checkpoint(path, "mark")
        loaded, text = result_or_refusal(ValueError, read)
        if loaded is None:
            assert str(path) in text
        else:
            arrays, history = loaded
            np.testing.assert_array_equal(arrays["state_0"], np.arange(3.0))
            assert history == []

    ends = st.just(len(whole)) | st.integers(0, len(whole))
    places = st.integers(0, len(whole))
    check(n, st.tuples(places, st.binary(min_size=1, max_size=40), ends), change_it)


def recorded(write, name, **options):
    def make(folder):
        return write(folder / name, motion(4) + 1.0, **options)

    return make


def a_photograph(folder):
    cv2 = pytest.importorskip("cv2", reason="reads photographs")
    white = np.pad(np.kron(tag_cells(3), np.ones((6, 6))), 12, constant_values=1.0)
    assert cv2.imwrite(str(folder / "a.png"), (255 * white).astype(np.uint8))
    return folder / "a.png"


def a_result(folder):
    path = folder / "result.json"
    path.write_text(json.dumps(RESULT))
    return path


def a_sweep(folder):
    points = grid({"E": [1, 2]})
    run_sweep(lambda trial: {"x": 1.5}, points, folder / "s", workers=0)
    return folder / "s" / "rows.parquet"


def a_project(folder):
    return write_small_project(folder)


def shown(path):
    return str(read_sweep(path.parent))


in_mm = partial(read_recording, length_unit="mm")
FILES = {
    "motive": (recorded(write_motive, "a.csv"), read_recording),
    "vicon": (recorded(write_vicon, "a.csv"), read_recording),
    "qualisys": (recorded(write_qualisys, "a.tsv"), in_mm),
    "photograph": (a_photograph, read_photo),
    "result": (a_result, load_values),
    "sweep": (a_sweep, shown),
    "project": (a_project, partial(load_project, solve=False)),
}


@number_of_examples(25, 1500)
@pytest.mark.parametrize("kind", FILES)
@pytest.mark.filterwarnings("ignore::softcal_jax._text.SoftcalWarning")
@pytest.mark.usefixtures("unchecked")
def test_any_damage_to_a_file(tmp_path, kind, n):
    """Bytes changed, put in or cut off: what commands show as bad input, or none."""
    make, read = FILES[kind]
    path = make(tmp_path)
    whole = path.read_bytes()
    places = st.integers(0, len(whole))
    sizes = st.sampled_from([0, 1, 2, 8, len(whole)])
    content = st.binary(max_size=8) | st.sampled_from(
        [b"nan", b"1e400", b"-", b"null", b"[" * 3000, b"\xff\xfe", b'"', b"\n"]
    )

    def damage(change):
        at, gone, new = change
        path.write_bytes(whole[:at] + new + whole[at + gone :])
        result_or_refusal((ValueError, OSError), lambda: read(path))

    read(path)
    check(n, st.tuples(places, sizes, content), damage)


def test_a_checkpoint_with_half_a_header(tmp_path):
    """NumPy's own search for old headers ends with another error than all else."""
    path, header = tmp_path / "fit.npz", "{'descr': '<f8', 'shape': (3,"
    with zipfile.ZipFile(path, "w") as file:
        content = b"\x93NUMPY\x01\x00v\x00" + header.ljust(117).encode() + b"\n"
        file.writestr("mark.npy", content)
    with pytest.raises(ValueError, match=r"fit\.npz .*checkpoint.*remove"):
        read_checkpoint(path, "mark")
