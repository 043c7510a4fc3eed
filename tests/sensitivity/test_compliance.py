import equinox as eqx
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


model_at = eqx.filter_jit(SPACE.model_at)
markers_at = eqx.filter_jit(marker_positions)


def solved(z, model, lanes):
    """Displacements, and the markers there."""
    changed, states = model_at(model, jnp.asarray(z)), []
    for index in range(2):
        lane = lane_of(lanes, index)
        solution = solve_equilibrium(changed, lane, settings=TIGHT)
        states.append((solution.displacement, markers_at(changed, lane, solution)))
    return tuple(np.stack(part) for part in zip(*states, strict=True))


def compliances(z, model, lanes, u, method="direct"):
    responses = [
        parameter_compliance(
            model, lane_of(lanes, k), jnp.asarray(u[k]), SPACE, z, method=method
        )
        for k in range(2)
    ]
    return np.stack([each.W_ep for each in responses])


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
    u, _ = solved(SPACE.start(), *body)
    return u, compliances(SPACE.start(), *body, u)


def test_direct_and_adjoint_sides_agree(body, at_start):
    u, direct = at_start
    adjoint = compliances(SPACE.start(), *body, u, "adjoint")
    # The same numbers by transposed sums: the rounding of one solve between them.
    scale = np.max(np.abs(direct))
    np.testing.assert_allclose(direct, adjoint, atol=1e-10 * scale, rtol=0)


@pytest.mark.parametrize("index", range(3), ids=SPACE.names)
def test_compliance_meets_differences_of_the_solution_at_second_order(
    body, at_start, index
):
    W, error = at_start[1][:, :, index], []
    for h in (2e-2, 1e-2):
        dz = h * np.eye(3)[index]
        ahead, behind = (solved(SPACE.start() + s * dz, *body)[1] for s in (1.0, -1.0))
        error.append(np.max(np.abs((stacked(ahead) - stacked(behind)) / (2 * h) - W)))
    assert np.max(np.abs(W)) > 1e-6  # a parameter without effect would pass all else
    # Half the step leaves a quarter of the error, up to terms of fourth order.
    np.testing.assert_allclose(error[0] / error[1], 4.0, rtol=0.02)


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
    one, u = lane_of(lanes), jnp.asarray(at_start[0][0])
    H_p = parameter_forces(model, one, u, SPACE, SPACE.start())
    weight = 1000.0 * 0.1 * 0.02 * 0.02 * -9.81
    np.testing.assert_allclose(H_p[2].sum(axis=0), [0, 0, weight], atol=1e-12)


def test_derivative_check_finds_second_order(body, at_start):
    model, lanes = body
    one, u = lane_of(lanes), jnp.asarray(at_start[0][0])
    check = check_parameter_derivatives(model, one, u, SPACE, SPACE.start())
    # Over steps up to 0.1 the terms of fourth order still show in the third digit.
    np.testing.assert_allclose(check.orders, 2.0, atol=0.06)
    assert "order" in str(check)
    assert "nu" in str(check)


def test_derivative_check_of_a_linear_dependence_is_rounding(body, at_start):
    model, lanes = body
    one, u = lane_of(lanes), jnp.asarray(at_start[0][0])
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
