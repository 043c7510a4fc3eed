"""What of a row may not depend on who ran it, and when."""

from softcal_jax.sweeps import SweepResult


def substance(result: SweepResult):
    """Every row without times and places."""
    return [
        (row.key, row.point, row.state, row.reason, row.figures, row.notes)
        for row in result.rows
    ]
