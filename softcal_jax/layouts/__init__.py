"""Models compared by what they predict: layouts of control points (Sec. V-C), laws."""

from softcal_jax.layouts._compare_laws import (
    compare_laws,
    compare_layouts,
    compare_models,
)
from softcal_jax.layouts._model_comparison import (
    LEVEL_OF_COMPARISON,
    FoldScore,
    ModelComparison,
    ModelScore,
    PairedDifference,
)
from softcal_jax.layouts._placement import LayoutWarning, place_control_points
from softcal_jax.layouts._tet_sensitivities import tet_sensitivities

__all__ = [
    "LEVEL_OF_COMPARISON",
    "FoldScore",
    "LayoutWarning",
    "ModelComparison",
    "ModelScore",
    "PairedDifference",
    "compare_laws",
    "compare_layouts",
    "compare_models",
    "place_control_points",
    "tet_sensitivities",
]
