"""Pictures of results, drawn without a screen."""

from softcal_jax.plotting._budget import budget_shares, plot_budget
from softcal_jax.plotting._configuration import render_body, render_configuration
from softcal_jax.plotting._diagrams import plot_convergence, plot_trials
from softcal_jax.plotting._directions import plot_directions
from softcal_jax.plotting._fibres import plot_fibres
from softcal_jax.plotting._groups import plot_groups
from softcal_jax.plotting._offscreen import RenderingError, rendering_problem
from softcal_jax.plotting._plan import MOST_PANELS, plot_plan
from softcal_jax.plotting._robot import SensorFrame
from softcal_jax.plotting._traces import plot_traces

__all__ = [
    "MOST_PANELS",
    "RenderingError",
    "SensorFrame",
    "budget_shares",
    "plot_budget",
    "plot_convergence",
    "plot_directions",
    "plot_fibres",
    "plot_groups",
    "plot_plan",
    "plot_traces",
    "plot_trials",
    "render_body",
    "render_configuration",
    "rendering_problem",
]
