"""The formats of `softcal export NAME`, and the interface by which packages add others.

Any package adds a format by a class and an entry point in its pyproject.toml::

    [project.entry-points."softcal_jax.exporters"]
    febio = "my_package:FebioExporter"

The code of a format is imported when that format is asked for, and JAX not before, so
that commands begin at once.
"""

import warnings
from abc import ABC, abstractmethod
from argparse import ArgumentParser, Namespace
from collections.abc import Callable, Sequence
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import shtab

from softcal_jax._text import SoftcalWarning


class ExportProgress(NamedTuple):
    """Callbacks by which an export reports while it runs.

    Attributes:
        begins: Says what begins, like "calibrating the model of SOFA".
        watch: Shows what a calibration does, as the `watch` of `calibrate`.
        computed: Shows what was computed for the export, in lines.
    """

    begins: Callable[[str], None]
    watch: Callable[[Any], None]
    computed: Callable[[str], None]


class AbstractExporter(ABC):
    """A format of `softcal export`; its name there is that of its entry point.

    Attributes:
        writes: What is written, in a few words for the list of formats.
        description: The same in sentences, for the help of the format.
        cannot_hold: What of a model is refused, in a sentence.
        output: Placeholder and meaning of `--output`: "DIR" stands for a folder of
            results, which `results_folder` of `softcal_jax.results` makes, anything
            else for a file.
        next_step: What to do with the files, in a sentence; empty if that is plain.
        takes_projects: Whether a project file may stand for results, with its start
            values.
    """

    writes: ClassVar[str]
    description: ClassVar[str]
    cannot_hold: ClassVar[str]
    output: ClassVar[tuple[str, str]]
    next_step: ClassVar[str] = ""
    takes_projects: ClassVar[bool] = False

    def add_options(self, command: ArgumentParser) -> None:
        """Add the options of the format, beside `--output`, `--project`, `--force`."""
        del command

    @abstractmethod
    def write(
        self, source: Any, output: Path, options: Namespace, progress: ExportProgress
    ) -> Sequence[str]:
        """Write a model.

        Args:
            source: The `LoadedResult`; where `takes_projects` is set also a `Project`.
            output: The file or folder; what is there may be replaced if
                `options.force` is set.
            options: The options of the command.
            progress: Callbacks to report meanwhile.

        Returns:
            How the other program differs from the model, in sentences.

        Raises:
            ValueError: If an option is wrong, or the format cannot hold something of
                the model; the text gives the reason, and what to do.
            OSError: If the files cannot be written.
            RuntimeError: If what is computed for the export does not converge. Nothing
                is written then.
        """


def quantity(option: str, text: str, unit: str) -> float:
    """Parse the value of an option, like "24 MPa", into the SI unit.

    Raises:
        ValueError: If it is no such quantity; the text names the option.
    """
    from softcal_jax.project import parse_in_si

    try:
        return parse_in_si(text, unit)
    except ValueError as error:
        raise ValueError(f"{option}: {error}") from error


class _InpExporter(AbstractExporter):
    writes = "an input file of CalculiX or Abaqus"
    description = (
        "Writes the calibrated model in one configuration as an input file of CalculiX "
        "or Abaqus: mesh, law, supports, loads and pressures, in SI."
    )
    cannot_hold = (
        "rigid bodies, contact with obstacles, cables, motors, imposed displacements "
        "of actuators, and laws that both programs lack"
    )
    output = "FILE.inp", "the file"

    def add_options(self, command: ArgumentParser) -> None:
        which = "the configuration (may be left out if there is one)"
        command.add_argument("--configuration", metavar="NAME", help=which)

    def write(
        self, source: Any, output: Path, options: Namespace, progress: ExportProgress
    ) -> Sequence[str]:
        from softcal_jax.exchange.inp import export_inp

        return export_inp(source, output, configuration=options.configuration)


class _IceslExporter(AbstractExporter):
    writes = "graded foam for the slicer IceSL"
    description = (
        "Writes the part as STL and a script for IceSL with density, angle and "
        "anisotropy of a foam that has the calibrated moduli E_t, E_l and the fibre. "
        "What the foam does not reach is listed with its place. RESULTS may be a "
        "project file, of which the start values are taken."
    )
    cannot_hold = "laws that have no Young's moduli"
    output = "DIR", "the folder"
    takes_projects = True

    def add_options(self, command: ArgumentParser) -> None:
        add = command.add_argument
        text = "foam with a soft axis (default), or with a stiff one, which needs "
        text += "--table"
        kinds = ["polyfoam", "phasor"]
        add("--infill", choices=kinds, default=kinds[0], help=text)
        text = "moduli of the foam: columns density, shrink or iso, E_soft_kPa, "
        text += "E_stiff_kPa (default: as published, of TPU)"
        table = add("--table", metavar="FILE.csv", type=Path, help=text)
        table.complete = shtab.FILE  # pyright: ignore[reportAttributeAccessIssue]
        text = "Young's modulus of the solid, for the published table (default: 12 MPa)"
        add("--solid-modulus", metavar="MODULUS", help=text)
        text = "axes of the mesh along x and y of the print bed"
        text += " (default: those of theta)"
        add("--plane", choices=["xy", "xz", "yz"], help=text)
        add("--region", metavar="NAME", help="tet group that is printed (default: all)")
        text = "axis of the foam that the angle marks (default: soft; stiff for phasor)"
        add("--angle-marks", choices=["soft", "stiff"], help=text)
        text = 'added to every angle, like "90 deg"'
        add("--angle-offset", metavar="ANGLE", default="0 deg", help=text)
        text = "the slicer counts angles clockwise"
        add("--clockwise", action="store_true", help=text)

    def write(
        self, source: Any, output: Path, options: Namespace, progress: ExportProgress
    ) -> Sequence[str]:
        from softcal_jax.designs import published_foam
        from softcal_jax.exchange.icesl import export_icesl

        table = options.table
        if options.solid_modulus is not None:
            if table is not None:
                raise ValueError(
                    "--solid-modulus scales the published table, and --table has the "
                    "moduli of your foam already. Give one of the two."
                )
            modulus = quantity("--solid-modulus", options.solid_modulus, "Pa")
            table = published_foam(modulus)
        written = export_icesl(
            source,
            output,
            infill=options.infill.capitalize(),
            table=table,
            plane=options.plane,
            region=options.region,
            angle_marks=options.angle_marks,
            angle_offset=quantity("--angle-offset", options.angle_offset, "rad"),
            clockwise=options.clockwise,
            force=options.force,
        )
        return written.notes


