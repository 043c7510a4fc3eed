"""Calibrate the finite-element model of a soft robot from a few measured poses.

This module offers what a notebook needs. The rest is in the packages, which follow the
method step by step: `mesh`, `materials`, `bodies`, `actuators`, `configurations`,
`equilibrium`, `fields`, `sensitivity`, `inference`, `calibration`, `identifiability`,
`mistakes`, `control`, `designs`, `layouts`. Measured files are read by `readings`.
"""

import ast
from importlib import import_module
from importlib.metadata import version
from pkgutil import get_data
from typing import Any

from softcal_jax import _notebook

__version__ = version("softcal-jax")

_STUB = ast.parse(get_data(__name__, "__init__.pyi") or b"")
_IMPORTS = (node for node in _STUB.body if isinstance(node, ast.ImportFrom))
# Type checkers read the stub, too.
_HOMES = {name.name: str(node.module) for node in _IMPORTS for name in node.names}

__all__ = sorted(_HOMES)  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> Any:
    """Import a name on its first use only, since imports take seconds."""
    if name in _HOMES:
        return getattr(import_module(_HOMES[name]), name)
    raise AttributeError(
        f"module {__name__!r} has no attribute {name!r}; what a notebook seldom needs "
        "is in its packages, like softcal_jax.configurations"
    )


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOMES})


# Imported once a notebook shows a result.
_writers = lambda: import_module("softcal_jax.results")
_notebook.html_of = lambda result: _writers().notebook_html(result)
_notebook.headline_of = lambda result: _writers().headline(result)
_notebook.text_of = lambda result: _writers().text(_writers().sections(result))
