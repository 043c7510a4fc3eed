"""Where to put control points, and how many the data can determine (Sec. V-C)."""

from softcal_jax.layouts._comparison import FoldScore, LayoutComparison, LayoutScore
from softcal_jax.layouts._cross_validation import compare_layouts
from softcal_jax.layouts._placement import LayoutWarning, place_control_points
from softcal_jax.layouts._tet_sensitivities import tet_sensitivities

__all__ = [
    "FoldScore",
    "LayoutComparison",
    "LayoutScore",
    "LayoutWarning",
    "compare_layouts",
    "place_control_points",
    "tet_sensitivities",
]
