"""Derivatives of an equilibrium by its inputs, Eqs. (4) to (9).

An input is a parameter, a value imposed on an actuator or a leaf of the model that a
user differentiates.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from softcal_jax._typing import Array, Bool, Float
from softcal_jax.configurations import ConfigurationArrays
from softcal_jax.equilibrium._linearisation import Linearisation, residual
from softcal_jax.equilibrium._model import Model, Nodal
from softcal_jax.equilibrium._posed import Posed

OfInputs = Callable[[Model, ConfigurationArrays], Any]
Readings = Callable[
    [Model, ConfigurationArrays, Nodal, Float[Array, " n_a"], Nodal],
    Float[Array, "..."],
]
"""Function, such as `effector_values`, of a state (u, multipliers) and its `residual`.

Internal forces are read off the residual alone, which needs no pass over the tets.
"""


class InputRows(NamedTuple):
    """Effects of a unit of each input at a fixed state, by rows; see `input_rows`.

    Held nodes and bodies follow the input in all of them.

    Attributes:
        force: -dR/dp, the force on the free unknowns [N].
        held: Motion of held nodes and bodies [m].
        gap: Change of imposed minus current delta_a of `Model.with_multiplier`.
        reading: Direct change of the readings; empty if nothing is read.
    """

    force: Float[Array, "*n n_dof"]
    held: Float[Array, "*n n_points 3"]
    gap: Float[Array, "*n n_m"]
    reading: Float[Array, "*n n_e"]


def derivatives(
    function: Callable[[Float[Array, " n"]], Any], value: Float[Array, " n"]
) -> Any:
    """Differentiate a function by each entry of its argument, stacked.

    One entry after the other: a `vmap` of products with the sparse tangent is slower.
    """
    _, slope = jax.linearize(function, value)
    return jax.lax.map(slope, jnp.eye(value.size))


def input_rows(
    linearisation: Linearisation,
    by_inputs: Callable[[OfInputs], Any],
    readings: Readings | None = None,
) -> InputRows:
    """Differentiate balance, supports and readings by the inputs.

    `by_inputs` maps a function of (model, configuration), whose values are a tree of
    arrays, to its derivatives by all inputs, stacked. The tets are only differentiated
    by inputs that change their law: strains due to a moved support follow from the
    tangent.
    """
    lin = linearisation
    u, lambda_a, which = lin.u, lin.lambda_a, lin.posed.model.with_multiplier

    def at_fixed_unknowns(model, configuration):
        posed = Posed.of(model, configuration)
        placed = posed.held_at(u)
        forces = residual(model, configuration, u, lambda_a) + lin.stiffness(placed - u)
        wanted = jnp.asarray(configuration.actuation.value)
        reading = jnp.zeros(0)
        if readings is not None:
            reading = readings(model, configuration, placed, lambda_a, forces).ravel()
        return InputRows(
            # The mounting of a tied body changes the arms of forces.
            force=-posed.gather(placed, forces),
            held=placed,
            gap=(wanted - model.displacements(placed))[which],
            reading=reading,
        )

    rows = by_inputs(at_fixed_unknowns)
    fixed = lin.posed.fixed
    return rows._replace(force=jnp.where(fixed[None], 0.0, rows.force))


class Sensitivity(NamedTuple):
    """Derivatives of an equilibrium by its inputs; zero if the tangent is not `ok`.

    W_ep is the change of each reading per unit of each input, in its unit. Changes of
    displacement, free unknowns [m] and multipliers, by rows, are None if adjoint;
    `readings` is None if nothing is read.
    """

    W_ep: Float[Array, "*batch n_e n"]
    ok: Bool[Array, "*batch"]
    displacement: Float[Array, "*batch n n_points 3"] | None = None
    unknowns: Float[Array, "*batch n n_dof"] | None = None
    multipliers: Float[Array, "*batch n n_a"] | None = None
    readings: Float[Array, "*batch n_e"] | None = None


@eqx.filter_jit
def sensitivity(
    linearisation: Linearisation,
    rows: InputRows,
    readings: Readings | None = None,
    *,
    adjoint: bool = False,
) -> Sensitivity:
    """Turn the rows of inputs into derivatives of state and readings; Eq. (9).

    W_ep = H_e K^-1 H_p^T + de/dp, with one factorization; K is bordered by the rows of
    actuators whose displacement is imposed. `adjoint` solves for K^-T H_e^T instead,
    faster if there are fewer readings.
    """
    lin = linearisation
    if adjoint:
        assert readings is not None
        H = adjoint_rows(lin, readings)
        _check_readings(rows, len(H.state))
        W = H.state @ rows.force.T + H.gap @ rows.gap.T + rows.reading.T
        return Sensitivity(W, H.ok, readings=H.readings)
    solved = lin.solve(rows.force, rows.gap)
    moved = lin.scatter(solved.x)
    changed = lin.posed.model.among_all(solved.lambda_a)
    W, value = rows.reading.T, None
    if readings is not None:
        at_inputs = _at_fixed_inputs(lin, readings)
        value, slope = jax.linearize(at_inputs, lin.u, lin.lambda_a)
        _check_readings(rows, value.size)
        # One after the other, like `derivatives`.
        W = W + jax.lax.map(lambda d: slope(*d), (moved, changed)).T
    return Sensitivity(
        W_ep=W,
        ok=solved.ok,
        displacement=rows.held + moved,
        unknowns=solved.x,
        multipliers=changed,
        readings=value,
    )


def _check_readings(rows: InputRows, n_e: int) -> None:
    """Raise ValueError where rows were made for another number of readings."""
    if (n := rows.reading.shape[-1]) != n_e:
        raise ValueError(
            f"the rows of the inputs are for {n} readings, and {n_e} are asked for: "
            "give `parameter_rows` or `input_rows` the same `readings`."
        )


class AdjointRows(NamedTuple):
    """K^-T H_e^T: derivatives of readings by forces on free unknowns, and by gaps."""

    state: Float[Array, "n_e n_dof"]
    gap: Float[Array, "n_e n_m"]
    ok: Bool[Array, ""]
    readings: Float[Array, " n_e"]


@eqx.filter_jit
def adjoint_rows(linearisation: Linearisation, readings: Readings) -> AdjointRows:
    """Solve for the rows of H_e, one right-hand side per reading."""
    lin = linearisation
    value, pull_back = jax.vjp(_at_fixed_inputs(lin, readings), lin.u, lin.lambda_a)
    by_u, by_lambda = jax.lax.map(pull_back, jnp.eye(value.size))
    which = lin.posed.model.with_multiplier
    solved = lin.solve(jax.vmap(lin.free)(by_u), -by_lambda[:, which], transpose=True)
    return AdjointRows(solved.x, -solved.lambda_a, solved.ok, value)


def _at_fixed_inputs(lin: Linearisation, readings: Readings):
    robot = (lin.posed.model, lin.posed.configuration)
    g = lin.unbalanced
    return lambda u, lambda_a: readings(*robot, u, lambda_a, g(u, lambda_a)).ravel()
