"""Moduli between the samples of a foam table, and the search for given ones."""

import numpy as np
from scipy.spatial import KDTree

from softcal_jax._typing import Float, HostArray

_T_STEPS, _S_STEPS = 96, 64
"""Samples along the density, and between two levels, from which searches begin."""

_SEARCH_STEPS = 20

Numbers = Float[HostArray, " n"]
Pairs = Float[HostArray, "n 2"]


class FoamPatch:
    """A foam table as a map from two coordinates to ln density and ln moduli.

    The coordinate s counts the levels of equal anisotropy: 0 at the first level, 0.5
    halfway to the second. The coordinate t runs from the smallest density of the level
    (0) to its largest (1).
    """

    def __init__(
        self, density: Numbers, anisotropy: Numbers, moduli: Pairs, *, is_log: bool
    ):
        """Fit a curve to each level; `is_log` mixes levels by their logarithm."""
        # Here, so that commands which do not need it do not wait for it.
        from scipy.interpolate import PchipInterpolator

        self.is_log = is_log
        values = np.unique(anisotropy)
        self.levels = np.log(values) if is_log else values
        self.last = len(values) - 1.0  # the largest s
        self.ends, self.curves = [], []
        for value in values:
            samples = np.flatnonzero(anisotropy == value)
            samples = samples[np.argsort(density[samples])]
            x = np.log(density[samples])
            self.ends.append((x[0], x[-1]))
            self.curves.append(PchipInterpolator(x, np.log(moduli[samples])))

    def at(self, t: Numbers, s: Numbers) -> Float[HostArray, "n 3"]:
        """Return ln density, ln E_soft and ln E_stiff."""
        mixed, s = np.zeros((len(t), 3)), np.clip(s, 0.0, self.last)
        for level, ((low, high), curve) in enumerate(
            zip(self.ends, self.curves, strict=True)
        ):
            weight = np.maximum(1.0 - np.abs(s - level), 0.0)
            near = np.flatnonzero(weight)
            x = low + t[near] * (high - low)
            mixed[near] += weight[near, None] * np.column_stack([x, curve(x)])
        return mixed

    def moduli(self, density: Numbers, anisotropy: Numbers) -> Pairs:
        """Interpolate E_soft and E_stiff [Pa]; see `FoamTable.moduli`."""
        values = np.log(anisotropy) if self.is_log else anisotropy
        s = np.interp(values, self.levels, np.arange(len(self.levels)))
        low, high = (self.at(np.full_like(s, t), s)[:, 0] for t in (0.0, 1.0))
        t = (np.log(density) - low) / (high - low)
        return np.exp(self.at(t, s)[:, 1:])

    def nearest(self, asked: Pairs) -> tuple[Numbers, Float[HostArray, "n 3"]]:
        """Find the foams nearest to ln E_soft and ln E_stiff, see `FoamTable.find`.

        Returns their anisotropy, then ln density, ln E_soft and ln E_stiff.
        """
        t = np.linspace(0.0, 1.0, _T_STEPS + 1)
        s = np.linspace(0.0, self.last, _S_STEPS * int(self.last) + 1)
        grid = np.stack(np.meshgrid(t, s, indexing="ij"), axis=-1).reshape(-1, 2)
        tree = KDTree(self.at(*grid.T)[:, 1:])
        x = _refined(self, asked, grid[tree.query(asked)[1]])
        levels = np.interp(x[:, 1], np.arange(len(self.levels)), self.levels)
        return np.exp(levels) if self.is_log else levels, self.at(*x.T)


def _refined(patch: FoamPatch, asked: Pairs, x: Pairs) -> Pairs:
    """Move points (t, s) until their moduli are nearest, by Gauss-Newton in the box."""
    x = x.copy()
    active = np.arange(len(x))
    for _ in range(_SEARCH_STEPS):
        step = _step(patch, asked[active], x[active])
        moved = _moved(patch, asked[active], x[active], step)
        gone = np.abs(moved - x[active]).max(axis=1)
        x[active] = moved
        # From so small a step a quadratic iteration ends in rounding.
        active = active[gone > 1e-9]
        if not active.size:
            break
    return x


def _step(patch: FoamPatch, asked: Pairs, x: Pairs) -> Pairs:
    """Return the Gauss-Newton step of each point."""
    upper = np.array([1.0, patch.last])
    here = patch.at(*x.T)[:, 1:]
    r = here - asked
    # Differences towards the inside, so that they never leave the patch.
    h = np.where(x < 0.5 * upper, 1e-6, -1e-6)
    a, b = (
        (patch.at(*(x + h * axis).T)[:, 1:] - here) / h[:, [k]]
        for k, axis in enumerate(np.eye(2))
    )
    slope = np.stack([(a * r).sum(axis=1), (b * r).sum(axis=1)], axis=1)
    # A coordinate that the slope presses against its bound takes no part in the step.
    free = ((x > 0.0) | (slope < 0.0)) & ((x < upper) | (slope > 0.0))
    a, b, slope = a * free[:, :1], b * free[:, 1:], slope * free
    aa, ab, bb = (a * a).sum(axis=1), (a * b).sum(axis=1), (b * b).sum(axis=1)
    # Damped by rounding alone: a column may be zero.
    damping = 1e-14 * (aa + bb) + 1e-150
    aa, bb = aa + damping, bb + damping
    det = aa * bb - ab * ab
    first = ab * slope[:, 1] - bb * slope[:, 0]
    second = ab * slope[:, 0] - aa * slope[:, 1]
    return np.stack([first, second], axis=1) / det[:, None]


def _moved(patch: FoamPatch, asked: Pairs, x: Pairs, step: Pairs) -> Pairs:
    """Take the longest part of each step that brings the moduli nearer, if any does."""
    squared = lambda at, goal: ((patch.at(*at.T)[:, 1:] - goal) ** 2).sum(axis=1)
    x = x.copy()
    before = squared(x, asked)
    left = np.arange(len(x))
    for length in (1.0, 0.5, 0.1, 0.01):
        trial = np.clip(x[left] + length * step[left], 0.0, [1.0, patch.last])
        better = squared(trial, asked[left]) < before[left]
        x[left[better]] = trial[better]
        left = left[~better]
        if not left.size:
            break
    return x
