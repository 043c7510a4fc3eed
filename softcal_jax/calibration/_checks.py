"""Checks of a calibration: what there is to learn, and another optimiser."""

from collections.abc import Sequence
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._typing import Array, Float
from softcal_jax.calibration._evaluation import Evaluation, effector_errors
from softcal_jax.calibration._problem import CalibrationProblem
from softcal_jax.equilibrium import (
    as_guess,
    effector_values,
    solve_equilibrium,
    solve_from_rest,
)
from softcal_jax.fields import AbstractFieldEntry, Poses, SetupParameter
from softcal_jax.unknowns import held_nodes

ROUNDING = 1e-12
"""Change of a coordinate by a unit of lambda_p, over its size, that is rounding [-]."""


def check_effects(problem: CalibrationProblem) -> None:
    """Raise ValueError unless something is measured that may depend on each parameter.

    What only an equilibrium shows is left to `check_sensitive`.
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


def _missing(problem: CalibrationProblem, entry, arrays, held) -> str:
    """Say why no configuration depends on an entry; empty if one may."""
    if isinstance(entry, AbstractFieldEntry):
        mesh, region = problem.model.mesh, entry.region
        tets = mesh.tets if region is None else mesh.tets[mesh.tets_of(region)]
        if held[:, tets].all():
            where = "the body" if region is None else repr(region)
            return f"all tets of {where} are held in every pose"
        if entry.fields == ("density",) and not np.any(arrays.gravity):
            return "no configuration has gravity"
    if isinstance(entry, SetupParameter) and entry.quantity.absent:
        recordings = ("",) * len(arrays.gravity)
        poses = Poses(problem.model, arrays, recordings)
        if not any(key is not None for key in entry.quantity.occurs(poses)[entry.of]):
            return entry.quantity.absent.format(of=entry.of)
    return ""


def check_sensitive(problem: CalibrationProblem, first: Evaluation) -> None:
    """Raise ValueError unless a measured coordinate depends on some parameter.

    One parameter without effect beside others that have one is no error: the angle of
    an axis has none where the moduli are equal. `first` is the evaluation at the start.
    """
    weight = np.asarray(problem.configurations.effectors.inverse_std)
    effectors = np.abs(np.asarray(first.effectors))
    size = np.max(weight * effectors, initial=0.0)
    W = np.asarray(first.rows.W)[: weight.size]
    if not np.all(np.isfinite(W)) or np.max(np.abs(W)) > ROUNDING * size:
        return
    names = ", ".join(map(repr, problem.space.names))
    raise ValueError(
        f"nothing to learn of {names}: no measured coordinate moves with it at the "
        "start equilibrium. Check that a load, gravity or an actuator deforms the body "
        "where it is measured, and not only parts that are held, or start from another "
        "value."
    )


def check_cost(
    problem: CalibrationProblem, first: Evaluation, names: Sequence[str]
) -> None:
    """Raise ValueError if a standard deviation is so small that the cost overflows."""
    error = np.asarray(first.rows.error)
    with np.errstate(over="ignore", invalid="ignore"):
        if np.isfinite(error @ error):
            return
    weight = np.asarray(problem.configurations.effectors.inverse_std)
    c = int(np.argmax(np.max(weight, axis=(1, 2))))
    raise ValueError(
        "the cost at the start is not finite, since an error is too large beside its "
        f"standard deviation: the smallest is {1.0 / np.max(weight):.3g} in SI units, "
        f"in configuration {names[c]!r}. Check the `std` of effectors and priors, and "
        "their units."
    )


def levenberg_marquardt(
    problem: CalibrationProblem,
) -> tuple[Float[Array, " n_p"], bool]:
    """Fit by Levenberg-Marquardt of optimistix, without bounds, to check `calibrate`.

    The Jacobian is by autodiff through the implicit derivative of the equilibrium.
    Returns scaled parameters, and whether it converged inside the bounds.
    """
    import optimistix as optx  # here, as it takes a fifth of the package's import time

    begin = problem.space.start()
    guess = as_guess(solve_from_rest(*problem.at(begin), problem.newton))

    def errors(z, problem: CalibrationProblem):
        model, configurations = problem.at(z)
        newton = problem.newton
        solve = lambda c, u: solve_equilibrium(model, c, guess=u, settings=newton)
        solution = jax.vmap(solve)(configurations, guess)
        states = solution.displacement, solution.multipliers
        e = jax.vmap(partial(effector_values, model))(configurations, *states)
        delta_e = effector_errors(problem, e)
        none = jnp.zeros((delta_e.size, z.shape[0]))
        error = problem.rows(z, delta_e, none).error
        # A step to parameters without equilibrium must be refused.
        return jnp.where(jnp.all(solution.converged), error, jnp.inf)

    solution = optx.least_squares(
        errors,
        optx.LevenbergMarquardt(rtol=1e-10, atol=1e-10),
        begin,
        args=problem,
        options={"jac": "fwd"},
        max_steps=100,
        throw=False,
    )
    z = solution.value
    down, up = problem.space.room(z)
    inside = jnp.all((down <= 0.0) & (up >= 0.0))
    return z, bool(inside & (solution.result == optx.RESULTS.successful))
