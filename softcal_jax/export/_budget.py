"""The error budget as a dictionary for JSON."""

from typing import Any

from softcal_jax.export._plain import plain
from softcal_jax.inference import ErrorBudget


def budget_dict(budget: ErrorBudget) -> dict[str, Any]:
    """Convert the error budget of a calibration to a dictionary, see `BudgetEntry`."""
    by_cause = budget.by_cause()
    total = budget.standard_errors
    return plain(
        {
            "parameters": [
                {
                    "name": name,
                    "unit": budget.units[i],
                    "standard_error": total[i],
                    "by_cause": {cause: std[i] for cause, std in by_cause.items()},
                    "sentence": budget.sentence(name),
                }
                for i, name in enumerate(budget.names)
            ],
            "errors": [
                {
                    "cause": cause.name,
                    "name": error,
                    "deviations": budget.slopes * cause.deviations[:, k],
                }
                for cause in budget.causes
                for k, error in enumerate(cause.errors)
            ],
            "unknown": budget.unknown,
            "covariance": budget.covariance,
        }
    )
