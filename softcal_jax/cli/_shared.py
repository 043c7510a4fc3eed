"""What all commands share: exit codes, loading a project, ending a command."""

import argparse
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING

from softcal_jax.cli._display import Display

if TYPE_CHECKING:
    from softcal_jax.equilibrium import Model
    from softcal_jax.project import Project

OK, NOT_CONVERGED, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130
"""Exit codes."""


class Stop(Exception):
    """End the command with a message instead of a traceback."""

    def __init__(self, code: int, text: str):
        super().__init__(text)
        self.code = code


def check_folder(args: argparse.Namespace) -> None:
    """Check the output folder first, so that a long run does not fail there."""
    from softcal_jax.export import check_results_folder

    with bad_input():
        check_results_folder(args.output, force=args.force)


def load(path: Path, show: Display) -> "Project":
    """Load a project, and describe its model."""
    import jax

    from softcal_jax._compilation_cache import use_compilation_cache
    from softcal_jax.project import load_project

    # Only a program may set these two; a library must leave them to its user.
    jax.config.update("jax_enable_x64", True)
    use_compilation_cache()
    show.lap("import")
    show.now(f"reading {path.name}")
    with bad_input():
        project = load_project(path)
    show.lap("reading")
    mesh, model = project.model.mesh, project.model
    kind = "quadratic" if mesh.order == 2 else "linear"
    show.line(f"softcal {version('softcal-jax')}: {project.name}")
    show.line(
        f"{mesh.n_nodes} nodes, {mesh.n_tets} {kind} tets, {_law(model)} "
        f"({model.formulation}), solver {model.solver.name}"
    )
    return project


def _law(model: "Model") -> str:
    name = type(model.law).__name__
    elasticity = getattr(model.law, "elasticity", None)  # not every law has one
    return name if elasticity is None else f"{name} of {type(elasticity).__name__}"


def print_end(where: Path, show: Display) -> None:
    """Print what was written where, and how long the parts took."""
    files = sorted(p.name for p in where.iterdir())
    show.line(f"Results in {where}: {', '.join(files)}")
    show.line(times_line(show))


def times_line(show: Display) -> str:
    """Format how long the parts took."""
    parts = ", ".join(f"{name} {seconds:.1f} s" for name, seconds in show.laps.items())
    return f"Time: {parts}; {show.total():.1f} s in all."


@contextmanager
def no_equilibrium(written: str) -> Iterator[None]:
    """End the command if a configuration has no equilibrium."""
    import jax

    try:
        yield
    except jax.errors.JaxRuntimeError:
        raise  # a fault of the program, not of the robot
    except RuntimeError as error:
        raise Stop(NOT_CONVERGED, f"error: {error}\n{written}") from error


@contextmanager
def bad_input() -> Iterator[None]:
    """End the command if its input is wrong."""
    try:
        yield
    except (ValueError, OSError) as error:
        raise Stop(BAD_INPUT, f"error: {error}") from error
