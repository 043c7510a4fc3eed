import errno
import io
import json
import os
import warnings

import numpy as np
import pytest
import pyvista
from export.handmade import (
    axis_model,
    axis_space,
    make_fit,
    make_ranking,
    make_result,
    make_simulation_result,
    nowhere_before,
    small_model,
)
from matplotlib.image import imread
from rich.console import Console
from wording import says

from softcal_jax.calibration import (
    LeftOut,
    ParameterEstimate,
    ParameterInterval,
    ResidualChecks,
)
from softcal_jax.fields import Parameter, ParameterSpace
from softcal_jax.identifiability import assess, identifiability
from softcal_jax.inference import independent
from softcal_jax.plotting import rendering_problem
from softcal_jax.results import (
    Column,
    PictureWarning,
    _write,
    console as drawn,
    headline,
    latex,
    sections,
    write_results,
)

needs_opengl = pytest.mark.skipif(
    rendering_problem() is not None, reason=str(rendering_problem())
)


def names(folder):
    """Names of the files, without the list by which `force` knows them."""
    return sorted({path.name for path in folder.iterdir()} - {".softcal-files"})


def printed(tree, width=80):
    """What a terminal of 80 columns shows."""
    console = Console(width=width, file=io.StringIO())
    console.print(tree)
    return console.file.getvalue()


def answered(result):
    """What a command prints last."""
    return printed(drawn(sections(result), short=True), width=1000)


@pytest.fixture
def no_opengl(monkeypatch):
    monkeypatch.setattr(_write, "rendering_problem", lambda: "no OpenGL here")