class _SofaExporter(AbstractExporter):
    writes = "a scene of SOFA, calibrated again for it"
    description = (
        "Fits the model once more to the same measurements, with the linear mesh and "
        "the law that SOFA will run, and writes a static scene for SofaPython3 with "
        "these values, and how to run it. Says what both models predict."
    )
    cannot_hold = (
        "rigid bodies, contact with obstacles, cables with friction, motors, elastic "
        "supports that are moved, and laws that SOFA lacks"
    )
    output = "DIR", "folder for the scene"
    next_step = "README.md there says how to run it"

    def add_options(self, command: ArgumentParser) -> None:
        choices = {
            "--release": (["v26.06", "v25.12"], "release of SOFA"),
            "--units": (["mm-kg-s", "SI"], "unit system of the scene"),
            "--law": (
                ["same", "corotational"],
                "counterpart of the calibrated law, or SOFA's corotational tets for "
                "laws with E and nu",
            ),
            "--rotation": (
                ["edge", "procrustes", "large"],
                "rotation of corotational tets: edge and large are the methods polar "
                "and large of TetrahedronFEMForceField, procrustes is that of "
                "CorotationalFEMForceField, from v26.06 on",
            ),
        }
        for option, (known, text) in choices.items():
            text = f"{text} (default: {known[0]})"
            command.add_argument(option, choices=known, default=known[0], help=text)

    def write(
        self, source: Any, output: Path, options: Namespace, progress: ExportProgress
    ) -> Sequence[str]:
        from softcal_jax.exchange.sofa import export_sofa

        progress.begins("calibrating the model of SOFA")
        scene = export_sofa(
            source,
            output,
            release=options.release,
            units=options.units,
            law=options.law,
            rotation=options.rotation,
            force=options.force,
            watch=progress.watch,
        )
        progress.computed("\n".join(scene.lines))
        return ()


class _MujocoExporter(AbstractExporter):
    writes = "a model of MuJoCo, calibrated again for it"
    description = (
        "Fits the model once more to the same measurements, with the linear mesh and "
        "the law of MuJoCo's flex, and writes an MJCF file with these values and a "
        "keyframe per configuration, for MuJoCo 4. Says what both models predict."
    )
    cannot_hold = (
        "rigid bodies, contact with obstacles, motors, chambers, cables with friction, "
        "what is moved by an imposed displacement, and laws with more constants than E "
        "and nu"
    )
    output = "DIR", "folder for the model"
    next_step = "python -m mujoco.viewer --mjcf=robot.xml shows it"

    def write(
        self, source: Any, output: Path, options: Namespace, progress: ExportProgress
    ) -> Sequence[str]:
        from softcal_jax.exchange.mujoco import export_mujoco

        progress.begins("calibrating the model of MuJoCo")
        model = export_mujoco(source, output, force=options.force, watch=progress.watch)
        progress.computed("\n".join(model.lines))
        return ()


class ExporterWarning(SoftcalWarning):
    """An installed exporter cannot be used."""


def exporters() -> dict[str, AbstractExporter]:
    """Return the exporters by name.

    Warns:
        ExporterWarning: If that of another package cannot be loaded, is no
            `AbstractExporter`, or has a name that is taken.
    """
    known: dict[str, AbstractExporter] = {
        "inp": _InpExporter(),
        "sofa": _SofaExporter(),
        "mujoco": _MujocoExporter(),
        "icesl": _IceslExporter(),
    }
    for point in entry_points(group="softcal_jax.exporters"):
        exporter, reason = None, f"{point.value} is no AbstractExporter"
        try:
            exporter = point.load()()
        except Exception as error:  # the code of others may raise anything
            reason = f"{point.value} cannot be loaded: {error}"
        if isinstance(exporter, AbstractExporter) and point.name not in known:
            known[point.name] = exporter
            continue
        if point.name in known:
            reason = "another one has this name"
        text = f"the installed exporter {point.name!r} is left out: {reason}."
        warnings.warn(text, ExporterWarning, stacklevel=2)
    return known
