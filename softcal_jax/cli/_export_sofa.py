"""`softcal export sofa`: a scene of SOFA, calibrated again for what SOFA will run."""

import argparse

from softcal_jax.cli._shared import (
    OK,
    Display,
    add_output,
    add_path,
    bad_input,
    check_folder,
    no_equilibrium,
    start_computing,
    with_care,
)
from softcal_jax.cli._steps import step_lines


def add_sofa(formats: "argparse._SubParsersAction") -> None:
    """Add the format to those of `softcal export`."""
    sofa = formats.add_parser(
        "sofa",
        help="a scene of SOFA, calibrated again for it",
        description="Fits the model once more to the same measurements, with the "
        "linear mesh and the law that SOFA will run, and writes a static scene for "
        "SofaPython3 with these values, and how to run it. Says what both models "
        "predict.",
    )
    add_path(sofa, "results", "RESULTS", "folder of the results, or result.json")
    add_path(sofa, "--output", "DIR", "folder for the scene", required=True)
    add_path(sofa, "--project", "PROJECT.toml", "the project file, if it was moved")
    choices = {
        "--release": (["v26.06", "v25.12"], "release of SOFA"),
        "--units": (["mm-kg-s", "SI"], "unit system of the scene"),
        "--law": (
            ["same", "corotational"],
            "counterpart of the calibrated law, or SOFA's corotational tets for laws "
            "with E and nu",
        ),
        "--rotation": (
            ["edge", "procrustes", "large"],
            "rotation of corotational tets: edge and large are the methods polar and "
            "large of TetrahedronFEMForceField, procrustes is that of "
            "CorotationalFEMForceField, from v26.06 on",
        ),
    }
    for option, (known, text) in choices.items():
        text = f"{text} (default: {known[0]})"
        sofa.add_argument(option, choices=known, default=known[0], help=text)
    again = "replace an earlier scene in that folder"
    sofa.add_argument("--force", action="store_true", help=again)
    add_output(sofa)
    sofa.set_defaults(run=_export)


def _export(args: argparse.Namespace, show: Display) -> int:
    """Load a result, calibrate its model for SOFA, and write the scene."""
    check_folder(args)
    from softcal_jax.exchange.sofa import export_sofa
    from softcal_jax.report import load_result

    start_computing(show)
    show.now(f"reading {args.results}")
    with bad_input():
        result = load_result(args.results, project=args.project)
    show.lap("reading")
    with bad_input(), no_equilibrium("Nothing was written."):
        found = export_sofa(
            result,
            args.output,
            release=args.release,
            units=args.units,
            law=args.law,
            rotation=args.rotation,
            force=args.force,
            began=lambda: show.now("calibrating the model of SOFA"),
            progress=step_lines(result.project, show),
        )
    show.lap("solve")
    show.line()
    show.line(str(found))
    for note in with_care(result.doubts):
        show.line(f"Note: {note}")
    show.line(f"Wrote {args.output}; README.md there says how to run it.")
    show.document({"output": str(args.output), "said": str(found)})
    show.times()
    return OK
