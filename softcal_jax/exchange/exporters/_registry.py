"""The formats that there are: those of this package, and those of installed ones."""

import warnings
from importlib.metadata import entry_points

from softcal_jax._warnings import SoftcalWarning
from softcal_jax.exchange.exporters._built_in import BUILT_IN
from softcal_jax.exchange.exporters._exporter import AbstractExporter

GROUP = "softcal_jax.exporters"
"""Group of the entry points by which a package adds formats."""


class ExporterWarning(SoftcalWarning):
    """An installed exporter cannot be used."""


def exporters() -> dict[str, AbstractExporter]:
    """Return the exporters by name.

    Warns:
        ExporterWarning: If one of another package cannot be loaded, is no
            `AbstractExporter`, or has a name that is taken.
    """
    known: dict[str, AbstractExporter] = {n: made() for n, made in BUILT_IN.items()}
    for point in entry_points(group=GROUP):
        try:
            exporter = point.load()()
        except Exception as error:  # the code of others may raise anything
            _leave_out(point.name, f"{point.value} cannot be loaded: {error}")
            continue
        if point.name in known:
            _leave_out(point.name, "another one has this name")
        elif not isinstance(exporter, AbstractExporter):
            _leave_out(point.name, f"{point.value} is no AbstractExporter")
        else:
            known[point.name] = exporter
    return known


def _leave_out(name: str, reason: str) -> None:
    text = f"the installed exporter {name!r} is left out: {reason}."
    warnings.warn(text, ExporterWarning, stacklevel=3)
