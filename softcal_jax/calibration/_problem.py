"""What a calibration is asked for, what it can learn, and its linear model."""

import math
from collections.abc import Sequence
from functools import partial
from typing import Literal, NamedTuple

import equinox as eqx
import jax
import numpy as np

from softcal_jax._module import Module, key
from softcal_jax._typing import Array, Bool, Float, HostArray
from softcal_jax.calibration._qp import DAMPING
from softcal_jax.fields import (
    KINDS,
    PRECISION,
    AbstractFieldEntry,
    SetupParameter,
    kind_of,
)
from softcal_jax.inference import ErrorColumns, LinearModel, Whitened, no_errors, span
from softcal_jax.unknowns import Problem, held_nodes, noise_columns

MOST_STEPS = 1_000_000
"""Largest `max_steps`: the history of every run has room for so many."""


_number = partial(eqx.field, converter=float)


class CalibrationSettings(Module):
    """Settings of the outer loop.

    Attributes:
        tol: Largest entry of lambda_p at which the loop stops, without that step. With
            `adapt` it also stops where a step would lower the cost by less than
            `least_fall`, or than a move of 1e-3 standard errors (by the residuals) does
            [-].
        max_steps: Steps after which it gives up.
        step_bound: First bound on every entry of lambda_p; 1 is a factor e on a log
            scale and the whole range on a linear one [-].
        max_step_bound: Largest bound on a step; beyond a factor of two the linear model
            says little, and the guess of the equilibria is poor [-].
        damping: Levenberg damping of the QP, for columns of W of unit length. It holds
            back directions that the data hardly see, without moving the minimum [-].
        least_fall: Relative fall of the cost that is not worth a step. Where the fit
            leaves an error, Gauss-Newton converges linearly, and many small steps would
            follow that hardly change the fit [-].
        least_cost: Cost below which a fall counts relative to this one, in squares of
            stated standard deviations: where errors are tolerances, a thousandth of one
            need not be halved again [-].
        adapt: Adapt the bound, refuse steps that do not help over `MEMORY` steps, and
            learn the curvature of the errors. Without it, every step is that of the
            linear model within a fixed bound, as in the paper, and a shorter one only
            where it leads to no equilibrium.
    """

    tol: float = _number(default=1e-6, metadata=key(""))
    max_steps: int = 50
    step_bound: float = _number(default=0.3, metadata=key(""))
    max_step_bound: float = _number(default=0.5, metadata=key(""))
    damping: float = _number(default=DAMPING, metadata=key(""))
    least_fall: float = _number(default=1e-8)
    least_cost: float = _number(default=0.0)
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
        for name in ("step_bound", "max_step_bound", "least_fall"):
            value = getattr(self, name)
            if not 0.0 < value < math.inf:
                raise ValueError(f"{name} must be positive and finite, got {value}.")
        if not 0.0 <= self.least_cost < math.inf:
            raise ValueError(
                f"least_cost must be finite and not negative, got {self.least_cost}."
            )

    def as_arrays(self) -> "CalibrationSettings":
        """Return the settings as arrays, so that one compiled program serves all."""
        kind = lambda value: np.int32 if isinstance(value, int) else float
        host = jax.tree.map(lambda value: np.asarray(value, kind(value)), self)
        return jax.device_put(host)


def n_measured(problem: Problem) -> int:
    """Return the number of measured coordinates, less those used up by attachments."""
    effectors, noise = problem.configurations.effectors, problem.noise
    n = int(np.sum(np.asarray(effectors.inverse_std) > 0.0))
    if noise is None:
        return n
    return n - span(noise.on_host(effectors)[:, noise.n_common :]).shape[1]


