"""The search along a profile for the distance at which the likelihood ends it."""

from collections.abc import Callable

import numpy as np

CLOSE_ENOUGH = 0.005
"""Relative error allowed in the root of the rise at an end of an interval [-]."""

NARROW = 0.02
"""Gap to a fit that failed, over the distance, below which the search ends [-]."""

STEEP = 20.0
"""Slope of the root of the rise within such a gap, over its mean, that is a jump [-].

The fit beyond is then repeated from its neighbour.
"""


class NotFound(Exception):
    """Fits along the profile did not converge."""


Excess = Callable[[float], float]


def root(
    excess: Excess, inside: float, outside: float, *, steep: float = np.inf
) -> tuple[float, float]:
    """Find the zero of an excess between two distances where its signs differ.

    Uses inverse quadratic interpolation, and bisection where that is not safe
    (Chandrupatla, Adv. Eng. Softw. 28, 1997). Where the cost is a parabola the excess
    is linear, and the first guess is the root.

    Args:
        excess: The function.
        inside: Distance where it is negative.
        outside: Distance where it is positive.
        steep: Difference of the excess, over that of the distance relative to
            `outside`, at which a narrow bracket is a jump.

    Returns:
        The root, twice; or the distances on both sides of a jump, the inner one first.
    """
    a, b = outside, inside  # the newest point, and one where the sign differs
    f_a, f_b = excess(a), excess(b)
    share, smallest = f_a / (f_a - f_b), 0.01 * CLOSE_ENOUGH * outside
    while f_a != 0.0:
        width, jump = abs(b - a), abs(f_a - f_b)
        if width < NARROW * outside and jump * outside > steep * width:
            return min(a, b), max(a, b)
        if width < 2.0 * smallest:
            return min(a, b), max(a, b)
        least = smallest / abs(b - a)
        x = a + float(np.clip(share, least, 1.0 - least)) * (b - a)
        f_x = excess(x)
        if np.sign(f_x) == np.sign(f_a):
            c, f_c = a, f_a
        else:
            c, f_c, b, f_b = b, f_b, a, f_a
        a, f_a = x, f_x
        xi, phi, share = (a - b) / (c - b), (f_a - f_b) / (f_c - f_b), 0.5
        if phi**2 < xi and (1.0 - phi) ** 2 < 1.0 - xi:
            share = f_a / (f_b - f_a) * f_c / (f_b - f_c)
            share += (c - a) / (b - a) * f_a / (f_c - f_a) * f_b / (f_c - f_b)
    return a, a


def bracket(
    excess: Excess, *, rise: float, inside: float, reach: float, limit: float
) -> tuple[float, float] | None:
    """Return two distances with the end between them; None if it is beyond the limit.

    The distance grows step by step; where a fit does not converge, the step is halved.
    """
    outside, lost = max(reach, 1.2 * inside), np.inf
    while inside < limit:
        outside = min(outside, limit)
        try:
            value = excess(outside)
        except NotFound:
            value, lost = -rise, outside
        else:
            if value >= 0.0:
                return inside, outside
            inside = outside
        if lost - inside < NARROW * (inside + reach):
            raise NotFound
        grown = float(np.clip(1.05 * rise / (value + rise + 1e-300), 1.2, 2.0))
        outside = min(inside * grown if inside else np.inf, 0.5 * (inside + lost))
    return None
