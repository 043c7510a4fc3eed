"""Calibrate the finite-element model of a soft robot from a few measured poses.

This module offers what a notebook needs. The rest is in the packages, which follow the
method step by step: `mesh`, `materials`, `fields`, `bodies`, `actuators`,
`configurations`, `equilibrium`, `sensitivity`, `inference`, `calibration`,
`identifiability`, `mistakes`, `control`, `layouts`.
"""

import ast
from importlib import import_module
from importlib.metadata import version
from pkgutil import get_data
from typing import Any

from softcal_jax import _notebook

__version__ = version("softcal-jax")


def _listed_homes() -> dict[str, str]:
    """Read the home of each name from the stub, which type checkers read too."""
    stub = ast.parse(get_data(__name__, "__init__.pyi") or b"")
    imports = [node for node in stub.body if isinstance(node, ast.ImportFrom)]
    return {name.name: str(node.module) for node in imports for name in node.names}


_HOMES = _listed_homes()

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


def _html_of(result: object) -> str | None:
    """Write what a notebook shows of a result."""
    return import_module("softcal_jax.report").notebook_html(result)


_notebook.html_of = _html_of
