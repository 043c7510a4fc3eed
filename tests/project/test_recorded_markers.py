"""Recordings in project files: windows of time, and what is refused of them."""

import numpy as np
import pytest
from recordings import write_qualisys, write_recording, write_vicon
from small_project import write_small_project
from wording import says

from softcal_jax.project import ProjectError, load_project

pytest.importorskip("ezc3d")  # what is refused does not depend on the kind of file

SELECTED = (
    'file = "markers.csv"\n'
    'select = { phase = "loaded" }\n'
    'displacement_from = { phase = "rest" }\n'
    'registration = { markers = ["a", "b", "c"], select = { phase = "rest" } }'
)
WINDOWS = (
    'select = { between = ["0.1 s", "140 ms"], after_step_of = "tip" }\n'
    'displacement_from = { between = ["0 s", "0.1 s"] }\n'
    'registration = { markers = ["a", "b", "c"], '
    'select = { between = ["0 s", "0.1 s"] } }'
)
RECORDED = f'file = "run.c3d"\n{WINDOWS}'
NO_ROWS = (
    ('measured.recording = { run = "weight" }\n', ""),
    ('measured.recording = { run = "pulled" }\n', ""),
)

LABELS = ("a", "b", "c", "side", "tip")
AT_REST = np.array([[0, 0, 0], [0, 20, 0], [0, 0, 20], [60, 20, 0], [60, 10, 10]])
SINKS = 2.0  # mm in each frame


def sinking(sinks=SINKS, off=0.0):
    """What cameras see in a frame of their own; the tip may also be `off`.

    From frame 30 on the tip sinks by 2 mm in each of 24 frames: by more than 5 % of the
    whole in frame 31. 0.10 to 0.14 s later are frames 41 to 45, the mean of which is
    frame 43, 14 steps from rest.
    """
    positions = np.broadcast_to(AT_REST, (54, 5, 3)).astype(float).copy()
    positions[30:, 4, 2] -= sinks * np.arange(1, 25)
    # Glued 1 mm off, which does not matter to displacements.
    positions[:, 4, 0] += 1.0
    positions[:, 4] += off
    about_y = np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
    return positions @ about_y.T + [400.0, -200.0, 100.0]


EXPECTED = 1e-3 * (AT_REST[[4, 3]] - [[0, 0, 14 * SINKS], [0, 0, 0]])


def test_windows_of_a_recording(tmp_path):
    """Frame, step and mean are undone: what is left is the motion that was put in."""
    write_recording(tmp_path / "run.c3d", sinking(), labels=LABELS)
    path = write_small_project(tmp_path, (SELECTED, RECORDED), *NO_ROWS)
    project = load_project(path)

    (weight,) = project.calibration
    assert tmp_path / "run.c3d" in project.files
    assert project.registrations["weight"].rms < 1e-7
    # The file holds some hundred millimetres in single precision.
    np.testing.assert_allclose(weight.measured, EXPECTED, atol=1e-7)
    traces = project.traces["weight"]
    assert traces.names == ("tip", "side")
    assert traces.windows["select"] == pytest.approx((0.41, 0.45))
    assert traces.windows["registration.select"] == pytest.approx((0.0, 0.1))


def test_windows_of_a_wide_table(tmp_path):
    """The same of a table, with labels of its own and a window around a time."""
    labels = [f"Robot:{name}" for name in LABELS]
    write_qualisys(tmp_path / "run.tsv", sinking(), labels=labels)
    mapped = ", ".join(f'{name} = "Robot:{name}"' for name in LABELS)
    changed = RECORDED.replace("run.c3d", "run.tsv").replace(
        'between = ["0.1 s", "140 ms"]', 'at = "120 ms", width = "40 ms"'
    )
    changed += f'\nlength_unit = "mm"\nlabels = {{ {mapped} }}'
    path = write_small_project(tmp_path, (SELECTED, changed), *NO_ROWS)
    (weight,) = load_project(path).calibration
    np.testing.assert_allclose(weight.measured, EXPECTED, atol=1e-9)


def test_a_recording_is_not_read_as_rows(tmp_path):
    write_vicon(tmp_path / "markers.csv", sinking(), labels=LABELS)
    path = write_small_project(tmp_path)
    write_vicon(tmp_path / "markers.csv", sinking(), labels=LABELS)
    with pytest.raises(ProjectError, match=r"recording over time.*`select`"):
        load_project(path)


def test_labels_of_rows(tmp_path):
    """Names of a file map to those of the project, whatever kind of file it is."""
    labels = 'file = "markers.csv"\nlabels = { tip = "marker 7" }\n'
    path = write_small_project(tmp_path, ('file = "markers.csv"\n', labels))
    (weight,) = load_project(write_small_project(tmp_path / "as_is")).calibration
    table = tmp_path / "markers.csv"
    table.write_text(table.read_text().replace(",tip,", ",marker 7,"))
    (renamed,) = load_project(path).calibration
    np.testing.assert_array_equal(renamed.measured, weight.measured)