def linear_model(
    problem: Problem,
    z: Float[Array, " n_p"],
    *,
    W_ep: Float[Array | HostArray, "n_c n_e n_p"],
    ok: Sequence[bool] | Bool[Array, " n_c"],
    delta_e: Float[Array | HostArray, "n_c n_rows 3"],
    rows: Whitened | None = None,
    considered: ErrorColumns | None = None,
) -> LinearModel:
    """Make the linear model of measured coordinates, in stated standard deviations.

    The problem must have the noise that weighed its data. Rows of a held-out
    configuration that is not `ok`, for want of an equilibrium or of a regular tangent,
    are left out. The last `rows` of a fit are distances from the priors; give none if
    nothing was fitted.
    """
    space, n_c, level = problem.space, len(problem.poses), float(problem.level)
    from_prior = np.zeros(len(space.names))
    if rows is not None:
        from_prior = np.asarray(rows.error)[-len(from_prior) :] / level
    effectors = problem.configurations.effectors
    weight = np.asarray(effectors.inverse_std)
    considered = no_errors(weight.size) if considered is None else considered
    finite = np.isfinite(considered.values).all(axis=1).reshape(n_c, -1).all(axis=1)
    regular = np.asarray(ok) & finite
    used = regular | (np.arange(n_c) < problem.n_fitted)
    measured = ((weight > 0.0) & used[:, None, None]).ravel()
    pose = np.repeat(np.arange(n_c), weight[0].size)
    whole = LinearModel(
        names=tuple(space.names),
        poses=problem.names,
        pose=pose,
        fitted=pose < problem.n_fitted,
        r=np.ravel(weight * np.asarray(delta_e)),
        W=weight.reshape(-1, 1) * np.concatenate(np.asarray(W_ep)),
        correlated=noise_columns(problem.noise, effectors, problem.poses),
        considered=considered,
        scale=level,
        from_prior=from_prior,
        prior_weights=np.asarray(space.prior_weights()),
        held=space.at_bound(z),
    )
    return whole.only(measured)


def check_effects(problem: Problem) -> None:
    """Raise ValueError if nothing that is measured can depend on a parameter.

    What only an equilibrium can show is left to `check_sensitive`.
    """
    arrays = jax.tree.map(np.asarray, problem.configurations)
    if not np.any(arrays.effectors.inverse_std > 0.0):
        raise ValueError(
            "no coordinate is measured: every marker has `axes` that leave all of them "
            "out, or no value. Measure at least one coordinate."
        )
    held = held_nodes(problem.model, problem.configurations)
    for entry in problem.space.entries:
        missing = _missing(problem, entry, arrays, held)
        if missing:
            names = ", ".join(repr(q.name) for q in entry.parameters)
            raise ValueError(
                f"nothing to learn of {names}: {missing}. Leave it out, or add a "
                "configuration that depends on it."
            )


def _missing(problem: Problem, entry, arrays, held) -> str:
    """Say why no configuration depends on an entry; empty if one may."""
    if isinstance(entry, AbstractFieldEntry):
        mesh, region = problem.model.mesh, entry.region
        tets = mesh.tets if region is None else mesh.tets[mesh.tets_of(region)]
        if held[:, tets].all():
            where = "the body" if region is None else repr(region)
            return f"all tets of {where} are held in every pose"
        kinds = [kind_of(problem.model, field) for field in entry.fields]
        for by in {kind.acts_by for kind in kinds} - {""}:
            if not np.any(getattr(arrays, by)):
                return f"no configuration has {by}"
    if isinstance(entry, SetupParameter) and (kind := KINDS[entry.kind]).absent:
        scopes = kind.occurs(problem.model, arrays, ("",) * len(arrays.gravity))
        if not any(key is not None for key in scopes[entry.of]):
            return kind.absent.format(of=entry.of)
    return ""


class FitOptions(NamedTuple):
    """How a problem is fitted and judged: arguments of `calibrate`."""

    noise: Literal["estimated", "stated"]
    settings: CalibrationSettings
    precision: float = PRECISION
    starts: int = 1
    seed: int = 0
    start: Float[Array, " n_p"] | None = None
    intervals: float | None = None
