"""What this process may use of its machine."""

import os


def available_cores() -> int:
    """Cores that this process may use; fewer than there are under a scheduler."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
