"""Identifiability results as dictionaries for JSON."""

from collections.abc import Mapping
from typing import Any

from softcal_jax.calibration import MultiStartResult
from softcal_jax.export._plain import fields_of, plain
from softcal_jax.identifiability import Assessment, Identifiability, Ranking


def assessment_dict(found: Assessment) -> dict[str, Any]:
    """Convert the assessment of a calibration to a dictionary.

    Keys: `identified`, `reasons` (why not), `misfit_probability` (of residuals this
    large by chance; null where the noise was estimated).

    Args:
        found: The verdict.

    Returns:
        Texts, numbers and None.
    """
    return {
        "identified": found.identified,
        "reasons": list(found.reasons),
        "misfit_probability": found.misfit_probability,
    }


def starts_dict(search: MultiStartResult) -> dict[str, Any]:
    """Convert the runs from many starts to a dictionary.

    Keys: `names` of the parameters; `starts`, `values` (one row per run; SI), `cost`,
    `steps`, `converged`; `optima`, the lowest cost first (`cost`, `values`, `starts`).

    Args:
        search: The runs.

    Returns:
        Dictionaries, lists, numbers and None.
    """
    rows = ("names", "starts", "values", "cost", "steps", "converged")
    return plain(
        {
            **{name: getattr(search, name) for name in rows},
            "optima": [fields_of(optimum) for optimum in search.optima],
        }
    )


def identifiability_dict(found: Identifiability) -> dict[str, Any]:
    """Convert an identifiability result to a dictionary.

    Keys: `verdict`, `n_data`; `parameters` (`name`, `value`, `unit`, `standard_error`,
    `data_only`, `prior`, `relative`, `spread`, `verdict`; SI, angles in rad);
    `directions`, the best seen first (`words`, `spread`, `verdict`, `signal`,
    `components` in the order of the parameters); `covariance` (of the scaled
    parameters) and `correlation`; `conditioning` (`singular_values`, `condition_...`).
    Numbers that are not finite are null: an infinite condition number, or the standard
    error from the data alone of a parameter to which they are blind.

    Args:
        found: The result.

    Returns:
        Dictionaries, lists, texts, numbers and None.
    """
    return plain(
        {
            "verdict": found.verdict,
            "n_data": found.n_data,
            "parameters": [fields_of(p) for p in found.parameters],
            "directions": [fields_of(d) for d in found.directions],
            "covariance": found.covariance,
            "correlation": found.correlation,
            "conditioning": fields_of(found.conditioning),
        }
    )


def outlook_dict(
    found: Identifiability | None,
    ranking: Ranking | None,
    *,
    name: str = "identifiability",
    timing_s: Mapping[str, float] | None = None,
) -> dict[str, Any]:
    """Build the content of `identifiability.json`.

    Keys: `format`, `name`; `identifiability` (see `identifiability_dict`; null without
    configurations); `ranking` (null without candidates): `blind_before`, `candidates`,
    the best first (`name`, `d_gain`, `e_gain`, `volume`, `blind_left`, and for the
    standard error that falls most `parameter`, `before`, `after`, `value`, `unit`; SI),
    `unranked` (`name`, `reason`); `timing_s`.

    Args:
        found: Result of the configurations, if there are any.
        ranking: Ranking of the candidates, if there are any.
        name: Name of the project.
        timing_s: Wall time per part [s].

    Returns:
        Dictionaries, lists, texts, numbers and None; no NaN and no infinity.
    """
    return plain(
        {
            "format": "softcal_jax.identifiability/1",
            "name": name,
            "identifiability": found and identifiability_dict(found),
            "ranking": ranking
            and {
                "blind_before": ranking.blind_before,
                "candidates": [
                    {**fields_of(gain), "volume": gain.volume} for gain in ranking.gains
                ],
                "unranked": [fields_of(entry) for entry in ranking.unranked],
            },
            "timing_s": dict(timing_s or {}),
        }
    )
