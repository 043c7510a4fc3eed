"""`softcal export sofa`."""

import argparse
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

from softcal_jax.exchange.exporters._exporter import (
    AbstractExporter,
    AbstractProgress,
)


class SofaExporter(AbstractExporter):
    """A scene of SOFA, for which the model is calibrated again."""

    writes = "a scene of SOFA, calibrated again for it"
    description = (
        "Fits the model once more to the same measurements, with the linear mesh and "
        "the law that SOFA will run, and writes a static scene for SofaPython3 with "
        "these values, and how to run it. Says what both models predict."
    )
    cannot_hold = (
        "rigid bodies, cables with friction, motors, elastic supports that are moved, "
        "and laws that SOFA lacks"
    )
    output = "DIR", "folder for the scene"
    next_step = "README.md there says how to run it"

    def add_options(self, command: argparse.ArgumentParser) -> None:
        """Add release, units, law and rotation."""
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
        self,
        source: Any,
        output: Path,
        options: argparse.Namespace,
        progress: AbstractProgress,
    ) -> Sequence[str]:
        """Calibrate the model for SOFA, and write the scene; see `export_sofa`."""
        from softcal_jax.exchange.sofa import export_sofa

        scene = export_sofa(
            source,
            output,
            release=options.release,
            units=options.units,
            law=options.law,
            rotation=options.rotation,
            force=options.force,
            began=partial(progress.begins, "calibrating the model of SOFA"),
            progress=progress.step,
        )
        progress.found(str(scene))
        return ()
