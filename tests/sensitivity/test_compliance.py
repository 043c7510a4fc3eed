import jax
import jax.numpy as jnp
import numpy as np
import pytest
from problems import both_ways, lane_of

from softcal_jax.configurations import (
    Configuration,
    Markers,
    Support,
    configuration_arrays,
)
from softcal_jax.equilibrium import (
    NewtonSettings,
    build_model,
    marker_positions,
    solve_equilibrium,
)
from softcal_jax.fields import Parameter, ParameterSpace
from softcal_jax.materials import NeoHookean
from softcal_jax.mesh import beam
from softcal_jax.sensitivity import (
    check_parameter_derivatives,
    parameter_compliance,
    parameter_forces,
)

# Equilibria to rounding, so that differences show their own error.
TIGHT = NewtonSettings(rtol=1e-12)
SPACE = ParameterSpace(
    (
        Parameter("E", "E", 3e4, 1e4, 1e6),
        Parameter("nu", "nu", 0.3, 0.0, 0.45, scale="linear", S=1.0),
        Parameter("rho", "density", 1e3, 1e2, 1e4),
    )
)


@pytest.fixture(scope="module")
def body():
    """A soft beam that sags visibly, and a marker on a post."""
    mesh = beam(0.1, 0.02, 0.02, (3, 1, 1))
    model = build_model(mesh, NeoHookean(3e4, 0.3), density=1000.0)
    markers = Markers(("tip", "post"), [[0.1, 0.01, 0.01], [0.1, 0.01, 0.025]])
    configurations = [
        Configuration(
            name,
            (Support("x_min"),),
            gravity,
            markers=markers,
            measured=markers.positions,
        )
        for name, gravity in (("down", (0.0, 0.0, -9.81)), ("side", (0.0, 5.0, -3.0)))
    ]
    return model, configuration_arrays(mesh, configurations)


def ways(model, lanes):
    """The markers of the solver at the start, and derivatives both ways."""

    def markers(z):
        changed = SPACE.model_at(model, z)

        def lane(c):
            solution = solve_equilibrium(changed, c, settings=TIGHT)
            return marker_positions(changed, c, solution)

        return jax.vmap(lane)(lanes)

    cotangent = jax.random.normal(jax.random.key(0), (2, 2, 3))
    dz = jnp.array([0.3, -0.2, 0.5])
    _, forward, reverse = both_ways(markers)(SPACE.start(), dz, cotangent)
    return dz, cotangent, forward, reverse


def stacked(positions):
    return np.asarray(positions).reshape(positions.shape[0], -1)


@pytest.fixture(scope="module")
def at_start(body):
    """Displacements and W_ep at the start."""
    model, lanes = body
    each = [lane_of(lanes, k) for k in range(2)]
    u = [solve_equilibrium(model, c, settings=TIGHT).displacement for c in each]
    W = [
        parameter_compliance(model, c, v, SPACE, SPACE.start()).W_ep
        for c, v in zip(each, u, strict=True)
    ]
    return u, np.stack(W)


# equilibrium/test_derivatives.py differentiates the solver both ways.
def test_compliance_is_the_implicit_derivative_of_the_solver(body, at_start):
    dz, cotangent, forward, reverse = ways(*body)
    expected = at_start[1] @ np.asarray(dz)
    np.testing.assert_allclose(stacked(forward), expected, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(
        jnp.vdot(cotangent, forward), jnp.vdot(reverse, dz), rtol=1e-9
    )


def test_force_of_a_denser_body_is_its_weight(body, at_start):
    model, lanes = body
    one, u = lane_of(lanes), at_start[0][0]
    H_p = parameter_forces(model, one, u, SPACE, SPACE.start())
    weight = 1000.0 * 0.1 * 0.02 * 0.02 * -9.81
    np.testing.assert_allclose(H_p[2].sum(axis=0), [0, 0, weight], atol=1e-12)


def test_derivative_check_of_a_linear_dependence_is_rounding(body, at_start):
    model, lanes = body
    one, u = lane_of(lanes), at_start[0][0]
    space = ParameterSpace((Parameter("E", "E", 1e5, 1e4, 1e6, scale="linear"),))
    check = check_parameter_derivatives(model, one, u, space, space.start())
    assert np.all(check.errors < 1e-9)
    assert np.isnan(check.orders).all()


def test_derivative_check_wants_falling_steps(body):
    model, lanes = body
    one = lane_of(lanes)
    u = jnp.zeros(model.mesh.points.shape)
    with pytest.raises(ValueError, match=r"steps .*falling.* \(0\.001, 0\.01\)"):
        check_parameter_derivatives(
            model, one, u, SPACE, SPACE.start(), steps=(1e-3, 1e-2)
        )
