"""The page of a sweep: its numbers are those of the rows, finished or not."""

import re

import numpy as np
import pytest
from cheap import POINTS, measure
from test_page import HOSTILE, Read, number
from wording import says

from softcal_jax.results import check_sweep_page, write_sweep
from softcal_jax.sweeps import Outcome, Range, read_sweep, run_sweep, sample


def page_of(result, folder, **options):
    """The page of a sweep, read; what holds for all of them is checked."""
    path = write_sweep(result, folder, **options)
    assert path.name == f"{folder.name}_report.html"
    assert [file.name for file in folder.parent.glob(".softcal*")] == []
    page = Read(path.read_text(encoding="utf-8"))
    assert page.of("script") == []
    assert all(image["src"].startswith("data:") for image in page.of("img"))
    ids = [attrs["id"] for attrs in page.of("section") if "id" in attrs]
    links = [a["href"] for a in page.of("a")]
    assert {link for link in links if link[0] != "#"} == {folder.name}
    assert {link[1:] for link in links if link[0] == "#"} == set(ids)
    assert "nan" not in re.findall(r"\w+", page.text)
    assert all(len({len(row) for row in rows}) == 1 for rows in page.tables.values())
    return page


def found_at(result, figure="E found [Pa]", **point):
    """A figure of the trials there that converged."""
    return np.array(
        [
            row[figure]
            for row in result.rows
            if row["state"] == "converged" and point.items() <= row.items()
        ]
    )


@pytest.fixture(scope="module")
def measured(tmp_path_factory):
    """A finished sweep of a function, and its folder."""
    folder = tmp_path_factory.mktemp("sweep") / "sag"
    options = {"repeats": ["draw"], "workers": 0}
    return run_sweep(measure, POINTS, folder, **options), folder


def test_the_numbers_are_those_of_the_rows(measured):
    """Trials that did not converge are counted, and in no mean."""
    result, folder = measured
    page = page_of(result, folder, timing_s={"trials": 1.0})
    assert says(page.text, "24 of 24", "18 converged, 4 not converged")
    assert len(re.findall("6 trials [^.]*no mean", page.text)) == 1
    assert "ArithmeticError: no value at E = 200000" in page.text
    assert "made in Python" in page.text
    _, *rows = page.tables["Axes"]
    assert rows[0] == ["E", "factor", "2", "200000; 300000"]
    assert rows[2][:3] == ["draw", "repetition", "6"]
    head, *rows = page.tables["Means"]
    for row in rows:
        E = found_at(result, E=float(row[0]), kind=row[1])
        assert number(row[head.index("E found")]) == pytest.approx(
            E.mean() / 1e3, abs=0.5
        )
    (_, n, mean, least, median, most), _ = page.tables["Figures of the trials"][1:]
    E = found_at(result) / 1e3
    assert int(n) == E.size == 18
    assert number(mean) == pytest.approx(E.mean(), abs=0.5)
    ends = [number(value) for value in (least, median, most)]
    assert ends == pytest.approx([E.min(), np.median(E), E.max()], rel=1e-4)
    # E found over three axes; the other never varies.
    over = [f"E found over {axis}" for axis in ("E", "kind", "draw")]
    assert [image["alt"] for image in page.of("img")] == over
    head, *rows = page.tables["Trials"]
    assert [row[head.index("outcome")] for row in rows] == [
        row["state"] for row in result.rows
    ]


def test_the_best_are_told_by_what_is_held_out(tmp_path):
    def fit(trial):
        E, good = trial["E"], trial["E"] > 2.1e5
        errors = {
            "fit rms [m]": 1.0 / E,
            "held-out rms [m]": 1e-3 * (E / 3e5 - 0.8) ** 2,
        }
        return Outcome({**errors, "E [Pa]": E, "steps": 3}, good)

    folder = tmp_path / "fits"
    points = sample({"E": Range(2e5, 3e5)}, 20)
    result = run_sweep(fit, points, folder, workers=0)
    page = page_of(result, folder)
    good = [row for row in result.rows if row["state"] == "converged"]
    by_error = sorted(good, key=lambda row: row["held-out rms [m]"])
    head, *rows = page.tables["Best trials"]
    shown = [1e3 * number(row[head.index("E found")]) for row in rows]
    assert shown == pytest.approx([row["E"] for row in by_error[:5]], rel=1e-4)
    assert says(page.text, "lowest held-out rms", f"{len(good)} trials")
    assert "Means" not in page.tables  # there are no repetitions
    values = sorted(row["E"] for row in result.rows)
    assert page.tables["Axes"][1][3] == f"from {values[0]:.6g} to {values[-1]:.6g}"
    (chart,) = page.of("img")
    assert chart["alt"] == "held-out rms, E over E"


def test_a_sweep_that_was_stopped_and_goes_on(tmp_path):
    """The page says what is left, and is replaced; none has converged at first."""
    folder = tmp_path / "sag"

    class Stopped(Exception):
        pass

    def stop(now):
        if now.ended == 1:
            raise Stopped

    points = [{"E": 2e5, "kind": "v", "draw": draw} for draw in (3, 0, 1)]
    with pytest.raises(Stopped):
        run_sweep(measure, points, folder, workers=0, progress=stop)
    result = read_sweep(folder)
    page = page_of(result, folder)
    assert says(page.text, "1 of 3 trials", "1 failed")
    assert any("verdict bad" in section["class"] for section in page.of("section"))
    assert says(page.text, "2 trials are left")
    assert says(page.text, "No trial has converged")
    result = run_sweep(measure, points, folder, workers=0)
    page = page_of(result, folder)
    assert says(page.text, "3 of 3 trials ... 2 converged, 1 failed")
    assert "left to do" not in page.text


@pytest.mark.parametrize("name", ["sag", "é & <b>"])
def test_a_file_of_the_user_is_not_replaced(tmp_path, name):
    folder = tmp_path / name
    check_sweep_page(folder)
    (tmp_path / f"{name}_report.html").write_text("mine")
    with pytest.raises(FileExistsError, match=r"not a page .*another name"):
        check_sweep_page(folder)


def test_hostile_names_stay_text(tmp_path):
    """In axes, values, figures, reasons and notes."""

    def hostile(trial):
        if trial[HOSTILE] == "b":
            raise ValueError(HOSTILE)
        return Outcome({HOSTILE: trial["n"]}, notes=[HOSTILE])

    points = [{HOSTILE: value, "n": n} for value in (HOSTILE, "b") for n in (1, 2)]
    folder = tmp_path / "x"
    result = run_sweep(hostile, points, folder, name=HOSTILE, workers=0)
    page = page_of(result, folder)
    shown = HOSTILE.replace("\x1b", "\\x1b").replace("\u202e", "\\u202e")
    assert page.texts.count(shown) >= 5
    text = (tmp_path / "x_report.html").read_text(encoding="utf-8")
    assert "<img src=x" not in text
    assert "\x1b" not in text
