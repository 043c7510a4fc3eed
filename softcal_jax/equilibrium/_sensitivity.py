"""How an equilibrium follows its inputs, Eqs. (4) to (9): one function for all of them.

Every input, be it a parameter, what is imposed on an actuator or a leaf of the model
that a user differentiates, is known by three rows at a fixed state: the force that a
unit of it puts on the free unknowns, the motion of what is held, and the direct change
of the readings. The linearised equilibrium turns them into derivatives.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp

from softcal_jax._typing import Array, Bool, Float
from softcal_jax.configurations import ConfigurationArrays
from softcal_jax.equilibrium import _actuation as actuation
from softcal_jax.equilibrium._linearisation import Linearisation, residual
from softcal_jax.equilibrium._model import Model
from softcal_jax.equilibrium._posed import Posed

OfInputs = Callable[[Model, ConfigurationArrays], Float[Array, "..."]]
Readings = Callable[
    [Model, ConfigurationArrays, Float[Array, "n_points 3"], Float[Array, " n_a"]],
    Float[Array, "..."],
]
"""What is read off a state, like `effector_values`: of u and multipliers."""


class InputRows(NamedTuple):
    """What a unit of each input does at a fixed state; from `input_rows` one row.

    Attributes:
        force: -dR/dp, the force on the free unknowns; what is held moves along [N].
        held: Motion of what is held [m].
        gap: How far imposed displacements of actuators have to go, for those that are
            solved for their force.
        reading: Direct change of the readings, with what is held moving along; empty
            where nothing is read.
    """

    force: Float[Array, "*n n_dof"]
    held: Float[Array, "*n n_points 3"]
    gap: Float[Array, "*n n_m"]
    reading: Float[Array, "*n n_e"]


def input_rows(
    model: Model,
    configuration: ConfigurationArrays,
    u: Float[Array, "n_points 3"],
    lambda_a: Float[Array, " n_a"],
    along: Callable[[OfInputs], Float[Array, "..."]],
    readings: Readings | None = None,
) -> InputRows:
    """Differentiate balance, supports and readings along one direction of the inputs.

    Args:
        model: The model.
        configuration: One configuration.
        u: Displacement at its equilibrium [m].
        lambda_a: Forces of actuators whose displacement is imposed.
        along: Takes a function of (model, configuration) to its derivative along the
            direction.
        readings: What is read off; nothing by default.
    """

    def held(model, configuration):
        return Posed.of(model, configuration).held_at(u)

    def balance(model, configuration):
        there = held(model, configuration)
        forces = residual(model, configuration, there, lambda_a)
        # The arm of a force changes, too, where the mounting of a tied body does.
        return Posed.of(model, configuration).gather(there, forces)

    def gap(model, configuration):
        wanted = jnp.asarray(configuration.actuation.value)
        return wanted - actuation.displacements(model, held(model, configuration))

    def read(model, configuration):
        assert readings is not None
        there = held(model, configuration)
        return readings(model, configuration, there, lambda_a).ravel()

    fixed = Posed.of(model, configuration).fixed()
    which = actuation.with_multiplier(model)
    return InputRows(
        force=jnp.where(fixed, 0.0, -along(balance)),
        held=along(held),
        gap=along(gap)[which] if which.size else jnp.zeros(0),
        reading=jnp.zeros(0) if readings is None else along(read),
    )


class Sensitivity(NamedTuple):
    """Derivatives of an equilibrium by its inputs.

    Attributes:
        W_ep: Change of each reading per unit of each input.
        displacement: Change of the displacement, by rows [m]; None from the adjoint
            side.
        unknowns: Change of the free unknowns, likewise [m].
        multipliers: Change of the multipliers, likewise.
        ok: Whether the tangent is regular; all else is zero where it is not.
    """

    W_ep: Float[Array, "n_e n"]
    displacement: Float[Array, "n n_points 3"] | None
    unknowns: Float[Array, "n n_dof"] | None
    multipliers: Float[Array, "n n_a"] | None
    ok: Bool[Array, ""]


def sensitivity(
    linearisation: Linearisation,
    rows: InputRows,
    readings: Readings | None = None,
    *,
    adjoint: bool = False,
) -> Sensitivity:
    """Turn the rows of inputs into derivatives of state and readings; Eq. (9).

    W_ep = H_e K^-1 H_p^T + de/dp, by one factorization; K is bordered by the rows of
    actuators whose displacement is imposed. The adjoint side takes K^-T H_e^T, where
    K^T is not K without a potential.

    Args:
        linearisation: The system at the equilibrium.
        rows: What a unit of each input does, stacked.
        readings: What is read off; nothing by default.
        adjoint: Solve for the rows of H_e instead of those of the inputs: better where
            there are fewer.
    """
    lin = linearisation
    if adjoint:
        assert readings is not None
        H = adjoint_rows(lin, readings)
        W = H.state @ rows.force.T + H.gap @ rows.gap.T + rows.reading.T
        return Sensitivity(
            W_ep=W, displacement=None, unknowns=None, multipliers=None, ok=H.ok
        )
    solved = lin.solve(rows.force, rows.gap)
    moved = lin.scatter(solved.x)
    changed = actuation.among_all(lin.model, solved.lambda_a)
    W = rows.reading.T
    if readings is not None:
        read = _at_fixed_inputs(lin, readings)
        state = (lin.u, lin.lambda_a)
        follow = jax.vmap(lambda du, dl: jax.jvp(read, state, (du, dl))[1])
        W = W + follow(moved, changed).T
    return Sensitivity(
        W_ep=W,
        displacement=rows.held + moved,
        unknowns=solved.x,
        multipliers=changed,
        ok=solved.ok,
    )


class AdjointRows(NamedTuple):
    """K^-T H_e^T: how readings follow forces on the unknowns, and gaps of actuators.

    Attributes:
        state: Change of each reading per force on each free unknown.
        gap: Change of each reading per gap.
        ok: Whether the tangent is regular.
    """

    state: Float[Array, "n_e n_dof"]
    gap: Float[Array, "n_e n_m"]
    ok: Bool[Array, ""]


def adjoint_rows(linearisation: Linearisation, readings: Readings) -> AdjointRows:
    """Solve for the rows of H_e, one right-hand side per reading.

    Args:
        linearisation: The system at the equilibrium.
        readings: What is read off.
    """
    lin = linearisation
    value, pull_back = jax.vjp(_at_fixed_inputs(lin, readings), lin.u, lin.lambda_a)
    by_u, by_lambda = jax.vmap(pull_back)(jnp.eye(value.size))
    which = actuation.with_multiplier(lin.model)
    solved = lin.solve(jax.vmap(lin.free)(by_u), -by_lambda[:, which], transpose=True)
    return AdjointRows(solved.x, -solved.lambda_a, solved.ok)


def _at_fixed_inputs(lin: Linearisation, readings: Readings):
    """The readings as a function of the state alone, in one row."""
    return lambda u, lambda_a: readings(
        lin.model, lin.configuration, u, lambda_a
    ).ravel()
