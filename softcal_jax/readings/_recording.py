"""Recordings of motion capture over time, and the means over their windows."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from softcal_jax._module import Module
from softcal_jax._text import check_unique
from softcal_jax._typing import Bool, Float, HostArray
from softcal_jax._units import readable_values
from softcal_jax.readings._table import MarkerTable, index_of

STEP = 0.05
"""Share of the largest motion of a marker from which it has begun to move [-]."""

# Sarle's coefficient of bimodality from which a marker is in two places [-]: it is 1
# for two points, 0.67 for an oscillation, 0.56 for a drift and 0.33 for noise.
IN_TWO = 0.75
SMALL = 5e-4  # scatter that does not matter, half the usual std of a marker [m]
WIDTH = 0.1  # width of the window around a single time [s]

HELD = 0.5  # share of the largest motion from which a pose counts as moved [-]
STILL = 0.02  # share of the largest motion by which markers may wander on a plateau [-]

NOISE = 4.0
"""Standard deviations of the noise by which `STILL` may be exceeded [-]."""

FEWEST = 5  # fewest frames of a plateau: fewer hardly have a trend

# A second difference of white noise has six times its variance, and the median of the
# absolute value of a normal variable is 0.6745 standard deviations.
_SECOND, _MEDIAN = np.sqrt(6.0), 0.6745


class Recording(Module):
    """Positions of markers over time, in the frame of the cameras.

    A pose is the mean over a window of time. Times count from the first frame, or from
    an event: the step of a marker, or an event that was named when it was recorded;
    negative times are before the event.

    Attributes:
        names: Labels of the markers.
        times: Time of each frame from the first one [s].
        positions: Positions; nan where a marker was occluded [m].
        source: What was read, for messages.
        events: Names of events, and their times from the first frame [s].
    """

    names: tuple[str, ...]
    times: Float[HostArray, " n_frames"]
    positions: Float[HostArray, "n_frames n_markers 3"]
    source: str
    events: tuple[tuple[str, float], ...] = ()

    def __check_init__(self):
        if not (len(self.names) and len(self.times)):
            what = "frames" if self.names else "labelled markers"
            raise ValueError(f"recording {self.source} holds no {what}.")
        check_unique(f"recording {self.source}: its label", self.names)

    def step_of(self, name: str) -> float:
        """Return the time at which a marker begins to move [s].

        It is then farther from where it was first seen than a twentieth of its largest
        distance from there: a valve opened, or a weight was put on.

        Raises:
            ValueError: If there is no such marker, or it does not move.
        """
        path = self.positions[:, index_of(name, self.names, self.source)]
        seen = np.flatnonzero(np.isfinite(path).all(axis=1))
        away = np.linalg.norm(path[seen] - path[seen[:1]], axis=1)
        if not np.any(away > 0.0):
            raise ValueError(f"{self.source}: marker {name!r} does not move.")
        return float(self.times[seen[np.argmax(away > STEP * away.max())]])

    def time_of(self, event: str) -> float:
        """Return the time of an event that was named when it was recorded [s].

        Raises:
            ValueError: If there is no such event, or more than one.
        """
        times = [time for name, time in self.events if name == event]
        if len(times) != 1:
            known = ", ".join(f"{name!r} at {time:g} s" for name, time in self.events)
            raise ValueError(
                f"{self.source}: the event {event!r} is there {len(times)} times, "
                f"expected once. Known: {known or 'none'}."
            )
        return times[0]

    def between(
        self,
        start: float,
        stop: float,
        *,
        after_step_of: str | None = None,
        after_event: str | None = None,
    ) -> MarkerTable:
        """Return mean positions over a window of time, of the frames that see a marker.

        Its `start` and `stop` [s] may count from the step of a marker, see `step_of`,
        or from a named event.

        Raises:
            ValueError: If the window is not in the recording, or there is no such step
                or event.
        """
        zero, since_what = self._zero(after_step_of, after_event)
        # Times are multiples of the frame's length, up to rounding.
        slack = 1e-6 * (self.times[1] - self.times[0]) if len(self.times) > 1 else 0.0
        since = self.times - zero
        inside = (since >= start - slack) & (since <= stop + slack)
        window = f"between {start:g} and {stop:g} s{since_what}"
        out = start < since[0] - slack or stop > since[-1] + slack
        if out or not np.any(inside):
            raise ValueError(
                f"{self.source}: there are not all frames {window}; it has those "
                f"between {since[0]:g} and {since[-1]:g} s."
            )
        return self._mean(inside, window)

    def at(
        self,
        time: float,
        *,
        width: float = WIDTH,
        after_step_of: str | None = None,
        after_event: str | None = None,
    ) -> MarkerTable:
        """Return mean positions over a short window around a time, see `between` [s].

        A `width` of 0 takes the frame at that time.

        Raises:
            ValueError: As for `between`, or if the width is negative.
        """
        if not width >= 0.0:
            raise ValueError(f"the width of a window is 0 or more [s], got {width:g}.")
        half = 0.5 * width
        after = {"after_step_of": after_step_of, "after_event": after_event}
        if half == 0.0:
            zero, _ = self._zero(**after)
            nearest = self.times[np.argmin(np.abs(self.times - zero - time))] - zero
            frame = np.median(np.diff(self.times)) if len(self.times) > 1 else 0.0
            time = nearest if abs(nearest - time) <= 0.5 * frame else time
        return self.between(time - half, time + half, **after)

    def plateau(
        self,
        length: float,
        *,
        after_step_of: str | None = None,
        after_event: str | None = None,
    ) -> MarkerTable:
        """Return mean positions while the markers stand still after they have moved.

        A marker has moved in a frame in which it is farther from where it was first
        seen than half of its largest distance from there; where no marker moves by more
        than its noise, all frames count. Of the stretches of a `length` [s] in such
        frames, after the step or event, see `between`, the core is the one with the
        least scatter of its most scattered marker. The plateau is all frames around it,
        without a break, in which no marker, averaged over five frames, is farther from
        its mean over the core than 2 % of the largest motion and four standard
        deviations of the noise.

        Raises:
            ValueError: If there is none of that length, or no such step or event.
        """
        zero, since_what = self._zero(after_step_of, after_event)
        try:
            inside = self._still(int(np.searchsorted(self.times, zero)), length)
        except ValueError as error:
            raise ValueError(f"{self.source}{since_what}: {error}") from error
        begin, end = self.times[inside][[0, -1]] - zero
        window = f"on the plateau between {begin:g} and {end:g} s{since_what}"
        return self._mean(inside, window)

    def _still(self, begin: int, length: float) -> slice:
        """Find the frames of the plateau among those from `begin` on."""
        if not length > 0.0:
            raise ValueError(f"a plateau has a positive length [s], got {length:g}.")
        times, positions = self.times[begin:], self.positions[begin:]
        moved = np.linalg.norm(self.positions - _first_seen(self.positions), axis=2)
        motion = np.max(moved, axis=0, initial=0.0, where=np.isfinite(moved))
        # Noise of a distance, which has three coordinates.
        noise = NOISE * np.sqrt(3.0) * _noise(self.positions)
        moving = motion > 2.0 * noise + 1e-12  # the first frame has noise as well
        allowed = STILL * np.max(motion[moving], initial=0.0) + noise
        shares = np.ma.masked_invalid(moved[begin:, moving] / motion[moving])
        held = np.ma.filled(shares.mean(axis=1) >= HELD, False) | ~moving.any()
        first, stop = _stretches(times, held, length)
        mean = _means(positions)
        # Relative to where they were first seen, so that no digits are lost.
        near = np.nan_to_num(_first_seen(positions))
        square = _means(np.square(positions - near))(first, stop)
        scatter = np.sum(square - np.square(mean(first, stop) - near), axis=2)
        # Of the markers that are seen; there may be none.
        spread = np.ma.filled(np.ma.masked_invalid(scatter).max(axis=1), np.inf)
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
            worst = [float(np.nanmax(off[best[0] : best[1]]))]
            far = readable_values(worst, "m", digits=3)
            raise ValueError(
                f"there is no plateau of {length:g} s: even in the stillest stretch, "
                f"between {times[best[0]]:g} and {times[best[1] - 1]:g} s, a marker is "
                f"{far} off its mean, by more than {100 * STILL:g} % of the "
                "largest motion and its noise. Ask for a shorter one, or say `between` "
                "which times to average."
            )
        return slice(begin + start, begin + stop)

    def renamed(self, labels: Mapping[str, str]) -> "Recording":
        """Return it with new names of markers; `labels` are the old names by the new.

        Raises:
            ValueError: If a label is not there, or two markers would share a name.
        """
        new = {label: name for name, label in labels.items()}
        for label in new:
            index_of(label, self.names, self.source)
        names = tuple(new.get(name, name) for name in self.names)
        if len({*names}) < len(names) or len(new) < len(labels):
            raise ValueError(
                f"{self.source}: the labels {dict(labels)} give two markers one name, "
                "or one marker two names."
            )
        return replace(self, names=names)

    def _zero(
        self, after_step_of: str | None, after_event: str | None
    ) -> tuple[float, str]:
        """Return the time from which times count [s], and words for it in messages."""
        if None not in (after_step_of, after_event):
            raise ValueError(
                f"times count from {after_step_of!r} or {after_event!r}, not both."
            )
        if after_step_of is not None:
            return self.step_of(after_step_of), f" from the step of {after_step_of!r}"
        if after_event is not None:
            return self.time_of(after_event), f" from the event {after_event!r}"
        return 0.0, ""

    def _mean(
        self, inside: slice | Bool[HostArray, " n_frames"], window: str
    ) -> MarkerTable:
        """Average the frames of a window that see a marker."""
        part = self.positions[inside]
        seen = np.all(np.isfinite(part), axis=2)
        n, mean = np.sum(seen, axis=0), _means(part)(0, len(part))
        off = np.where(seen[:, :, None], part - mean, 0.0)
        squares = np.einsum("fmx,fmy->mxy", off, off)
        times = self.times[inside]
        # Moments along the axis of the largest scatter.
        variances, axes = np.linalg.eigh(squares / np.maximum(n, 1)[:, None, None])
        along, v = np.einsum("fmx,mx->fm", off, axes[:, :, -1]), variances[:, -1]
        third, fourth = (np.sum(along**p, axis=0) / np.maximum(n, 1) for p in (3, 4))
        two = (n > 2) & (third**2 + v**3 > IN_TWO * fourth * v)
        two &= v > np.square(np.maximum(NOISE * _noise(self.positions), SMALL))
        return MarkerTable(
            names=self.names,
            positions=mean,
            places=(window,) * len(self.names),
            source=self.source,
            covariances=squares / np.where(n > 1, n - 1, np.nan)[:, None, None],
            window=(float(times[0]), float(times[-1])),
            doubts={
                self.names[j]: f"{window}: marker {self.names[j]!r} is in two places; "
                f"it scatters by {readable_values([v[j] ** 0.5], 'm', digits=3)}. "
                "Labels were exchanged, or it moved: choose another window."
                for j in np.flatnonzero(two)
            },
        )


class Traces(Module):
    """A recording, and which parts of it were used, to be looked at.

    `windows` are the first and last time of each averaged window, by its purpose [s];
    `names` are labels of the markers that were used.
    """

    recording: Recording
    windows: Mapping[str, tuple[float, float]]
    names: tuple[str, ...]


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
    first = np.argmax(np.isfinite(positions).all(axis=2), axis=0)
    return positions[first, np.arange(positions.shape[1])]


def _noise(positions):
    """Estimate the noise of a coordinate of each marker from second differences [m]."""
    second = np.abs(np.diff(positions, n=2, axis=0))
    seen = [marker[np.isfinite(marker)] for marker in np.swapaxes(second, 0, 1)]
    medians = [np.median(values) if values.size else 0.0 for values in seen]
    return np.array(medians) / (_MEDIAN * _SECOND)
