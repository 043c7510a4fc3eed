"""A comparison of models as a dictionary for JSON."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from softcal_jax.export._made import Made, made_dict, pick, plain
from softcal_jax.layouts import LEVEL_OF_COMPARISON, ModelComparison, ModelScore


def comparison_dict(
    comparison: ModelComparison,
    *,
    name: str = "comparison",
    timing_s: Mapping[str, float] | None = None,
    made: Mapping[str, Made] | None = None,
    directory: str | Path = ".",
) -> dict[str, Any]:
    """Build the content of `comparison.json`.

    Keys: `format`, `name`; `sources` and `settings` by model (see `made_dict`),
    `versions`; `verdict`, `best` (null if no model predicts everything),
    `undecided`, `level`; `models`, the best first (`name`, `n_parameters`,
    `held_out_rms_mm`, `held_out_noise_rms`, `score`, `standard_error`, `fit_rms_mm`,
    `fit_noise_rms`, `fit_failure`, `verdict` of the identifiability, `folds` with
    `held_out`, `rms_mm`, `noise_rms`, `fit_rms_mm`, `failure`); `differences` from the
    first (`name`, `difference`, `standard_error`, `half_width`, `n`, `told_apart`);
    `timing_s` [s]. Scores and differences are squares in units of the noise.

    What the models were computed from, `made`, is in the order that they had.
    """
    by_model = {model: made_dict(of, directory) for model, of in (made or {}).items()}
    best = comparison.best
    return plain(
        {
            "format": "softcal_jax.comparison/1",
            "name": name,
            "sources": {model: of["source"] for model, of in by_model.items()},
            "settings": {model: of["settings"] for model, of in by_model.items()},
            "versions": {
                k: v for of in by_model.values() for k, v in of["versions"].items()
            },
            "verdict": comparison.verdict,
            "best": best and best.name,
            "undecided": comparison.undecided,
            "level": LEVEL_OF_COMPARISON,
            "models": [_model(model) for model in comparison.models],
            "differences": [
                {
                    **pick(d, "name", "difference", "standard_error"),
                    **pick(d, "half_width", "n", "told_apart"),
                }
                for d in comparison.differences
            ],
            "timing_s": timing_s or {},
        }
    )


def _model(model: ModelScore) -> dict[str, Any]:
    return {
        **pick(model, "name", "n_parameters"),
        "held_out_rms_mm": 1e3 * model.held_out_rms,
        **pick(model, "held_out_noise_rms", "score", "standard_error"),
        "fit_rms_mm": 1e3 * model.fit_rms,
        **pick(model, "fit_noise_rms", "fit_failure", "verdict"),
        "folds": [
            {
                "held_out": fold.held_out,
                "rms_mm": 1e3 * fold.rms,
                "noise_rms": fold.noise_rms,
                "fit_rms_mm": 1e3 * fold.fit_rms,
                "failure": fold.failure,
            }
            for fold in model.folds
        ],
    }
