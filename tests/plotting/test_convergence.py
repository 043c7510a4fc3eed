from dataclasses import replace

import numpy as np
import pytest
from export.handmade import make_result
from matplotlib.colors import to_rgb
from matplotlib.image import imread
from wording import says

from softcal_jax.calibration import ParameterEstimate
from softcal_jax.identifiability import end_of
from softcal_jax.plotting import plot_convergence
from softcal_jax.plotting._colours import BAD, DOUBTFUL, GOOD
from softcal_jax.plotting._diagrams import convergence_figure


def texts(axes):
    legend = axes.get_legend()
    return [text.get_text() for text in legend.get_texts()] if legend else []


def drawn(axes, n):
    """The line with n points."""
    return next(line for line in axes.lines if len(line.get_xdata()) == n)


def test_figure_is_1200_pixels_wide(tmp_path):
    plot_convergence(make_result(), tmp_path / "c.png")
    assert imread(tmp_path / "c.png").shape[1] == 1200


def test_what_is_drawn():
    """rms, lambda_p and one panel per unit, in units that are written on the axes."""
    rms, step, E, nu = convergence_figure(make_result(), "beam").axes
    np.testing.assert_allclose(drawn(rms, 5).get_ydata(), 4.0 / np.arange(1, 6))
    assert rms.get_ylabel() == "rms marker\ndistance [mm]"
    assert rms.get_ylim()[0] == 0.0
    np.testing.assert_allclose(drawn(step, 4).get_ydata(), [0.3, 0.1, 1e-3, 1e-8])
    np.testing.assert_array_equal(drawn(step, 4).get_xdata(), [1, 2, 3, 4])
    assert step.get_yscale() == "log"
    assert texts(step) == ["tolerance 1e-06"]
    np.testing.assert_allclose(drawn(step, 2).get_ydata(), 1e-6)
    np.testing.assert_allclose(drawn(E, 5).get_ydata(), [200, 210, 220, 230, 240])
    assert E.get_ylabel() == "E [kPa]"
    assert texts(E)[0] == "E = 240.0 ± 6.0 kPa"
    assert nu.get_ylabel() == "nu [-]"
    assert texts(nu)[0] == "nu = 0.44 (on a bound)"
    assert nu.get_xlabel() == "step"


def test_where_the_noise_is_estimated_a_line_is_drawn():
    """Between the steps 2 and 3, where the size of the step may jump."""
    result = make_result()
    levels = [1.0, 1.0, 1.0, 0.4, 0.4]
    pairs = zip(result.history, levels, strict=True)
    history = tuple(replace(entry, noise_level=level) for entry, level in pairs)
    for axes in convergence_figure(replace(result, history=history), "beam").axes:
        assert "noise estimated anew" in texts(axes)
        labelled = [a for a in axes.lines if a.get_label() == "noise estimated anew"]
        (line,) = labelled
        assert list(line.get_xdata()) == [2.5, 2.5]


def test_a_converged_run_says_so():
    result = make_result()
    sound = tuple(replace(p, at_bound=False) for p in result.parameters)
    figure = convergence_figure(replace(result, parameters=sound), "beam $1$")
    said = "Converged in 4 steps, and nothing speaks against the values."
    assert figure.get_suptitle() == f"beam $1$\n{said}"
    assert figure._suptitle.get_color() == GOOD
    assert to_rgb(figure.get_facecolor()) == (1.0, 1.0, 1.0)


def test_a_converged_run_with_a_parameter_on_its_bound_is_not_green():
    figure = convergence_figure(make_result(), "beam")
    title = "beam\nConverged in 4 steps, but take the values with care:"
    assert figure.get_suptitle() == title
    assert figure._suptitle.get_color() == DOUBTFUL
    reasons = figure.axes[0].get_title(loc="left")
    assert reasons == "nu ended on a bound."


def test_a_run_that_did_not_converge_never_looks_good():
    figure = convergence_figure(make_result(converged=False), "beam")
    title = "beam\nNOT CONVERGED after 4 steps: do not use these values."
    assert figure.get_suptitle() == title
    assert figure._suptitle.get_color() == BAD
    assert to_rgb(figure.get_facecolor()) != (1.0, 1.0, 1.0)


