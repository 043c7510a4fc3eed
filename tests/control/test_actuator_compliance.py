"""W_ea and W_aa: differences of solves, duality, and one factorization for all."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from arm import EFFECTORS, REST, arm, arrays, pose, solved

from softcal_jax.configurations import ImposedDisplacement, ImposedForce
from softcal_jax.control import (
    ControlSettings,
    actuator_compliance,
    commanded,
    with_goals,
    with_inputs,
)
from softcal_jax.control._command import Command
from softcal_jax.equilibrium import Workers

DRIVES = {
    "tensions and an angle": {"top": 1.0, "bottom": 0.4, "motor": 0.3},
    "shortenings and a torque": {
        "top": ImposedDisplacement(0.004),
        "bottom": ImposedDisplacement(0.001),
        "motor": ImposedForce(0.001),
    },
    "one of each": {
        "top": ImposedDisplacement(0.003),
        "bottom": 0.3,
        "motor": -0.2,
    },
}
HANGING = (2.0, 0.0, -0.5)
"""Gravity along the arm: stable with its motor free, too."""


def driven_by(drive):
    configuration = arrays(pose(HANGING, effectors=EFFECTORS, **DRIVES[drive]))
    solution, state = solved(arm(), configuration, configuration.actuation.value)
    assert solution.converged
    return configuration, state, actuator_compliance(arm(), configuration, solution)


def test_W_aa_is_symmetric_positive_definite():
    """Solved for as W by_force = by_displacement, which knows of no symmetry."""
    _, _, response = driven_by("tensions and an angle")
    W = np.asarray(response.W_aa)
    raw = np.linalg.solve(response.by_force.T, response.by_displacement.T).T
    np.testing.assert_allclose(raw, raw.T, rtol=0, atol=1e-9 * np.abs(raw).max())
    size = np.sqrt(np.diag(W))
    assert np.linalg.eigvalsh(W / np.outer(size, size)).min() > 0.01


def driven(configuration, state, by_displacement):
    """The same state, other quantities imposed."""
    flags = jnp.array(by_displacement)
    lane = eqx.tree_at(lambda c: c.actuation.by_displacement, configuration, flags)
    value = jnp.where(flags, state.displacements, state.forces)
    solution, same = solved(arm(), lane, value)
    assert solution.converged
    np.testing.assert_allclose(same.effectors, state.effectors, rtol=1e-6, atol=1e-9)
    return actuator_compliance(arm(), with_inputs(lane, value), solution)


def test_W_aa_is_the_same_however_it_is_driven():
    """The state of two tensions and an angle, driven by all other pairs, too."""
    configuration, state, response = driven_by("tensions and an angle")
    for by_displacement in ([True, True, True], [True, False, False]):
        other = driven(configuration, state, by_displacement)
        np.testing.assert_allclose(other.W_aa, response.W_aa, rtol=1e-6)
    held = driven(configuration, state, [True, True, True])
    np.testing.assert_allclose(
        held.by_force @ response.W_aa, np.eye(3), rtol=0, atol=1e-6
    )


def test_slack_cable_does_not_act():
    """Its length follows the others, its input does nothing."""
    configuration = arrays(
        pose(REST, top=1.0, bottom=ImposedDisplacement(-0.02), effectors=EFFECTORS)
    )
    solution, _ = solved(arm(), configuration, configuration.actuation.value)
    response = actuator_compliance(arm(), configuration, solution)
    np.testing.assert_array_equal(response.slack, [False, True, False])
    np.testing.assert_array_equal(response.W_ea[:, 1], 0.0)
    np.testing.assert_array_equal(response.W_aa[1], 0.0)
    assert response.by_displacement[1, 0] != 0.0
    assert response.state.forces[1] == 0.0


def right_hand_sides(jaxpr, inside=()):
    """Sizes of all factorizations in a program, and the loops around them."""
    for equation in jaxpr.eqns:
        name = equation.primitive.name
        if "pardiso" in name or "factor" in name or "ffi" in name:
            yield name, [v.aval.shape for v in equation.invars], inside
        for value in equation.params.values():
            if name == "custom_linear_solve":
                value = value.solve  # the others serve its transpose
            for part in value if isinstance(value, tuple | list) else (value,):
                inner = getattr(part, "jaxpr", part)
                if hasattr(inner, "eqns"):
                    yield from right_hand_sides(inner, (*inside, name))


def test_one_factorization_for_all_inputs():
    """Three inputs, and the columns of two actuators: a motor, held, needs none."""
    if arm().solver.name.startswith("KLU"):
        pytest.skip("counts the calls of PARDISO")
    configuration = arrays(pose(effectors=EFFECTORS, **DRIVES["one of each"]))
    solution, _ = solved(arm(), configuration, configuration.actuation.value)
    dynamic, static = eqx.partition((arm(), configuration, solution), eqx.is_array)
    program = lambda dynamic: actuator_compliance(*eqx.combine(dynamic, static))
    calls = list(right_hand_sides(jax.make_jaxpr(program)(dynamic).jaxpr))
    n_dof = arm().n_dof
    sizes = [
        shape[0]
        for name, shapes, inside in calls
        for shape in shapes
        if len(shape) == 2
        and shape[1] == n_dof
        and "scan" not in inside
        # In a cond is the spare order, for a zero pivot of the first.
        and "cond" not in inside
    ]
    assert sizes == [5], calls


def test_no_equilibrium_no_derivative():
    configuration = arrays(pose(top=1.0, effectors=EFFECTORS))
    solution, _ = solved(arm(), configuration, configuration.actuation.value)
    lost = eqx.tree_at(
        lambda s: s.displacement, solution, jnp.full_like(solution.displacement, np.nan)
    )
    response = actuator_compliance(arm(), configuration, lost)
    assert np.all(np.isnan(response.W_ea[:9]))


@pytest.mark.slow
@pytest.mark.parametrize("sign", [1.0, -1.0, 0.0])
def test_energy_of_a_robot_that_its_motors_hold(sign):
    """W_aa without a positive eigenvalue: sizes count, and nothing is divided by 0."""
    cables = {"top": 1.0, "bottom": 0.4}
    start = with_goals(
        pose(HANGING, effectors=EFFECTORS, **cables), {"tip": (0.1, 0.01, 0.02)}
    )
    configuration = arrays(start)
    solution, _ = solved(arm(), configuration, configuration.actuation.value)
    # Of the cables alone: the motor is held, and not commanded.
    of_all = actuator_compliance(arm(), configuration, solution)
    W_aa = np.asarray(of_all.by_displacement)[:2, :2]
    inputs, settings = commanded(arm().mechanism, start, {}), ControlSettings()
    settings = replace(settings, epsilon=1e-3)
    with Workers(arm(), 1) as workers:
        robot = Command(arm(), start, inputs, settings, workers)
        begin, u = robot.problem.space.start(), solution.displacement[None]
        here = robot(begin, u, precise=True)
        follow = [3 * row for row in robot._follow]
        W = here.response.W_ep.at[:, np.array(follow)].multiply(sign)
        here = eqx.tree_at(lambda e: e.response.W_ep, here, W)
        robot, here = robot.weighing_energy(here)
    assert np.all(np.isfinite(here.rows.W))
    energy = robot.energy.T @ robot.energy
    share = energy / W_aa
    np.testing.assert_allclose(share, share[0, 0], rtol=1e-6)
    assert (share[0, 0] > 0.0) == (sign != 0.0)
