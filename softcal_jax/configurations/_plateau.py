"""The stretch of a recording in which markers stand still after they have moved."""

import numpy as np

from softcal_jax._typing import Float, HostArray

HELD = 0.5
"""Share of the largest motion from which a pose counts as moved [-]."""

STILL = 0.02
"""Share of the largest motion by which markers may wander on a plateau [-]."""

NOISE = 4.0
"""Standard deviations of the noise by which `STILL` may be exceeded [-]."""

FEWEST = 5
"""Fewest frames of a plateau: fewer hardly have a trend."""

# A second difference of white noise has six times its variance, and the median of the
# absolute value of a normal variable is 0.6745 standard deviations.
_SECOND, _MEDIAN = np.sqrt(6.0), 0.6745


def find_plateau(
    times: Float[HostArray, " n_frames"],
    positions: Float[HostArray, "n_frames n_markers 3"],
    whole: Float[HostArray, "n_all n_markers 3"],
    length: float,
) -> tuple[int, int]:
    """Find the frames in which markers stand still after they have moved.

    A marker has moved in a frame in which it is farther from where it was first seen
    than half of its largest distance from there; where no marker moves by more than
    its noise, all frames count. Of the stretches of `length` in such frames, the core
    is the one with the least scatter of its most scattered marker. The plateau is
    all frames around it, without a break, in which no marker, averaged over five
    frames, is farther from its mean over the core than 2 % of the largest
    motion and four standard deviations of the noise.

    Only frames with `times` and `positions` are searched, nan where a marker was
    occluded; motion and noise are those of the `whole` recording [s, m]. The first
    frame of the plateau is returned, and the frame after its last.
    """
    if not length > 0.0:
        raise ValueError(f"a plateau has a positive length [s], got {length:g}.")
    away = np.linalg.norm(positions - _first_seen(whole), axis=2)
    moved = np.linalg.norm(whole - _first_seen(whole), axis=2)
    motion = np.max(moved, axis=0, initial=0.0, where=np.isfinite(moved))
    # Noise of a distance, which has three coordinates.
    noise = NOISE * np.sqrt(3.0) * _noise(whole)
    moving = motion > 2.0 * noise + 1e-12  # the first frame has noise as well
    allowed = STILL * np.max(motion[moving], initial=0.0) + noise
    with np.errstate(invalid="ignore", divide="ignore"):
        share = (away / motion)[:, moving]
    seen = np.isfinite(share)
    total, n_seen = np.sum(np.where(seen, share, 0.0), axis=1), seen.sum(axis=1)
    held = (total >= HELD * n_seen) & (n_seen > 0) | ~moving.any()
    first, stop = _stretches(times, held, length)
    mean = _means(positions)
    # Relative to where they were first seen, so that no digits are lost.
    near = np.nan_to_num(_first_seen(positions))
    square = _means(np.square(positions - near))(first, stop)
    scatter = np.sum(square - np.square(mean(first, stop) - near), axis=2)
    scatter = np.where(np.isfinite(scatter), scatter, -np.inf)
    spread = scatter.max(axis=1, initial=-np.inf)
    spread = np.where(spread > -np.inf, spread, np.inf)  # if no marker is seen
    if not np.any(np.isfinite(spread)):
        raise ValueError(
            f"the markers are held for less than {length:g} s away from where they "
            "begin: there is no plateau of that length."
        )
    k = int(np.argmin(spread))
    best = int(first[k]), int(stop[k])
    # Averaged over some frames, so that one outlier does not end the plateau.
    around = np.clip(np.arange(len(times)) - FEWEST // 2, 0, len(times) - FEWEST)
    smooth = mean(around, around + FEWEST)
    off = np.linalg.norm(smooth - mean(first[k], stop[k]), axis=2)
    still = held & ~np.any(off > allowed, axis=1)
    breaks = np.flatnonzero(~still)
    start = int(breaks[breaks < best[0]].max(initial=-1)) + 1
    stop = int(breaks[breaks >= best[0]].min(initial=len(times)))
    if stop < best[1]:
        worst = 1e3 * float(np.nanmax(off[best[0] : best[1]]))
        raise ValueError(
            f"there is no plateau of {length:g} s: even in the stillest stretch, "
            f"between {times[best[0]]:g} and {times[best[1] - 1]:g} s, a marker is "
            f"{worst:.3g} mm off its mean, by more than {100 * STILL:g} % of the "
            "largest motion and its noise. Ask for a shorter one, or say `between` "
            "which times to average."
        )
    return start, stop


def _stretches(times, held, length):
    """Return first frames of stretches of held frames, and the frames after them."""
    # Times are multiples of the frame's length, up to rounding.
    stop = np.searchsorted(times, times + length * (1.0 - 1e-9)) + 1
    first = np.arange(len(times))
    stop = np.maximum(stop, first + FEWEST)
    within = stop <= len(times)
    first, stop = first[within], stop[within]
    before = np.concatenate([[0], np.cumsum(~held)])
    held = before[stop] == before[first]
    return first[held], stop[held]


def _means(positions):
    """Return a function that averages, over stretches, frames that see a marker."""
    seen = np.isfinite(positions).all(axis=2, keepdims=True)
    # From a point nearby, so that sums of many frames lose no digits.
    near = np.nan_to_num(_first_seen(positions))
    zero = ((1, 0), (0, 0), (0, 0))
    sums = np.cumsum(np.pad(np.where(seen, positions - near, 0.0), zero), axis=0)
    counts = np.cumsum(np.pad(seen, zero), axis=0)

    def mean(first, stop):
        n = counts[stop] - counts[first]
        return near + (sums[stop] - sums[first]) / np.where(n > 0, n, np.nan)

    return mean


def _first_seen(positions):
    """Return where each marker was seen first; nan if never [m]."""
    seen = np.isfinite(positions).all(axis=2)
    first = np.argmax(seen, axis=0)
    return positions[first, np.arange(positions.shape[1])]


def _noise(positions):
    """Estimate the noise of a coordinate of each marker from second differences [m]."""
    second = np.abs(np.diff(positions, n=2, axis=0))
    seen = [
        of_marker[np.isfinite(of_marker)] for of_marker in np.swapaxes(second, 0, 1)
    ]
    medians = [np.median(values) if values.size else 0.0 for values in seen]
    return np.array(medians) / (_MEDIAN * _SECOND)
