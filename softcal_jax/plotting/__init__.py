"""Pictures of results, drawn without a screen."""

from softcal_jax.plotting._calibration import (
    draw_budget as draw_budget,
    draw_course as draw_course,
    draw_errors as draw_errors,
    draw_traces as draw_traces,
    draw_trials as draw_trials,
    draw_workspace as draw_workspace,
    plot_panels as plot_panels,
    plot_traces as plot_traces,
)
from softcal_jax.plotting._configuration import (
    LABELS as LABELS,
    NOT_CONVERGED as NOT_CONVERGED,
    marker_places as marker_places,
    motion_words as motion_words,
    plot_groups as plot_groups,
    render_body as render_body,
    render_configuration as render_configuration,
)
from softcal_jax.plotting._fibres import (
    draw_fibres as draw_fibres,
    plot_directions as plot_directions,
    plot_fibres as plot_fibres,
)
from softcal_jax.plotting._figure import (
    COLUMN as COLUMN,
    DISPLACEMENT_MAP as DISPLACEMENT_MAP,
    MARKS as MARKS,
    PICTURES as PICTURES,
    PictureStyle as PictureStyle,
    printed as printed,
)
from softcal_jax.plotting._plan import (
    MOST_PANELS as MOST_PANELS,
    plot_plan as plot_plan,
)
from softcal_jax.plotting._robot import (
    RobotPicture as RobotPicture,
    obstacle_surface as obstacle_surface,
    robot_picture as robot_picture,
)
from softcal_jax.plotting._scene import (
    RenderingError as RenderingError,
    rendering_problem as rendering_problem,
    rigid_faces as rigid_faces,
)
from softcal_jax.plotting._view import choose_view as choose_view
