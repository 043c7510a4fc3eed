"""Recordings in project files: windows of time, and what is refused of them."""

import numpy as np
import pytest
from recordings import write_recording
from small_project import write_small_project

from softcal_jax.project import ProjectError, load_project

pytest.importorskip("ezc3d")

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


def test_windows_of_a_recording(tmp_path):
    """Frame, step and mean are undone: what is left is the motion that was put in.

    From frame 30 on the tip sinks by 2 mm in each of 24 frames: by more than 5 % of the
    whole in frame 31. 0.10 to 0.14 s later are frames 41 to 45, the mean of which is
    frame 43, 14 steps from rest.
    """
    positions = np.broadcast_to(AT_REST, (54, 5, 3)).astype(float).copy()
    positions[30:, 4, 2] -= SINKS * np.arange(1, 25)
    # Glued 1 mm off, which does not matter to displacements.
    positions[:, 4, 0] += 1.0
    about_y = np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
    seen = positions @ about_y.T + [400.0, -200.0, 100.0]
    write_recording(tmp_path / "run.c3d", seen, labels=LABELS)
    path = write_small_project(tmp_path, (SELECTED, RECORDED), *NO_ROWS)
    project = load_project(path)

    (weight,) = project.calibration
    assert tmp_path / "run.c3d" in project.files
    assert project.registrations["weight"].rms < 1e-7
    expected = 1e-3 * (AT_REST[[4, 3]] - [[0, 0, 14 * SINKS], [0, 0, 0]])
    # The file holds some hundred millimetres in single precision.
    np.testing.assert_allclose(weight.measured, expected, atol=1e-7)


CASES = {
    "rows of a recording": (
        WINDOWS.partition("\n")[0],
        'select = { phase = "loaded" }',
        "run.c3d is a recording: `select` says when, as in { between = "
        '["1.2 s", "1.4 s"] }.',
    ),
    "rest of a recording by a row": (
        'displacement_from = { between = ["0 s", "0.1 s"] }',
        'displacement_from = { phase = "rest" }',
        "run.c3d is a recording: `displacement_from` says when,",
    ),
    "registration of a recording by a row": (
        'select = { between = ["0 s", "0.1 s"] } }',
        'select = { phase = "rest" } }',
        "run.c3d is a recording: `registration.select` says when,",
    ),
    "window of a table": (
        'file = "run.c3d"',
        'file = "markers.csv"',
        "markers.csv is a table of rows: `select` names values of its columns, not a "
        "window of time.",
    ),
    "unit of a recording": (
        'file = "run.c3d"',
        'file = "run.c3d"\nlength_unit = "mm"',
        "`length_unit` is for tables; run.c3d is one recording, which states its unit",
    ),
    "one recording of many": (
        'file = "run.c3d"',
        'file = "run.c3d"\nrecording = { run = "weight" }',
        "`recording` is for tables; run.c3d is one recording,",
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
    assert message in str(caught.value)


def test_windows_outside_of_the_recording_name_their_configuration(tmp_path):
    still = np.broadcast_to(AT_REST, (20, 5, 3)).astype(float)
    write_recording(tmp_path / "run.c3d", still, labels=LABELS)
    path = write_small_project(tmp_path, (SELECTED, RECORDED), *NO_ROWS)
    with pytest.raises(ProjectError, match=r"weight.*'tip' does not"):
        load_project(path)
