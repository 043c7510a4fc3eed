"""CAD models for the tests, which are skipped without gmsh."""

import pytest

from benchmarks._cad_models import CAVITY, FINGER, INLET, MIDDLE, modelled, write_finger

try:
    import gmsh  # pyright: ignore[reportMissingImports]
except (ImportError, OSError) as error:
    pytest.skip(f"needs gmsh: {error}", allow_module_level=True)

__all__ = ["CAVITY", "FINGER", "INLET", "MIDDLE", "gmsh", "modelled", "write_finger"]
