"""The silicone beam's own project, with other cells and another element."""

import re
import shutil
from pathlib import Path
from typing import NamedTuple

from softcal_jax.equilibrium import Formulation
from softcal_jax.robots import ready_made_path


class Variant(NamedTuple):
    """Cells of the beam, and the element on it."""

    cells: tuple[int, int, int]
    element: str = "quadratic"
    formulation: Formulation = "mean-dilatation"

    @property
    def name(self) -> str:
        """Name in the figures."""
        kind = "tet4" if self.element == "linear" else "tet10"
        displacement = kind == "tet10" and self.formulation == "displacement"
        cells = "x".join(map(str, self.cells))
        return f"{kind}{'_displacement' if displacement else ''}_{cells}"


COARSE = Variant((14, 4, 4), "linear", "displacement")
"""A beam that is calibrated in seconds; coarser ones do not carry the markers."""


def copy_demo(folder: Path, variant: Variant) -> Path:
    """Copy project and data of the demo to a new folder; returns the project file.

    Raises:
        RuntimeError: If the file no longer has the keys that are replaced here.
    """
    source = ready_made_path("beam")
    path = Path(shutil.copytree(source.parent, folder)) / source.name
    text = path.read_text(encoding="utf-8")
    path.write_text(_edited(text, variant), encoding="utf-8")
    return path


def _edited(text: str, variant: Variant) -> str:
    changes = {
        r"cells = \[[^\]]*\]": f"cells = {list(variant.cells)}",
        r'(?m)^element = "\w+"': f'element = "{variant.element}"',
        r"(?m)^\[material\]$": f'[material]\nformulation = "{variant.formulation}"',
    }
    for pattern, new in changes.items():
        text, count = re.subn(pattern, new, text)
        if count != 1:
            raise RuntimeError(f"{pattern} occurs {count} times in the project file.")
    return text
