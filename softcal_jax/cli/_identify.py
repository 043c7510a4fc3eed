"""`softcal identify`: would the data determine the parameters?"""

import argparse
from typing import TYPE_CHECKING

from softcal_jax.cli._display import Display
from softcal_jax.cli._shared import (
    OK,
    bad_input,
    check_folder,
    load,
    no_equilibrium,
    print_end,
    times_line,
)

if TYPE_CHECKING:
    from softcal_jax.identifiability import Identifiability, Ranking
    from softcal_jax.project import Project


def identify(args: argparse.Namespace, show: Display) -> int:
    """Judge a project before anything is measured, and rank its candidates."""
    if args.output is not None:
        check_folder(args)
    from softcal_jax import report

    project = load(args.project, show)
    with bad_input():
        project.check_identify()
    found = ranking = None
    with bad_input(), no_equilibrium("Nothing was written."):
        if project.calibration:
            names = ", ".join(c.name for c in project.calibration)
            show.now(f"what {names} would tell (compiling)")
            found = project.identify()
        if project.candidates:
            names = ", ".join(c.name for c in project.candidates)
            show.now(f"what {names} would add (compiling)")
            ranking = project.rank_candidates()
    show.lap("solve")
    _print_outlook(project, found, ranking, show)
    if args.output is None:
        show.line(times_line(show))
        return OK
    with bad_input():
        where = report.write_identifiability(
            found,
            ranking,
            args.output,
            name=project.name,
            force=args.force,
            timing_s=dict(show.laps),
        )
    print_end(where, show)
    return OK


def _print_outlook(
    project: "Project",
    found: "Identifiability | None",
    ranking: "Ranking | None",
    show: Display,
) -> None:
    unmarked = [c.name for c in project.calibration if not (c.markers or c.effectors)]
    show.line()
    if unmarked:
        show.line(
            f"No markers or effectors, so nothing to learn, in: {', '.join(unmarked)}."
        )
    show.line("At the start values, with the stated noise of what is measured:")
    for part in (found, ranking):
        if part is not None:
            show.line(str(part))
            show.line()
    if ranking is None:
        show.line(
            "To see what another configuration would add, describe it in "
            "[[candidates]] (keys as in [[configurations]]) and run this again."
        )