@pytest.mark.parametrize("stated", [True, False])
def test_scatter_adds_to_the_stated_noise(tmp_path, stated):
    """In the frame of the mesh: what scatters along its x is along z of the cameras."""
    rng = np.random.default_rng(0)
    off = [0.3, 0.2, 0.1] * rng.normal(size=(54, 3))
    seen = sinking(sinks=0.0, off=off)
    write_qualisys(tmp_path / "run.tsv", seen, labels=LABELS)
    changed = (
        'file = "run.tsv"\nlength_unit = "mm"\nscatter = true\n'
        'select = { between = ["0.3 s", "0.5 s"] }\n'
        'displacement_from = { between = ["0 s", "0.1 s"] }\n'
        'registration = { markers = ["a", "b", "c"], '
        'select = { between = ["0 s", "0.1 s"] } }'
    )
    changes = [(SELECTED, changed), *NO_ROWS, ('"tip", "side"', '"tip"')]
    if not stated:
        changes.append(('[markers]\nstd = "0.1 mm"\n', "[markers]\n"))
        changes.append((', std = "0.2 mm" }', " }"))
    path = write_small_project(tmp_path, *changes)
    (weight,) = load_project(path).calibration
    loaded, rest = off[30:51].std(axis=0, ddof=1), off[:11].std(axis=0, ddof=1)
    std = 1e-3 * np.sqrt(loaded**2 + rest**2 + (0.1 if stated else 0.0) ** 2)
    np.testing.assert_allclose(weight.markers.std, [std], rtol=1e-4)


CASES = {
    "one recording of many": (
        'file = "run.c3d"',
        'file = "run.c3d"\nrecording = { run = "weight" }',
        "`recording` is for rows",
    ),
    "unknown delimiter": (
        'file = "run.c3d"',
        'file = "run.c3d"\ndelimiter = "-"',
        'shared.measured.delimiter: got "-" ... ",", ";"',
    ),
    "two kinds of window": (
        '["0.1 s", "140 ms"]',
        '["0.1 s", "140 ms"], at = "0.1 s"',
        "shared.measured.select: got between and at ... between",
    ),
    "width of nothing": (
        '["0.1 s", "140 ms"]',
        '["0.1 s", "140 ms"], width = "0.1 s"',
        "shared.measured.select: width ... `at`",
    ),
    "three times": (
        '["0.1 s", "140 ms"]',
        '["0.1 s", "0.2 s", "0.3 s"]',
        "shared.measured.select.between",
    ),
    "no time": ('"140 ms"', '"140 mm"', "shared.measured.select.between"),
}


@pytest.mark.parametrize(("old", "new", "message"), CASES.values(), ids=CASES)
def test_refused(tmp_path, old, new, message):
    """Before any file is read."""
    assert RECORDED.count(old) == 1
    changed = (SELECTED, RECORDED.replace(old, new))
    path = write_small_project(tmp_path, changed, *NO_ROWS)
    with pytest.raises(ProjectError) as caught:
        load_project(path)
    assert says(caught.value, message)


OF_THE_FILE = {
    "rows of a recording": (
        WINDOWS.partition("\n")[0],
        'select = { phase = "loaded" }',
        "run.c3d ... over time ... `select` ... { between",
    ),
    "rest of a recording by a row": (
        'displacement_from = { between = ["0 s", "0.1 s"] }',
        'displacement_from = { phase = "rest" }',
        "run.c3d ... over time ... `displacement_from`",
    ),
    "registration of a recording by a row": (
        'select = { between = ["0 s", "0.1 s"] } }',
        'select = { phase = "rest" } }',
        "run.c3d ... over time ... `registration.select`",
    ),
    "window of a table": (
        'file = "run.c3d"',
        'file = "markers.csv"',
        "markers.csv ... table ... column marker ... rows by values",
    ),
    "unit of a recording": (
        'file = "run.c3d"',
        'file = "run.c3d"\nlength_unit = "mm"',
        "length_unit ... tables; leave",
    ),
    "delimiter of a recording": (
        'file = "run.c3d"',
        'file = "run.c3d"\ndelimiter = ";"',
        "delimiter ... tables; leave",
    ),
    "event and step": (
        'after_step_of = "tip"',
        'after_step_of = "tip", after_event = "valve"',
        "not both",
    ),
    "unknown event": (
        'after_step_of = "tip"',
        'after_event = "valve"',
        "run.c3d: ... 'valve' ... Known: none",
    ),
    "label of no marker": (
        'file = "run.c3d"',
        'file = "run.c3d"\nlabels = { tp = "tip" }',
        'configurations.weight.measured.labels: ... "tp" ... mean',
    ),
    "no such label": (
        'file = "run.c3d"',
        'file = "run.c3d"\nlabels = { tip = "Tip - 1" }',
        "run.c3d ... 'Tip - 1'",
    ),
}


@pytest.mark.parametrize(
    ("old", "new", "message"), OF_THE_FILE.values(), ids=OF_THE_FILE
)
def test_refused_once_the_file_is_read(tmp_path, old, new, message):
    assert RECORDED.count(old) == 1
    write_recording(tmp_path / "run.c3d", sinking(), labels=LABELS)
    changed = (SELECTED, RECORDED.replace(old, new))
    path = write_small_project(tmp_path, changed, *NO_ROWS)
    with pytest.raises(ProjectError) as caught:
        load_project(path)
    assert says(caught.value, message)


def test_windows_outside_of_the_recording_name_their_configuration(tmp_path):
    still = np.broadcast_to(AT_REST, (20, 5, 3)).astype(float)
    write_recording(tmp_path / "run.c3d", still, labels=LABELS)
    path = write_small_project(tmp_path, (SELECTED, RECORDED), *NO_ROWS)
    with pytest.raises(ProjectError, match=r"weight.*'tip' does not"):
        load_project(path)
