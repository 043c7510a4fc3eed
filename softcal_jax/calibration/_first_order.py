"""Whether first-order intervals hold: the cost at their ends, against its parabola."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import jax
import numpy as np

from softcal_jax._typing import Array, Float, HostArray
from softcal_jax.calibration._evaluation import (
    Evaluation,
    Evaluator,
)
from softcal_jax.calibration._linear import linear_model
from softcal_jax.calibration._profile import (
    LOWER,
    LowerCostFound,
    room_beside,
)
from softcal_jax.calibration._result import (
    Fitted,
)
from softcal_jax.equilibrium import Workers
from softcal_jax.fields import ParameterSpace
from softcal_jax.inference import LinearModel

CURVED = 0.1
"""Relative error of the root of the rise at which an end is no longer first-order [-].

On a parabola the root of the rise of twice the cost is the distance over the standard
error. With both ends a tenth too close to the fit, an interval that says 95 % holds
92 % of the time; with one too close and the other too far, 94 %.
"""


class _Checked(NamedTuple):
    """A calibration at z, where it ended; `quantile` standard errors lead to an end.

    `about` returns the linear model about other scaled parameters, from these and their
    evaluation, with the noise of `linear`.
    """

    evaluate: Callable[..., Evaluation]
    about: Callable[[Float[Array, " n_p"], Evaluation], LinearModel]
    space: ParameterSpace
    z: HostArray
    at: Evaluation
    linear: LinearModel
    quantile: float


def first_order_holds(
    fitted: Fitted, quantile: float, which: Sequence[int]
) -> list[bool]:
    """Check the cost at both ends of the first-order intervals of parameters.

    A parameter is moved by `quantile` standard errors, and the others with it along the
    column of their covariance, as the profile does on a parabola. There the root of the
    rise of twice the cost must be the quantile within `CURVED`, and still be that if
    the others took one more Gauss-Newton step: the first shows a valley that bends, the
    second one whose floor falls off. One evaluation for each end, all side by side.

    Raises:
        LowerCostFound: If the cost is lower at an end than at the fit.
    """
    result, problem, configurations, at = fitted
    linear = result.linear.of_fit()

    def about(z: Float[Array, " n_p"], there: Evaluation) -> LinearModel:
        model = linear_model(
            problem,
            configurations,
            z=z,
            W_ep=there.response.W_ep,
            ok=there.response.ok,
            delta_e=there.delta_e,
            rows=there.rows,
        )
        return model.with_scale(linear.scale)

    sides = [(column, sign) for column in which for sign in (-1, 1)]
    lanes = len(sides) * len(configurations)
    with Workers(problem.model, max(lanes, 1)) as workers:
        fit = _Checked(
            evaluate=Evaluator(problem, workers),
            about=about,
            space=problem.space,
            z=np.asarray(result.z),
            at=at,
            linear=linear,
            quantile=quantile,
        )
        ends = workers.side_by_side(partial(_end_holds, fit, *side) for side in sides)
    return [low and high for low, high in zip(ends[::2], ends[1::2], strict=True)]


def _end_holds(fit: _Checked, column: int, sign: int) -> bool:
    """Check one end; see `first_order_holds`."""
    space, linear = fit.space, fit.linear
    covariance = linear.covariance()
    free = linear.known
    std = np.sqrt(covariance[column, column])
    if fit.quantile * std >= room_beside(space, fit.z, column, sign):
        return False
    step = np.where(free, sign * fit.quantile * covariance[column] / std, 0.0)
    down, up = map(np.asarray, space.room(jax.device_put(fit.z)))
    step = np.clip(step, down, up)
    if _breaks_order(space, fit.z + step):
        return False
    z = jax.device_put(fit.z + step)
    there = fit.evaluate(z, fit.at.response.equilibrium.displacement)
    if not there.ok:
        return False
    rise_of_end = (fit.quantile * linear.scale) ** 2
    if float(there.cost) < float(fit.at.cost) - 0.5 * LOWER * rise_of_end:
        raise LowerCostFound(z, float(there.cost), float(fit.at.cost))
    moved = fit.about(z, there)
    # The fit stops where its slope has nearly vanished, and what is left counts here.
    slope = np.where(linear.held, 0.0, linear.slope())
    rise = moved.squares() - linear.squares() - 2.0 * slope @ step
    left = moved.slope() - slope
    # What ended on a bound may leave it again, now that this parameter has moved.
    leaves = np.where(left < 0.0, up > 0.0, down < 0.0) & linear.held
    others = np.flatnonzero((free & (step > down) & (step < up)) | leaves)
    others = others[others != column]
    left = left[others]
    curvature = moved.curvature()[np.ix_(others, others)]
    fall = left @ np.linalg.lstsq(curvature, left, rcond=None)[0] if len(left) else 0.0
    roots = np.sqrt(np.maximum([rise, rise - fall], 0.0))
    return bool(np.all(np.abs(roots - fit.quantile) <= CURVED * fit.quantile))


def _breaks_order(space, z: HostArray) -> bool:
    """Return whether moduli are in the wrong order."""
    A, b = map(np.asarray, space.order_rows())
    chart = space.chart
    crossed = chart is not None and np.any(z[chart.small] > z[chart.large])
    return bool(np.any(A @ z > b) or crossed)
