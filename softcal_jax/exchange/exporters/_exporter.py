"""The interface of a format that a calibrated model is written in."""

import argparse
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, ClassVar, NamedTuple


class ExportProgress(NamedTuple):
    """What an export says while it runs.

    Attributes:
        begins: Says what begins, like "calibrating the model of SOFA".
        step: Shows a step of a calibration, a `HistoryEntry`.
        computed: Shows what was computed for the export, in lines.
    """

    begins: Callable[[str], None]
    step: Callable[[Any], None]
    computed: Callable[[str], None]


class AbstractExporter(ABC):
    """A format of `softcal export`; its name there is that of its entry point.

    Attributes:
        writes: What is written, in a few words for the list of formats.
        description: The same in sentences, for the help of the format.
        cannot_hold: What of a model is refused, in a sentence.
        output: Placeholder and meaning of `--output`: "DIR" stands for a folder of
            results, which `results_folder` of `softcal_jax.export` makes, anything
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

    def add_options(self, command: argparse.ArgumentParser) -> None:
        """Add the options of the format, beside `--output`, `--project`, `--force`."""
        del command

    @abstractmethod
    def write(
        self,
        source: Any,
        output: Path,
        options: argparse.Namespace,
        progress: ExportProgress,
    ) -> Sequence[str]:
        """Write a model.

        Args:
            source: The `LoadedResult`; where `takes_projects` is set also a `Project`.
            output: The file or folder; what is there may be replaced if
                `options.force` is set.
            options: The options of the command.
            progress: What to tell meanwhile.

        Returns:
            What the other program does otherwise than the model, in sentences.

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
