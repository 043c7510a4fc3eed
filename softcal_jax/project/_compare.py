"""Several projects with the same data, compared by what they predict."""

from collections.abc import Callable, Mapping, Sequence

from softcal_jax.calibration import build_problem
from softcal_jax.layouts import ModelComparison, compare_models
from softcal_jax.project._problems import ProjectError, in_file, under
from softcal_jax.project._project import Project


def compare_projects(
    projects: Sequence[Project], *, progress: Callable[[str], None] = lambda _: None
) -> ModelComparison:
    """Find the project whose law, mesh or parameters best predict held-out data.

    Every configuration with role = "calibration" is held out once, see
    `softcal_jax.layouts.compare_laws`. Starts and seed are those of the first project.

    Args:
        projects: Projects of the same configurations and measurements, in any order.
        progress: Called with the name of each project before it is fitted.

    Raises:
        ProjectError: If there are fewer than two projects, or one has nothing to
            calibrate or other configurations.
        ValueError: If there are fewer than two configurations, or measurements differ.
    """
    if len(projects) < 2:
        raise ProjectError(
            f"a comparison needs at least two project files, got {len(projects)}."
        )
    first, names = projects[0], [c.name for c in projects[0].calibration]
    for project in projects:
        project.check_calibration()
        found = [c.name for c in project.calibration]
        if sorted(found) != sorted(names):
            raise ProjectError(
                f"{project.path}: its configurations are {', '.join(found)}, but those "
                f"of {first.path} are {', '.join(names)}; a comparison needs the same."
            )
    problems = {}
    for name, project in projects_by_name(projects).items():
        assert project.space is not None  # `check_calibration` has seen to it
        posed = {c.name: c for c in project.calibration}
        with in_file(project.path), under("configurations"):
            problems[name] = build_problem(
                project.model,
                project.space,
                [posed[own] for own in names],
                project.newton,
                uncertain=project.uncertain,
            )
    return compare_models(
        problems,
        first.calibration,
        starts=first.starts,
        seed=first.seed,
        progress=progress,
    )


def projects_by_name(projects: Sequence[Project]) -> Mapping[str, Project]:
    """Name projects by their names; where these repeat, by their files."""
    for name_of in (lambda p: p.name, lambda p: p.path.stem, lambda p: str(p.path)):
        found = {name_of(project): project for project in projects}
        if len(found) == len(projects):
            return found
    files = ", ".join(str(project.path) for project in projects)
    raise ProjectError(f"a project file is given twice: {files}.")
