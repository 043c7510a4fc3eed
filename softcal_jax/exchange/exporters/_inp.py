"""`softcal export inp`."""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from softcal_jax.exchange.exporters._exporter import (
    AbstractExporter,
    AbstractProgress,
)


class InpExporter(AbstractExporter):
    """An input file of CalculiX or Abaqus."""

    writes = "an input file of CalculiX or Abaqus"
    description = (
        "Writes the calibrated model in one configuration as an input file of CalculiX "
        "or Abaqus: mesh, law, supports, loads and pressures, in SI."
    )
    cannot_hold = (
        "rigid bodies, cables, motors, imposed displacements of actuators, and laws "
        "that both programs lack"
    )
    output = "FILE.inp", "the file"

    def add_options(self, command: argparse.ArgumentParser) -> None:
        """Add the choice of a configuration."""
        which = "the configuration (may be left out if there is one)"
        command.add_argument("--configuration", metavar="NAME", help=which)

    def write(
        self,
        source: Any,
        output: Path,
        options: argparse.Namespace,
        progress: AbstractProgress,
    ) -> Sequence[str]:
        """Write the file; see `export_inp`."""
        from softcal_jax.exchange.inp import export_inp

        del progress
        return export_inp(source, output, configuration=options.configuration)
