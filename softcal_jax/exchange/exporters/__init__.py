"""The formats of `softcal export NAME`, and the interface by which packages add others.

Any package adds a format by a class and an entry point in its pyproject.toml::

    [project.entry-points."softcal_jax.exporters"]
    febio = "my_package:FebioExporter"

Nothing here imports JAX before something is written, so that commands begin at once.
"""

from softcal_jax.exchange.exporters._exporters import (
    GROUP as GROUP,
    AbstractExporter as AbstractExporter,
    ExporterWarning as ExporterWarning,
    ExportProgress as ExportProgress,
    exporters as exporters,
    quantity as quantity,
)
