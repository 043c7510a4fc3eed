"""Plot what the standard errors of a calibration come from."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from softcal_jax._typing import Float, HostArray
from softcal_jax.calibration import CalibrationResult
from softcal_jax.inference import NOISE
from softcal_jax.plotting._colours import FAINT, SERIES, TEXT
from softcal_jax.plotting._save import DPI, save

if TYPE_CHECKING:
    import matplotlib.figure

_HATCHES = ("", "//", "..")
"""Patterns that tell causes of the same colour apart."""


def plot_budget(
    result: CalibrationResult, path: str | Path, *, name: str = "calibration"
) -> None:
    """Plot the share of each cause in the variance of each parameter.

    Args:
        result: The calibration.
        path: PNG file, 1200 pixels wide, or SVG file.
        name: Name of the calibration.
    """
    save(budget_figure(result, name), path)


def budget_figure(result: CalibrationResult, name: str) -> "matplotlib.figure.Figure":
    """Build the figure without a screen and without touching Matplotlib's state."""
    from matplotlib.figure import Figure

    n_p = len(result.parameters)
    height = 2.4 + 0.55 * n_p
    figure = Figure(figsize=(12.0, height), dpi=DPI, layout="constrained")
    axes = figure.subplots()
    rows, left = np.arange(n_p), np.zeros(n_p)
    for k, (cause, share) in enumerate(budget_shares(result).items()):
        axes.barh(
            rows,
            100.0 * share,
            left=100.0 * left,
            height=0.65,
            label=cause,
            color=FAINT if cause == NOISE else SERIES[(k - 1) % len(SERIES)],
            hatch=_HATCHES[(k - 1) // len(SERIES) if k else 0],
            edgecolor="white",
        )
        left += share
    for row in np.flatnonzero(left == 0.0):
        axes.text(1.0, float(row), "no standard error", va="center", fontsize=13)
    texts = [f"{q.name}\n{q}" for q in result.parameters]
    axes.set_yticks(rows, texts, fontsize=13, color=TEXT, parse_math=False)
    axes.invert_yaxis()
    axes.set_xlim(0.0, 100.0)
    axes.tick_params(axis="x", labelsize=13)
    axes.set_xlabel("share of the squared standard error [%]", fontsize=14)
    legend = axes.legend(
        fontsize=13, frameon=False, loc="upper left", bbox_to_anchor=(1.0, 1.02)
    )
    for text in legend.get_texts():
        text.set_parse_math(False)  # the name of a field may hold a dollar sign
    figure.suptitle(
        f"{name}: what the errors come from",
        fontsize=19,
        weight="bold",
        color=TEXT,
        parse_math=False,
    )
    return figure


def budget_shares(
    result: CalibrationResult,
) -> dict[str, Float[HostArray, " n_p"]]:
    """Compute the share of each cause in the variance of each parameter.

    Args:
        result: The calibration.

    Returns:
        Shares by cause, that of the noise first; zero without a standard error [-].
    """
    squares = {cause: std**2 for cause, std in result.budget.by_cause().items()}
    total = sum(squares.values())
    known = np.isfinite(total) & (total > 0.0)
    return {
        cause: np.where(known, own, 0.0) / np.where(known, total, 1.0)
        for cause, own in squares.items()
    }
