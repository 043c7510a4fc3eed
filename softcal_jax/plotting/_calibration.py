"""Charts of a calibration: its errors, its course, and where its spread comes from."""

import itertools
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from softcal_jax._text import escaped
from softcal_jax._units import readable_unit
from softcal_jax.calibration import CalibrationResult, ConfigurationResult
from softcal_jax.plotting._figure import BAD, SERIES, TEXT, Axes, draw_grid

LEAST_NAMED = 0.01  # share of a variance of which the cause is named [-]

# Darker and lighter in turn, so that neighbours differ in grey as well. Where there are
# more causes, the colours repeat.
_FILLS = ("#8c8c8c", "#0b4f8a", "#f0b27a", "#1b7a5a", "#d9cdf0", "#5b4310", "#ffffff")
_OPEN: dict[str, Any] = {
    "ls": "none",
    "marker": "o",
    "color": SERIES[0],
    "mfc": "white",
}
_LEAST = 1e-16  # a step of exactly zero has no logarithm


def draw_errors(axes: Axes, fits: Sequence[ConfigurationResult]) -> Axes:
    """Draw the errors of configurations before and after the fit, beside the motion.

    Each is the root mean square distance of the simulated markers from the measured
    ones. A configuration without one is left out.
    """
    shown = [fit for fit in fits if math.isfinite(fit.rms_after)]
    sizes = [(fit.rms_before, fit.rms_after, fit.motion) for fit in shown]
    factor, unit = readable_unit(itertools.chain(*sizes), "m")
    before, after, motion = factor * np.array(sizes).reshape(-1, 3).T
    rows = np.arange(len(shown))
    axes.hlines(rows, before, after, color=SERIES[0])
    axes.vlines(motion, rows - 0.3, rows + 0.3, color=TEXT, label="motion")
    axes.plot(before, rows, **_OPEN, clip_on=False, label="before the fit")
    axes.plot(after, rows, "o", color=SERIES[0], clip_on=False, label="after it")
    names = [f"{f.name}{' (held out)' * (f.role == 'validation')}" for f in shown]
    axes.set_yticks(rows, list(map(escaped, names)), parse_math=False)
    axes.set(ylim=(len(shown) - 0.4, -0.6), xlabel=f"rms distance [{unit}]")
    axes.set_xlim(left=0.0)
    return draw_grid(axes)


def draw_workspace(axes: Axes, fits: Sequence[ConfigurationResult]) -> Axes:
    """Draw the errors after calibration at the places where the markers are.

    Each configuration is at the mean place of its simulated points, in the plane in
    which these means differ most; the area of its circle is the error. Filled circles
    were held out.
    """
    shown = [fit for fit in fits if math.isfinite(fit.rms_after)]
    places = np.array([np.mean([e.simulated for e in f.points], axis=0) for f in shown])
    factor, unit = readable_unit(places.flat, "m")
    plane = np.sort(np.argsort(-np.ptp(places, axis=0), kind="stable")[:2])
    errors = np.array([fit.rms_after for fit in shown])
    faces = [SERIES[0] if fit.role == "validation" else "white" for fit in shown]
    look: dict[str, Any] = {"facecolors": faces, "edgecolors": SERIES[0], "alpha": 0.6}
    x, y = factor * places[:, plane].T
    axes.scatter(x, y, 150.0 * errors / (errors.max() or 1.0), **look)
    axes.margins(0.15)
    across, up = ("xyz"[k] for k in plane)
    axes.set(xlabel=f"{across} [{unit}]", ylabel=f"{up} [{unit}]")
    return draw_grid(axes)


def draw_budget(axes: Axes, result: CalibrationResult, *, most: int = 24) -> Axes:
    """Draw the share of each cause in the variance of the first `most` parameters.

    A parameter without a standard error is left out, and in the legend a cause that is
    too thin to be seen.
    """
    squares = {cause: std**2 for cause, std in result.budget.by_cause().items()}
    total = np.asarray(sum(squares.values()))
    known = np.flatnonzero(np.isfinite(total) & (total > 0.0))[:most]
    left, rows = np.zeros(len(known)), np.arange(len(known))
    for k, (cause, square) in enumerate(squares.items()):
        share = 100.0 * square[known] / total[known]
        label = escaped(cause) if np.any(share >= 100.0 * LEAST_NAMED) else ""
        look = {"color": _FILLS[k % len(_FILLS)], "ec": TEXT, "lw": 0.5}
        axes.barh(rows, share, 0.7, left=left, **look, label=label)
        left += share
    names = [escaped(result.parameters[i].name) for i in known]
    axes.set_yticks(rows, names, parse_math=False)
    axes.set(xlim=(0.0, 100.0), ylim=(len(known) - 0.4, -0.6))
    axes.set_xlabel("share of the variance [%]")
    return axes


def draw_course(
    axes: Axes, result: CalibrationResult, name: str, *, truth: float | None = None
) -> Axes:
    """Draw what a calibration came to, step by step.

    Args:
        axes: Where to draw.
        result: The calibration.
        name: A parameter; or "rms", the residual of the markers, "cost", or "lambda_p",
            the largest step, with the tolerance.
        truth: True value of the parameter, in SI, as a dashed line.

    Returns:
        The axes; a last value that stands on a bound is an open square.
    """
    q = next((q for q in result.parameters if q.name == name), None)
    history, label, unit = result.history, name, "-" if q is None else q.unit
    if q is not None:
        values = [entry.values[name] for entry in history]
    elif name == "lambda_p":
        label = "step size"
        values = [max(*map(abs, entry.lambda_p), _LEAST) for entry in history]
        axes.set_yscale("log")
        tol = result.settings.tol
        axes.axhline(tol, color=TEXT, ls="--", label=f"tolerance {tol:g}")
    else:
        values = [getattr(entry, name) for entry in history]
        label, unit = ("rms residual", "m") if name == "rms" else (name, "-")
    factor, shown = readable_unit(values, unit)
    steps, values = (
        np.array([entry.step for entry in history]),
        factor * np.array(values),
    )
    taken = np.array([entry.accepted for entry in history])
    axes.plot(steps, values, color=SERIES[0])
    axes.plot(steps[taken], values[taken], "o", color=SERIES[0])
    if not taken.all():
        axes.plot(steps[~taken], values[~taken], **_OPEN, label="step refused")
    for before, entry in itertools.pairwise(history):
        if not math.isclose(before.noise_level, entry.noise_level):
            middle = 0.5 * (before.step + entry.step)
            axes.axvline(middle, color=TEXT, ls=":", label="noise estimated anew")
    if q is None and name != "lambda_p":
        axes.set_ylim(bottom=0.0)
    if truth is not None:
        axes.axhline(factor * truth, color=TEXT, ls="--", label="true value")
    if q is not None and q.at_bound:
        draw_on_bound(axes, steps[-1:], values[-1:])
    axes.set_xlabel("step")
    axes.set_ylabel(f"{escaped(label)} [{shown or '-'}]", parse_math=False)
    axes.xaxis.get_major_locator().set_params(integer=True)  # pyright: ignore
    return draw_grid(axes)


def draw_on_bound(axes: Axes, x, y) -> None:
    """Mark values that stand on a bound, by open squares."""
    squares = {"ls": "none", "marker": "s", "mfc": "white", "mec": BAD, "zorder": 3}
    axes.plot(x, y, **squares, label="on a bound")
