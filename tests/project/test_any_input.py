"""Whatever stands in a project file, table or checkpoint: a clear error, or none."""

import json
import tomllib
import warnings
import zipfile

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from small_project import MARKERS, PROJECT, write_small_project

from softcal_jax.calibration._checkpoint import read_checkpoint, write_checkpoint
from softcal_jax.configurations import read_markers
from softcal_jax.project import ProjectError, load_project


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


def test_a_checkpoint_with_half_a_header(tmp_path):
    """NumPy's own search for old headers ends with another error than all else."""
    path, header = tmp_path / "fit.npz", "{'descr': '<f8', 'shape': (3,"
    with zipfile.ZipFile(path, "w") as file:
        content = b"\x93NUMPY\x01\x00v\x00" + header.ljust(117).encode() + b"\n"
        file.writestr("mark.npy", content)
    with pytest.raises(ValueError, match=r"fit\.npz .*checkpoint.*remove"):
        read_checkpoint(path, "mark")
