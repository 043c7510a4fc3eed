"""What of a row may not depend on who ran it, and when."""

from softcal_jax.sweeps import SweepResult

CHANGES = ("seconds", "compile_seconds", "worker", "ended", "traceback")


def substance(result: SweepResult):
    """Every row without times and places."""
    return [{k: v for k, v in row.items() if k not in CHANGES} for row in result.rows]


def ends(result: SweepResult):
    """When each trial ended."""
    return {row["point"]: row["ended"] for row in result.rows}
