"""`softcal compare`: laws or meshes, judged by what they predict."""

import argparse
from collections.abc import Callable
from pathlib import Path

from softcal_jax.cli._shared import (
    NOT_CONVERGED,
    OK,
    Display,
    Stop,
    add_output,
    add_path,
    bad_input,
    check_folder,
    load,
    no_equilibrium,
)
from softcal_jax.cli._writing import write_results

_COMPARE = """\
examples:
  softcal compare neo_hookean.toml yeoh.toml gent.toml
  softcal compare coarse.toml fine.toml -o compared   and as comparison.json and .txt

exit codes: 0 compared, whatever the verdict, 1 no model predicts every configuration,
2 bad input
"""


def compare(args: argparse.Namespace, show: Display) -> int:
    """Compare several project files of the same data."""
    if args.output is not None:
        check_folder(args)
    from softcal_jax import report
    from softcal_jax.export import Made, comparison_dict
    from softcal_jax.project import compare_projects, projects_by_name

    projects = [load(path, show) for path in args.projects]
    n = sum(len(project.calibration) + 1 for project in projects)
    show.note(f"{n} fits, each of all configurations but one, or of all")
    with bad_input(), no_equilibrium("Nothing was written."):
        comparison = compare_projects(
            projects, progress=lambda name: show.now(f"fits of {name}")
        )
    show.lap("solve")
    made = {
        name: Made(project.model, {"newton": project.newton}, project.source)
        for name, project in projects_by_name(projects).items()
    }
    show.line()
    show.line(str(comparison))
    if args.output is None:
        more = {"timing_s": dict(show.laps), "made": made}
        show.document(comparison_dict(comparison, **more))
        show.times()
    else:

        def write(where: Path, force: bool) -> Path:
            more = {"timing_s": dict(show.laps), "made": made}
            return report.write_comparison(comparison, where, force=force, **more)

        write_results(write, args, show, index="comparison.json", force=args.force)
    if comparison.best is None:
        raise Stop(NOT_CONVERGED, "no model predicts every configuration.")
    return OK


def add_compare(commands: "argparse._SubParsersAction", raw: Callable) -> None:
    """Add the command to the parser."""
    command = commands.add_parser(
        "compare",
        help="which law, or mesh, predicts best? fits of the same data",
        description="""\
Fits each project to all configurations but one and predicts that one, in turn. Ranks
the projects by how well they do, and says whether the data can tell them apart: by the
differences on the same configurations, with their scatter.

The files have the same configurations with the same measured values, and differ in
[material], [mesh] or [[parameters]].""",
        epilog=_COMPARE,
        formatter_class=raw,
    )
    command.add_argument(
        "projects", metavar="PROJECT.toml", nargs="+", type=Path, help="project files"
    )
    add_path(command, "--output", "DIR", "folder for the results")
    again = "replace earlier results in that folder"
    command.add_argument("--force", action="store_true", help=again)
    add_output(command)
    command.set_defaults(run=compare)
