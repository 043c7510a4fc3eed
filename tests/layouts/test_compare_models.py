"""Laws and meshes: ranking, what tells them apart, and what is refused."""

import json

import numpy as np
import pytest
from bars import MID, TIP, bar, pose
from scipy.stats import sem, ttest_rel
from small_project import MARKERS, write_small_project
from wording import says

from softcal_jax.cli import main
from softcal_jax.configurations import Markers
from softcal_jax.fields import Parameter
from softcal_jax.layouts import (
    FoldScore,
    ModelComparison,
    ModelScore,
    PairedDifference,
    compare_laws,
)
from softcal_jax.project import ProjectError, compare_projects, load_project
from softcal_jax.results import headline, result_dict

POSES = ("a", "b", "c", "d", "e")
ROOT = [4.0, 9.0, 1.0, 16.0, 2.0]


def score(name, squares, n_parameters=1, failed=()):
    """A model with given squared errors on held-out poses, in units of the noise."""
    folds = [
        FoldScore(p, np.nan, np.nan, np.nan, "no equilibrium")
        if p in failed
        else FoldScore(p, 1e-3, float(np.sqrt(s)), 1e-3)
        for p, s in zip(POSES, squares, strict=False)
    ]
    return ModelScore(name, n_parameters, tuple(folds), 1e-3, 1.0, "", None)


def worse(*by):
    return [a + b for a, b in zip(ROOT, by, strict=True)]


def test_paired_differences_are_those_of_the_t_test():
    """Told apart where SciPy's paired test says so, at two-sided 95 %."""
    for by in ([1, 2, 1.5, 1, 2], [5, -1, 3, -2, 4], [0.1, 0.1, 0.1, 0.1, 0.11]):
        pair = PairedDifference.of(score("x", worse(*by)), score("best", ROOT))
        np.testing.assert_allclose(pair.difference, np.mean(by), rtol=1e-12)
        test = ttest_rel(worse(*by), ROOT)
        assert pair.told_apart == (test.pvalue < 0.05)
        interval = test.confidence_interval(0.95)
        np.testing.assert_allclose(
            [pair.difference - pair.half_width, pair.difference + pair.half_width],
            [interval.low, interval.high],
            rtol=1e-9,
        )


def test_pairing_sees_what_the_errors_alone_hide():
    """A constant disadvantage far below the scatter of the errors."""
    near, best = score("near", worse(0.5, 0.6, 0.5, 0.4, 0.5)), score("best", ROOT)
    assert near.score - best.score < 0.5 * sem(ROOT)
    compared = ModelComparison.ranked([near, best])
    assert [m.name for m in compared.models] == ["best", "near"]
    assert compared.undecided == ()
    assert says(headline(compared), "distinguish ... 'near'")


def test_the_verdict_names_what_is_undecided():
    best = score("yeoh", ROOT, n_parameters=3)
    close = score("neo-hookean", worse(5, -4, 3, -3, 4))
    bad = score("gent", worse(9, 9, 8, 9, 9), n_parameters=2)
    result = ModelComparison.ranked([bad, close, best])
    assert result.undecided == ("neo-hookean",)
    numbers, others = "1 mm, 2.53 times", "'neo-hookean' ... 'gent' ... 'neo-hookean'"
    assert says(headline(result), "'yeoh'", numbers, "cannot", others, "fewest")
    text = str(result)
    assert text.splitlines()[0] == headline(result)
    assert "8.80 ± 0.56" in text  # 2.776 standard errors: four degrees of freedom
    data = json.loads(json.dumps(result_dict(result), allow_nan=False))
    assert data["best"] == "yeoh"
    assert [m["name"] for m in data["models"]] == ["yeoh", "neo-hookean", "gent"]
    assert [d["told_apart"] for d in data["differences"]] == [False, True]
    assert data["models"][0]["folds"][1]["noise_rms"] == 3.0


def test_failed_folds_rank_last_and_are_named():
    whole, broken = score("whole", worse(1, 1, 1, 1, 1)), score("broken", ROOT, 1, "b")
    compared = ModelComparison.ranked([broken, whole])
    assert compared.best.name == "whole"
    assert says(headline(compared), "No other model")
    assert says(compared, "'broken', b ... no equilibrium")
    none = ModelComparison.ranked([broken])
    assert none.best is None
    assert says(headline(none), "No model")
    assert json.dumps(result_dict(none), allow_nan=False)
    assert result_dict(none)["best"] is None