@needs_opengl
def test_a_calibration_as_a_folder(tmp_path, capfd):
    """Nothing is written to the terminal."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        written = write_results(
            make_result(), tmp_path / "out", name="beam", timing_s={"import": 2.0}
        )
    assert capfd.readouterr() == ("", "")
    assert written == tmp_path / "out"
    assert names(tmp_path) == ["out"]
    data = json.loads((written / "result.json").read_text())
    assert names(written) == sorted(["result.json", *data["files"]])
    assert names(written) == [
        "configurations.pvd",
        "droop.png",
        "droop.vtu",
        "held_out.png",
        "held_out.vtu",
        "markers.csv",
        "report.html",
        "result.json",
    ]
    assert (data["name"], data["converged"]) == ("beam", True)
    assert data["timing_s"] == {"steps": 1.5, "import": 2.0}
    fit, held_out = data["configurations"]
    assert fit["files"] == ["droop.vtu", "droop.png"]
    assert held_out["files"] == ["held_out.vtu", "held_out.png"]
    for picture in ("droop", "held_out"):
        assert imread(written / f"{picture}.png").shape[1] >= 1200


def test_without_opengl_the_rest_is_written_and_it_is_said(tmp_path, no_opengl):
    said = "left out: droop.png, held_out.png; no OpenGL here"
    with pytest.warns(PictureWarning, match=said):
        write_results(make_result(), tmp_path / "out")
    assert names(tmp_path / "out") == [
        "configurations.pvd",
        "droop.vtu",
        "held_out.vtu",
        "markers.csv",
        "report.html",
        "result.json",
    ]
    data = json.loads((tmp_path / "out" / "result.json").read_text())
    assert data["notes"] == ["nu ended on a bound.", said]
    assert data["configurations"][0]["files"] == ["droop.vtu"]


@pytest.mark.filterwarnings("ignore::softcal_jax.results.PictureWarning")
@pytest.mark.usefixtures("no_opengl")
class TestWholeOrNotAtAll:
    def test_refused_without_force(self, tmp_path):
        write_results(make_result(), tmp_path / "out")
        with pytest.raises(FileExistsError, match=r"not empty.*--force"):
            write_results(make_result(converged=False), tmp_path / "out")
        data = json.loads((tmp_path / "out" / "result.json").read_text())
        assert data["converged"] is True

    def test_replaced_with_force(self, tmp_path):
        write_results(make_result(), tmp_path / "out")
        one = [make_fit(small_model().mesh, "other")]
        write_results(
            make_result(converged=False, fits=one), tmp_path / "out", force=True
        )
        assert names(tmp_path / "out") == [
            "configurations.pvd",
            "markers.csv",
            "other.vtu",
            "report.html",
            "result.json",
        ]
        data = json.loads((tmp_path / "out" / "result.json").read_text())
        assert data["converged"] is False
        assert names(tmp_path) == ["out"]

    @pytest.mark.parametrize("part", ["write_csv", "write_json"])
    def test_a_failure_leaves_nothing_or_what_was_there(
        self, tmp_path, monkeypatch, part
    ):
        write_results(make_result(), tmp_path / "old")
        before = (tmp_path / "old" / "result.json").read_text()

        def fail(*args, **kwargs):
            raise OSError("disk full")

        monkeypatch.setattr(_write, part, fail)
        for name in ("new", "old"):
            with pytest.raises(OSError, match="disk full"):
                write_results(make_result(converged=False), tmp_path / name, force=True)
        assert names(tmp_path) == ["old"]
        assert "droop.vtu" in names(tmp_path / "old")
        assert (tmp_path / "old" / "result.json").read_text() == before

    @pytest.mark.parametrize("part", ["body_view", "write_vtu"])
    @pytest.mark.parametrize("error", [errno.ENOSPC, KeyboardInterrupt, ValueError])
    def test_results_are_there_before_bodies(self, tmp_path, monkeypatch, part, error):
        """A full disk, Ctrl-C or a fault in what draws them leaves the results."""
        write_results(make_result(), tmp_path / "old")

        def fail(*args, **kwargs):
            if isinstance(error, int):
                raise OSError(error, os.strerror(error))
            raise error

        owner = _write
        monkeypatch.setattr(owner, part, fail)
        kind = OSError if isinstance(error, int) else error
        for name in ("new", "old"):
            with pytest.raises(kind) as caught:
                write_results(make_result(converged=False), tmp_path / name, force=True)
            if error is not ValueError:
                where = f"{tmp_path / name} holds the results, without pictures"
                assert says(str(caught.value), where)
            rows = ["markers.csv", "report.html", "result.json"]
            assert names(tmp_path / name) == rows
            data = json.loads((tmp_path / name / "result.json").read_text())
            assert data["files"] == ["report.html", "markers.csv"]
            assert data["converged"] is False
        assert names(tmp_path) == ["new", "old"]

    def test_a_simulation_too(self, tmp_path, monkeypatch):
        result = make_simulation_result(small_model(), (True,))
        write_results(result, tmp_path / "out")
        with pytest.raises(FileExistsError, match="--force"):
            write_results(result, tmp_path / "out")
        write_results(result, tmp_path / "out", force=True)
        assert names(tmp_path / "out") == [
            "configurations.pvd",
            "lane_0.vtu",
            "markers.csv",
            "report.html",
            "simulation.json",
        ]

        def fail(*args, **kwargs):
            raise OSError("disk full")

        monkeypatch.setattr(_write, "write_json", fail)
        with pytest.raises(OSError, match="disk full"):
            write_results(result, tmp_path / "new")
        assert names(tmp_path) == ["out"]


@needs_opengl
def test_a_simulation_draws_what_has_an_equilibrium(tmp_path):
    result = make_simulation_result(small_model(), (True, False, True))
    write_results(result, tmp_path / "out", name="poses")
    assert names(tmp_path / "out") == [
        "configurations.pvd",
        "lane_0.png",
        "lane_0.vtu",
        "lane_2.png",
        "lane_2.vtu",
        "markers.csv",
        "report.html",
        "simulation.json",
    ]
    data = json.loads((tmp_path / "out" / "simulation.json").read_text())
    assert (data["name"], data["converged"]) == ("poses", False)
    pictures = ["lane_0.vtu", "lane_0.png", "lane_2.vtu", "lane_2.png"]
    tables = ["report.html", "markers.csv", "configurations.pvd"]
    assert data["files"] == [*tables, *pictures]
    reader = pyvista.PVDReader(tmp_path / "out" / "configurations.pvd")
    assert [dataset.path for dataset in reader.datasets] == ["lane_0.vtu", "lane_2.vtu"]
    failed = data["configurations"][1]
    assert failed["files"] == []
    assert "inverted" in failed["outcome"]


def test_each_bound_has_a_unit_of_its_own():
    """Those that `softcal new` proposes, beside a value in kPa."""
    far = ParameterEstimate("E", 2.4e5, 6e3, 2e5, 1e4, 1e8, "Pa", False)
    text = printed(drawn(sections(make_result(parameters=(far,)))))
    assert "200 kPa │ 10 kPa to 100 MPa │" in text


def test_summary_in_80_columns():
    text = printed(drawn(sections(make_result())))
    assert "240.0 ± 6.0 kPa │ 200 kPa │ 100 kPa to 1 MPa" in text
    assert "0.44 (on a bound) │     0.4 │ 0.3 to 0.44" in text
    rows = [line for line in text.splitlines() if line.startswith("│")]
    for name, role, numbers in (
        ("droop", "calibration", ("4.00 mm", "1.00 mm", "20.00 mm", "5.0 %")),
        ("held out", "validation", ("8.00 mm", "2.00 mm", "20.00 mm", "10.0 %")),
    ):
        row = next(line for line in rows if name in line)
        assert [cell.strip() for cell in row.strip("│").split("│")] == [
            name,
            role,
            *numbers,
        ]
    assert says(text, "Notes ... nu ended on a bound.")
    assert "…" not in text


def test_what_the_others_predict_fits_in_80_columns():
    """Where they do not determine a parameter of a pose, there is a dash."""
    predicted = LeftOut("a pose with a name", 1e-3, 2e-4, 1e-2, 0.5, np.nan)
    blind = LeftOut("hidden", *[np.nan] * 5)
    checks = ResidualChecks(("a", "b", "c"), None, (predicted, blind))
    text = printed(drawn(sections(make_result(checks=checks))))
    assert "…" not in text
    rows = [line.strip("│").split("│") for line in text.splitlines()]
    table = {row[0].strip(): [cell.strip() for cell in row[1:]] for row in rows}
    assert table["a pose with a name"] == ["1.00 mm", "0.20 mm"]
    assert table["hidden"] == ["-", "-"]


def test_summary_shows_intervals_and_their_kinds():
    """A symmetric +- stands only where the first-order interval holds."""
    ends = ("likelihood", "bound")
    E = ParameterInterval("E", 0.9, 2.1e5, 1e6, *ends, "Pa", "one-sided")
    nothing = ParameterInterval(
        "nu", 0.9, 0.3, 0.44, "bound", "bound", "", "none", "too little is known"
    )
    text = printed(drawn(sections(make_result(intervals=(E, nothing)))))
    for shown in ("90 % interval", "0.21 to 1 (bound) MPa", "one-sided", "too little"):
        assert shown in text
    assert "±" not in text.replace("value ± standard error", "")
    straight = ParameterInterval(
        "E", 0.9, 2.3e5, 2.5e5, *2 * ["likelihood"], "Pa", "first-order"
    )
    text = printed(drawn(sections(make_result(intervals=(straight, nothing)))))
    assert "240.0 ± 6.0 kPa" in text
    assert "first-order" in text
    without = printed(drawn(sections(make_result())))
    assert "90 % interval" not in without
    assert "Parameters, ± not checked" in without


def judged(*rows):
    """What data with these compliances, in noise units, tell of a modulus, an angle."""
    space = axis_space()
    return identifiability(
        independent(np.array(rows), tuple(space.names)), space, space.start()
    )


def axis_result(*rows, space=None):
    """A modulus and an angle, both kept; compliances in noise units."""
    model = small_model() if space else axis_model()
    space = space or axis_space()
    values = np.deg2rad([-33.94, 0.123, 10.0, -90.0, 90.0])
    return make_result(
        model=model,
        parameters=(
            ParameterEstimate("E_t of CP 1", 5e5, 9e3, 2e5, 1e5, 1e6, "Pa", False),
            ParameterEstimate("theta of CP 1", *map(float, values), "rad", False),
        ),
        space=space,
        z=space.start(),
        # The noise of a handmade fit is 1.5 times the stated one.
        linear=independent(
            1.5 * np.array(rows or [[100.0, 0.0], [0.0, 100.0]]),
            tuple(space.names),
            scale=1.5,
        ),
    )


def test_angles_are_in_degrees():
    text = printed(drawn(sections(axis_result())))
    row = "theta of CP 1 ... -33.94 ± 0.12 deg ... 10 deg ... -90 deg to 90 deg"
    assert says(text, row)
    assert "rad" not in text


def test_summary_names_what_the_data_do_not_see():
    text = printed(drawn(sections(axis_result([100.0, 0.0]))))
    rows = [
        [cell.strip() for cell in line.strip("│").split("│")]
        for line in text.splitlines()
        if line.startswith("│")
    ]
    assert rows[-2:] == [
        # 1 % of the modulus, of which 10 % is asked for.
        ["E_t", "10 %", "identifiable"],
        ["theta", "blind", "not identifiable"],
    ]
    flat = " ".join(text.split())
    assert says(flat, "at most the target ... 0.1 ... 3 times")
    assert says(flat, "W_ep ... inf")
    assert says(flat, "1 of 2 directions ... theta (blind)")
    assert "…" not in text


@pytest.mark.parametrize(
    ("angle", "words"),
    [
        (100.0, "every check passed"),
        (20.0, "only weakly"),
        (10.0, "leave 1 of 2 directions"),
    ],
)
def test_the_answer_says_what_the_data_see(angle, words):
    text = answered(axis_result([100.0, 0.0], [0.0, angle]))
    assert words in text
    assert ("undetermined" in text) == (angle == 10.0)
    assert ("with care" in text) == (angle < 100.0)


def test_what_is_doubtful_comes_with_its_reason():
    text = answered(make_result())  # with a parameter on its bound
    assert says(text, "with care: ... nu ended on a bound")


def test_the_answer_has_few_lines_in_the_order_of_reading():
    """Value and interval, verdict, held-out error, what to do next."""
    interval = ParameterInterval(
        "E", 0.95, 2.3e5, 2.5e5, *2 * ["likelihood"], "Pa", "first-order"
    )
    E = ParameterEstimate("E", 2.4e5, 6e3, 2e5, 1e5, 1e6, "Pa", False)
    result = make_result(parameters=(E,), intervals=(interval,))
    lines = answered(result).splitlines()
    assert len(lines) <= 8
    assert lines[0] == "E = 240.0 ± 6.0 kPa (95 % interval 230 to 250 kPa)"
    order = [line.split()[0] for line in lines if not line.startswith(" ")]
    assert order == ["E", "Trust", "Held-out", "Next:", "The"]
    assert says(lines[2], "held out ... 2.00 mm ... 10.0 %")
    assert says(lines[3], "half the noise ... by 2 % through noise", "bring 1.8 %")


def test_a_mistake_that_was_found_is_what_to_look_at_next():
    text = answered(make_result(mistakes=("Swapping a and b helps.",)))
    assert says(text, "Next: check whether this mistake was made")


def test_many_values_and_reasons_are_counted():
    result = make_result(
        parameters=tuple(
            ParameterEstimate(f"E {k}", 2e5, 1e3, 2e5, 1e5, 1e6, "Pa", True)
            for k in range(12)
        )
    )
    text = answered(result)
    assert says(text, "E 7 = ... and 4 more")
    assert says(text, "E 2 ended on a bound ... and 9 more")


def test_many_blind_directions_are_counted():
    space = ParameterSpace(
        tuple(
            Parameter(f"E of {i}", "E", 2e5, 1e5, 1e6, region=f"r{i}", unit="Pa")
            for i in range(10)
        )
    )
    text = printed(drawn(sections(axis_result(*np.zeros((3, 10)), space=space))))
    assert says(text, "leave 10 of 10 directions")
    assert "and 2 more." in text


def test_an_outlook_as_a_folder(tmp_path):
    outlook = judged([100.0, 0.0])
    folder = write_results(
        outlook,
        tmp_path / "out",
        known=make_ranking(),
        name="beam",
        timing_s={"solve": 1.0},
    )
    words = ["identifiability.json", "identifiability.txt", "report.html"]
    assert names(folder) == words
    data = json.loads((folder / "identifiability.json").read_text())
    assert (data["name"], data["timing_s"]) == ("beam", {"solve": 1.0})
    assert data["files"] == ["report.html", "identifiability.txt"]
    assert data["identifiability"]["verdict"] == "not identifiable"
    text = (folder / "identifiability.txt").read_text()
    assert text.startswith(f"beam\n\n{headline(outlook)}\n")
    for said in (*outlook.blind, headline(make_ranking()), make_ranking().reached):
        assert getattr(said, "words", said) in text

    with pytest.raises(FileExistsError, match="--force"):
        write_results(outlook, folder)
    write_results(outlook, folder, force=True)
    assert json.loads((folder / "identifiability.json").read_text())["ranking"] is None


@pytest.mark.filterwarnings("ignore::softcal_jax.results.PictureWarning")
@pytest.mark.usefixtures("no_opengl")
def test_a_verdict_goes_into_the_results(tmp_path):
    folder = write_results(make_result(), tmp_path / "out")
    data = json.loads((folder / "result.json").read_text())
    assert data["identifiability"]["verdict"] == "identifiable"
    # Over it, an outlook: the calibration's files go.
    write_results(judged([1.0, 0.0]), folder, force=True)
    words = ["identifiability.json", "identifiability.txt", "report.html"]
    assert names(folder) == words


def test_the_answer_says_that_the_fit_did_not_converge():
    text = answered(make_result(converged=False))
    assert says(text, "Do not use ... did not converge ... Next: ... max_steps")


@pytest.mark.parametrize(
    ("role", "missed", "outcome"),
    [
        ("validation", 0.6, "do not use"),
        ("validation", 0.4, "take with care"),
        ("calibration", 0.6, "take with care"),
    ],
)
def test_what_misses_held_out_poses_by_far_is_not_to_be_used(role, missed, outcome):
    error = (missed * 0.02, 0.0, 0.0)  # the markers move by 20 mm
    fits = [make_fit(small_model().mesh, "pose", role, error)]
    assessment = assess(make_result(fits=fits))
    assert assessment.outcome == outcome
    assert assessment.contradicted


def test_a_renderer_of_ones_own_has_numbers_in_si_and_units_in_heads():
    """As the docs show: columns for a data frame, and LaTeX."""
    fits = [make_fit(small_model().mesh, "50 %_a")]
    tables = [t for s in sections(make_result(fits=fits)) for t in s.tables]
    (errors,) = [t for t in tables if t.title.startswith("Residuals of the markers")]
    columns = {column.title: [*column.values] for column in errors.columns}
    assert columns["configuration"] == ["50 %_a"]
    assert columns["motion"] == pytest.approx([0.02])
    lines = latex(errors).splitlines()
    assert lines[0] == r"\begin{tabular}{llrrrr}"
    assert says(lines[1], "configuration & role & before [mm] ... relative error [\\%]")
    assert lines[3] == r"50 \%\_a & calibration & 4.00 & 1.00 & 20.00 & 5.0 \\"
    assert Column("off by", [0.0, np.nan], "distance").unit == "mm"
    assert Column("turned", [0.0], "rad").texts() == ["0 deg"]
    (parameters,) = [t for t in tables if t.title.startswith("Parameters")]
    assert r"240.0 $\pm$ 6.0 kPa" in latex(parameters)  # units differ from row to row


def test_names_are_no_markup():
    """`rich` would take "[red]" for a colour and swallow it."""
    fit = make_fit(small_model().mesh, "[red]pose[/]")
    estimate = ParameterEstimate("[b]E", 2e5, 1e3, 2e5, 1e5, 1e6, "Pa", False)
    parameters = (estimate,)
    result = make_result(fits=[fit], parameters=parameters, notes=("[b]bold",))
    text = printed(drawn(sections(result)))
    assert "[red]pose[/]" in text
    assert "[b]E" in text
    assert says(text, "Notes ... [b]bold")


def test_simulation_table():
    result = make_simulation_result(small_model())
    rows = [
        [cell.strip() for cell in line.strip("│").split("│")]
        for line in printed(drawn(sections(result))).splitlines()
        if line.startswith("│")
    ]
    assert rows[0] == ["lane 0", f"{np.hypot(20, 4):.2f} mm", "4", "converged"]
    assert rows[1][:3] == ["lane 1", "-", "5"]
    assert rows[1][3].startswith("some tets are inverted")


@pytest.mark.filterwarnings("ignore::softcal_jax.results.PictureWarning")
def test_no_equilibrium_is_said_instead_of_nan(tmp_path):
    """A pose that only the start parameters cannot hold: the rest is there."""
    result = make_result(fits=[nowhere_before(make_fit(small_model().mesh))])
    table = printed(drawn(sections(result)))
    (droop,) = [line for line in table.splitlines() if "droop" in line]
    assert [cell.strip() for cell in droop.split("│")[3:5]] == ["-", "1.00 mm"]
    assert "nan" not in table
    folder = write_results(result, tmp_path / "out")
    assert "droop.vtu" in names(folder)
    data = json.loads((folder / "result.json").read_text())
    assert data["configurations"][0]["rms_before_mm"] is None
    assert "nan" not in (folder / "markers.csv").read_text()
