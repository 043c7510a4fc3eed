"""The error budget as a dictionary for JSON."""

from typing import Any

from softcal_jax.export._plain import plain
from softcal_jax.inference import ErrorBudget


def budget_dict(budget: ErrorBudget) -> dict[str, Any]:
    """Convert the error budget of a calibration to a dictionary.

    Keys: `parameters` (`name`, `unit`, `standard_error` by all causes, `by_cause`: that
    by each cause alone, "noise" first, `sentence`); `errors`, what is uncertain
    (`cause`, `name`, `deviations`: change of each parameter per standard deviation of
    it); `unknown`, causes whose size could not be estimated; `covariance` of the scaled
    parameters by all causes. All else is in SI.

    Args:
        budget: The budget.

    Returns:
        Dictionaries, lists, texts, numbers and None.
    """
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
