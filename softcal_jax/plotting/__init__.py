"""Pictures of results, drawn without a screen."""

from softcal_jax.plotting._colours import DISPLACEMENT_MAP, MARKS
from softcal_jax.plotting._configuration import (
    NOT_CONVERGED,
    motion_words,
    render_body,
    render_configuration,
)
from softcal_jax.plotting._diagrams import plot_traces, plot_trials
from softcal_jax.plotting._fibres import plot_directions, plot_fibres
from softcal_jax.plotting._groups import plot_groups
from softcal_jax.plotting._plan import MOST_PANELS, plot_plan
from softcal_jax.plotting._robot import (
    RobotPicture,
    SensorFrame,
    actuator_words,
    is_seen,
    pushes,
    robot_picture,
    sensor_frames,
)
from softcal_jax.plotting._scene import RenderingError, rendering_problem
from softcal_jax.plotting._setup import load_place
from softcal_jax.plotting._view import View, choose_view

__all__ = [
    "DISPLACEMENT_MAP",
    "MARKS",
    "MOST_PANELS",
    "NOT_CONVERGED",
    "RenderingError",
    "RobotPicture",
    "SensorFrame",
    "View",
    "actuator_words",
    "choose_view",
    "is_seen",
    "load_place",
    "motion_words",
    "plot_directions",
    "plot_fibres",
    "plot_groups",
    "plot_plan",
    "plot_traces",
    "plot_trials",
    "pushes",
    "render_body",
    "render_configuration",
    "rendering_problem",
    "robot_picture",
    "sensor_frames",
]