def test_two_configurations_decide_little():
    """One degree of freedom: the interval is 12.7 standard errors wide."""
    pair = PairedDifference.of(score("x", [5.0, 12.0]), score("best", [4.0, 9.0]))
    assert pair.n == 2
    factor = pair.half_width / pair.standard_error
    np.testing.assert_allclose(factor, 12.706, rtol=1e-4)
    assert not pair.told_apart


E = Parameter("E", "E", 1e5, 3e4, 1e6, region="root")


def measured(name, force, std=1e-4, off=0.0):
    nominal = pose(name, (MID, TIP), force=force)
    markers = Markers(nominal.markers.names, nominal.markers.positions, std)
    return type(nominal)(
        nominal.name,
        nominal.supports,
        nominal.gravity,
        nominal.loads,
        markers,
        np.asarray(nominal.markers.positions) + off,
    )


def test_bad_input():
    model = bar((6, 1, 1))
    poses = [measured("a", (0.0, 0.1, 0.0)), measured("b", (0.1, 0.0, 0.0))]
    with pytest.raises(ValueError, match="at least one model"):
        compare_laws({}, poses)
    with pytest.raises(ValueError, match=r"at least 2 .* 1\."):
        compare_laws({"one": (model, E)}, poses[0])
    with pytest.raises(ValueError, match=r"starts .* 1, got 0"):
        compare_laws({"one": (model, E)}, poses, starts=0)
    wrong = Parameter("c10", "c10", 1e5, 3e4, 1e6)
    with pytest.raises(ValueError, match=r"'two': .*'c10' .*law\.E"):
        compare_laws({"one": (model, E), "two": (model, wrong)}, poses)


def called(name):
    return 'name = "small"', f'name = "{name}"'


FITTED = ('role = "validation"\nloads', "loads")


def test_projects_must_have_the_same_data(tmp_path):
    one = load_project(write_small_project(tmp_path / "one", FITTED))
    with pytest.raises(ProjectError, match=r"two projects, got 1"):
        compare_projects([one])
    with pytest.raises(ProjectError, match=r"twice: .*one"):
        compare_projects([one, one])
    fewer = load_project(write_small_project(tmp_path / "fewer"))
    with pytest.raises(ProjectError, match=r"fewer.* weight, but .* weight, pulled"):
        compare_projects([one, fewer])
    path = write_small_project(tmp_path / "other", FITTED, called("x"))
    (path.parent / "markers.csv").write_text(MARKERS.replace("441.464711016", "441.2"))
    with pytest.raises(ValueError, match=r"'x' .*same measurements .*'small'"):
        compare_projects([one, load_project(path)])
    code = main(["compare", str(one.path), str(tmp_path / "nowhere.toml")])
    assert code == 2


@pytest.mark.slow
def test_command(tmp_path, capsys):
    """The law that made the recordings predicts best; a body too soft cannot."""
    paths = [
        write_small_project(tmp_path / "true", FITTED, called("true")),
        write_small_project(
            tmp_path / "soft",
            FITTED,
            called("soft"),
            ('lower = "100 kPa"', 'lower = "190 kPa"'),
            ('upper = "1 MPa"', 'upper = "210 kPa"'),
        ),
    ]
    out = tmp_path / "out"
    assert main(["compare", *map(str, paths), "-o", str(out)]) == 0
    said = capsys.readouterr().out
    assert "'true' has the smallest held-out error" in said
    data = json.loads((out / "comparison.json").read_text())
    assert data["best"] == "true"
    assert list(data["sources"]) == list(data["settings"]) == ["true", "soft"]
    files = " ".join(source["project"]["file"] for source in data["sources"].values())
    assert f"softcal compare {files} -o repeated" in (out / "report.html").read_text()
    true, soft = data["models"]
    assert {f["held_out"] for f in true["folds"]} == {"weight", "pulled"}
    # The recordings are equilibria of this law, and the side marker is 1 mm off.
    assert true["held_out_rms_mm"] < 0.02
    assert soft["held_out_rms_mm"] > 5 * true["held_out_rms_mm"]
    assert (out / "comparison.txt").read_text().startswith(data["verdict"])
