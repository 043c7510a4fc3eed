"""Models compared by what they predict: layouts of control points (Sec. V-C), laws."""

from softcal_jax.layouts._compare import (
    compare_laws as compare_laws,
    compare_layouts as compare_layouts,
    compare_models as compare_models,
)
from softcal_jax.layouts._model_comparison import (
    LEVEL_OF_COMPARISON as LEVEL_OF_COMPARISON,
    FoldScore as FoldScore,
    ModelComparison as ModelComparison,
    ModelScore as ModelScore,
    PairedDifference as PairedDifference,
)
from softcal_jax.layouts._placement import (
    LayoutWarning as LayoutWarning,
    place_control_points as place_control_points,
    tet_sensitivities as tet_sensitivities,
)
