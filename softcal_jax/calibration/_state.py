"""Settings of the outer loop, and its state between steps."""

import math

import equinox as eqx
import jax.numpy as jnp

from softcal_jax._module import Module
from softcal_jax._typing import Array, Bool, Float, Int
from softcal_jax.calibration._curvature import Curvature, no_curvature
from softcal_jax.calibration._evaluation import Evaluation
from softcal_jax.calibration._qp import DAMPING

MEMORY = 5
"""Number of steps over which, rather than at each of which, the cost must fall.

The data often leave a narrow, curved valley. A Gauss-Newton step along it climbs its
wall a little, and the next one returns to its floor further down; if every step had to
lower the cost, the loop would creep (Grippo, Lampariello and Lucidi, SIAM J. Numer.
Anal. 23, 1986).
"""


MOST_STEPS = 1_000_000
"""Largest `max_steps`: the history of every run has room for so many."""


class CalibrationSettings(Module):
    """Settings of the outer loop.

    Attributes:
        tol: Largest entry of lambda_p at which the loop stops, without that step; with
            `adapt` also where it would lower the cost by less than `SMALLEST_FALL` [-].
        max_steps: Steps after which it gives up.
        step_bound: First bound on every entry of lambda_p; 1 is a factor e on a log
            scale and the whole range on a linear one [-].
        max_step_bound: Largest bound on a step; beyond a factor of two the linear model
            says little, and the guess of the equilibria is poor [-].
        damping: Levenberg damping of the QP, for columns of W of unit length. It holds
            back directions that the data hardly see; the minimum stays the same, but
            takes more steps [-].
        adapt: Adapt the bound, refuse steps that do not help over `MEMORY` steps, and
            learn the curvature of the errors. Without it, every step is that of the
            linear model within a fixed bound, as in the paper.
    """

    tol: float = eqx.field(static=True, default=1e-6)
    max_steps: int = eqx.field(static=True, default=50)
    step_bound: float = eqx.field(static=True, default=0.3)
    max_step_bound: float = eqx.field(static=True, default=0.5)
    damping: float = eqx.field(static=True, default=DAMPING)
    adapt: bool = eqx.field(static=True, default=True)

    def __check_init__(self):
        if not 0.0 < self.tol < 1.0:
            raise ValueError(f"tol must lie in (0, 1), got {self.tol}.")
        if not 1 <= self.max_steps <= MOST_STEPS:
            raise ValueError(
                f"max_steps must lie between 1 and {MOST_STEPS}, got {self.max_steps}."
            )
        if not 0.0 < self.damping <= 1.0:
            # More, and every step would be too short to tell from none.
            raise ValueError(f"damping must lie in (0, 1], got {self.damping}.")
        for name in ("step_bound", "max_step_bound"):
            value = getattr(self, name)
            if not 0.0 < value < math.inf:
                raise ValueError(f"{name} must be positive and finite, got {value}.")


class CalibrationState(Module):
    """State of the outer loop.

    Attributes:
        z: Scaled parameters [-].
        evaluation: Equilibria, errors and compliances at `z`.
        curvature: Curvature of the errors, estimated from past steps.
        recent_costs: Costs of the last accepted steps, the latest first [-].
        step_bound: Bound on the next step [-].
        lambda_p: Last QP step, accepted or refused [-].
        kkt_residual: Its optimality residual [-].
        accepted: Whether it was accepted.
        step: Number of steps so far.
        converged: Whether lambda_p has vanished, not shortened by the step bound, or
            steps were refused at a minimum.
        stalled: Whether steps were refused until the step bound was below `tol`, away
            from a minimum.
    """

    z: Float[Array, " n_p"]
    evaluation: Evaluation
    curvature: Curvature
    recent_costs: Float[Array, " memory"]
    step_bound: Float[Array, ""]
    lambda_p: Float[Array, " n_p"]
    kkt_residual: Float[Array, ""]
    accepted: Bool[Array, ""]
    step: Int[Array, ""]
    converged: Bool[Array, ""]
    stalled: Bool[Array, ""]


def initial_state(
    settings: CalibrationSettings, z: Float[Array, " n_p"], evaluation: Evaluation
) -> CalibrationState:
    """Return the state before the first step."""
    costs = jnp.full((MEMORY,), -jnp.inf, z.dtype)
    return CalibrationState(
        z=z,
        evaluation=evaluation,
        curvature=no_curvature(z),
        recent_costs=costs.at[0].set(evaluation.cost),
        step_bound=jnp.full((), settings.step_bound, z.dtype),
        lambda_p=jnp.full_like(z, jnp.inf),
        kkt_residual=jnp.zeros((), z.dtype),
        accepted=jnp.ones((), bool),
        step=jnp.zeros((), jnp.int32),
        converged=jnp.zeros((), bool),
        stalled=jnp.zeros((), bool),
    )
