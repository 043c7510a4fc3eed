"""Where calibrations start: how many starts by default, and random ones."""

import equinox as eqx
import jax
import numpy as np

from softcal_jax._limits import TRIALS
from softcal_jax._typing import Array, Float
from softcal_jax.fields._space import ParameterSpace

SEVERAL = 6
"""Most starts by default where there may be several optima."""

# One row at a time, so that the program does not depend on the number of rows.
_to_scaled = eqx.filter_jit(lambda space, p: space.admissible(space.to_scaled(p)))


def default_starts(space: ParameterSpace) -> int:
    """Return how many starts a calibration takes at most, unless the user says so.

    `SEVERAL` where the angle of an axis or more than one control point of a field is
    calibrated, since there the cost has several optima; 1 elsewhere. Mirror images
    included, they take several times as long as a single fit: a sweep of thousands of
    calibrations from good start values may say `starts = 1`.
    """
    fields = [entry.parameters for entry in space.entries if entry.fields]
    angle = any(q.unit == "rad" or q.periodic for field in fields for q in field)
    several = any(len(field) > 1 for field in fields)
    return SEVERAL if space.axes or angle or several else 1


def check_starts(n: int) -> None:
    """Raise ValueError unless there may be so many starts."""
    if n < 1:
        raise ValueError(f"starts must be at least 1, got {n}.")
    TRIALS.check(f"starts = {n}", n)


def random_starts(
    space: ParameterSpace, n: int, *, seed: int = 0
) -> Float[Array, "n p"]:
    """Draw random scaled parameters within the bounds, uniform in SI units.

    Pairs that break their order are swapped.

    Raises:
        ValueError: If n is less than one, or above a limit.
    """
    check_starts(n)
    random = np.random.default_rng(seed)
    low = np.asarray(space.from_scaled(space.lower()))
    high = np.asarray(space.from_scaled(space.upper()))
    p = low + (high - low) * random.random((n, len(low)))
    names = space.names
    pairs = [
        (names.index(small), names.index(large))
        for small, large in space.in_plain_steps().order_names()
        if small in names and large in names  # one may be known
    ]
    for small, large in pairs * len(pairs):  # repeated, for chains a <= b <= c
        p[:, [small, large]] = np.sort(p[:, [small, large]], axis=1)
        p = np.clip(p, low, high)
    numbered = space.numbered
    return jax.device_put(np.stack([_to_scaled(numbered, row) for row in p]))