def test_steps_that_were_not_taken_are_marked():
    for axes in convergence_figure(make_result(rejected=(2, 3)), "beam").axes:
        crosses = [line for line in axes.lines if line.get_marker() == "x"]
        assert [line.get_xdata()[0] for line in crosses] == [2, 3]
        assert texts(axes).count("step not taken") == 1
    for axes in convergence_figure(make_result(), "beam").axes:
        assert "step not taken" not in texts(axes)


def test_only_the_start():
    """A calibration that stopped before its first step can still be drawn."""
    result = make_result(converged=False)
    short = make_result(converged=False, history=result.history[:1])
    assert len(convergence_figure(short, "beam").axes) == 4


def test_many_parameters_have_no_legend():
    names = [f"E{i}" for i in range(9)]
    parameters = tuple(
        ParameterEstimate(n, 2e5, 1e3, 2e5, 1e5, 1e6, "Pa", False) for n in names
    )
    base = make_result()
    history = tuple(
        type(e)(**{**vars(e), "values": dict.fromkeys(names, 2e5)})
        for e in base.history
    )
    result = make_result(parameters=parameters, history=history)
    *_, axes = convergence_figure(result, "beam").axes
    assert axes.get_ylabel() == "parameters [kPa]"
    assert len([line for line in axes.lines if len(line.get_xdata()) == 5]) == 9
    assert texts(axes) == []


def test_a_step_without_a_logarithm_can_be_drawn(tmp_path):
    history = tuple(
        type(e)(**{**vars(e), "lambda_p": (0.0, 0.0)}) for e in make_result().history
    )
    plot_convergence(make_result(history=history), tmp_path / "c.png")
    assert (tmp_path / "c.png").stat().st_size > 10_000


def ended(**changes):
    result = make_result(**{k: v for k, v in changes.items() if k != "size"})
    if "size" in changes:
        *before, last = result.history
        small = replace(last, lambda_p=(changes["size"],) * len(last.lambda_p))
        result = replace(result, history=(*before, small))
    return end_of(result)


def test_the_criterion_that_ended_the_fit_is_named():
    """Also where the last step stands above the tolerance, as nothing was to gain."""
    assert says(ended(), "|lambda_p| = 1.0e-08 ... 1e-06")
    assert says(ended(size=1.5e-6), "|lambda_p| = 1.5e-06 ... cost")
    assert says(ended(rejected=(4,)), "refused ... flat")
    assert "every step was refused" in ended(converged=False, rejected=(4,))
    _, step, *_ = convergence_figure(make_result(), "beam").axes
    assert step.get_title(loc="left") == ended()


def test_bounds_are_named_and_drawn_where_they_are_near():
    *_, E, nu = convergence_figure(make_result(), "beam").axes
    q = {p.name: p for p in make_result().parameters}
    for axes, name, factor in ((E, "E", 1e-3), (nu, "nu", 1.0)):
        low, high = (factor * b for b in (q[name].lower, q[name].upper))
        unit = " kPa" if name == "E" else ""
        assert f"bounds of {name}: {low:.4g} to {high:.4g}{unit}" in texts(axes)
        drawn = [line.get_ydata()[0] for line in axes.lines if len(line.get_xdata())]
        bottom, top = axes.get_ylim()
        for bound in (low, high):
            near = bottom <= bound <= top
            assert bool(np.isclose(drawn, bound).any()) >= near
        assert bottom <= min(drawn)


def test_a_figure_is_written_as_svg(tmp_path):
    plot_convergence(make_result(), tmp_path / "c.svg")
    text = (tmp_path / "c.svg").read_text()
    assert text.startswith("<?xml")
    assert "<svg " in text
    plot_convergence(make_result(), tmp_path / "d.svg")
    assert (tmp_path / "d.svg").read_text() == text
    with pytest.raises(ValueError, match=r"ends in '\.gif'; expected a picture"):
        plot_convergence(make_result(), tmp_path / "c.gif")
