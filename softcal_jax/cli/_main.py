"""Arguments of the command line, and the end of every command."""

import argparse
import atexit
import gc
import sys
import time
from collections.abc import Mapping, Sequence
from contextlib import nullcontext, redirect_stdout
from importlib.metadata import version

import shtab

from softcal_jax.cli import _commands, _display, _shared as cli
from softcal_jax.cli._calibrated import add_export, add_inverse
from softcal_jax.cli._check import add_check, add_mesh
from softcal_jax.cli._new import add_new, add_tags
from softcal_jax.cli._sweep import add_sweep
from softcal_jax.exchange.exporters import AbstractExporter, exporters

_ABOUT = "Calibrate the finite-element model of a soft robot from a few measured poses."

_EXAMPLES = """\
examples:
  softcal demo                            calibrate a real silicone beam
  softcal new my_robot --robot beam       a ready-made robot, to start from
  softcal new my_robot --model body.step  a project for your own mesh or CAD model
  softcal check my_robot/project.toml     what it describes, before any solve
  softcal calibrate my_robot/project.toml -o results
  softcal simulate my_robot/project.toml -o forward
  softcal identify my_robot/project.toml  would the data suffice? ask before measuring
  softcal design my_robot/project.toml -o design   fields and actuation for goals
  softcal mesh finger.step -o finger.msh  from CAD to tets, with a picture
  softcal compare a.toml b.toml           which law or mesh predicts best?
  softcal transfer results b/project.toml   do its values hold for another robot?
  softcal inverse results --goal tip="(60, 8, 2) mm" -o command   which pressure?
  softcal export inp results -o job.inp   the calibrated model for CalculiX, Abaqus
  softcal export sofa results -o scene    a scene of SOFA, calibrated again for it
  softcal export icesl results -o print   its moduli as graded foam, to be printed
  softcal sweep sweep.toml                many calibrations, side by side
  softcal sweep show sweep                what they found
  softcal tags -o tags.pdf                tags to print and photograph

exit codes:
    0  done: the numbers come from a converged solve
    1  not converged, no equilibrium, or a goal that is not met: do not use the values
    2  bad input; nothing was solved or written, unless the message says otherwise
    3  calibrated, but do not use the values: the model is far from the data
  130  interrupted by Ctrl-C or SIGTERM; the message says what was saved
"""


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command, by default that of `sys.argv`, and return its exit code."""
    # The start of the process will not do: a shell may have run in it before.
    begin = time.time() - (time.process_time() if argv is None else 0.0)
    if argv is None:
        # Imports allocate much and leave no garbage: searching them over and over, and
        # all once more at the end, takes a third of the time of a quick command.
        gc.set_threshold(100_000, 20, 100)
        atexit.register(gc.freeze)
    _display.escape_what_cannot_be_encoded()
    words = list(sys.argv[1:] if argv is None else argv)
    if words[:2] == ["sweep", "show"]:  # one command for the parser
        words[:2] = ["sweep show"]
    _display.silence()
    asked = words[:1] == ["export"] or "--print-completion" in words
    args = _parser(exporters() if asked else {}).parse_args(words)
    display = _display.Display(begin, quiet=args.quiet, as_json=args.json)
    # What other packages print is no JSON.
    out = redirect_stdout(sys.stderr) if display.as_json else nullcontext()
    try:
        with cli.sigterm_as_ctrl_c(), out, display:
            display.now("importing", log=False)
            with cli.warnings_as_lines(display):
                args.run(args, display)
                return cli.OK
    except cli.Stop as stop:
        text, code = str(stop), stop.code
    except OSError as error:
        text, code = str(cli.refusal(error)), cli.BAD_INPUT
    except KeyboardInterrupt as stop:
        kept = " ".join(filter(None, (str(stop), cli.checkpoint_stands(args))))
        text = f"interrupted. {kept}" if kept else "interrupted; nothing was written."
        code = cli.INTERRUPTED
    display.failure(text, code)
    errors = _display.PlainConsole(stderr=True)
    errors.print(text, markup=False, highlight=False, soft_wrap=True)
    return code


def _parser(formats: Mapping[str, AbstractExporter]) -> argparse.ArgumentParser:
    parser = _display.PlainParser("softcal", description=_ABOUT, epilog=_EXAMPLES)
    text = f"softcal {version('softcal-jax')}"
    parser.add_argument("--version", action="version", version=text)
    shtab.add_argument_to(
        parser,
        ["--print-completion"],
        help="print a script that completes commands and options in this shell",
    )
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    _commands.add_project_commands(commands)
    add_new(commands)
    add_check(commands)
    add_mesh(commands)
    _commands.add_compare(commands)
    _commands.add_transfer(commands)
    add_inverse(commands)
    add_export(commands, formats)
    add_sweep(commands)
    add_tags(commands)
    return parser
