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
        Parameter("E", "E", 1e5, 1e4, 1e6),
        Parameter("nu", "nu", 0.3, 0.0, 0.45, scale="linear", S=1.0),
        Parameter("rho", "density", 1e3, 1e2, 1e4),
    )
)


@pytest.fixture(scope="module")
def body():
    """A soft beam that sags by a third of its length, and a marker on a post."""
    mesh = beam(0.1, 0.02, 0.02, (5, 2, 2))
    model = build_model(mesh, NeoHookean(1e5, 0.3), density=1000.0)
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


def _solved(z, model, lanes):
    changed = SPACE.model_at(model, z)

    def lane(c):
        solution = solve_equilibrium(changed, c, settings=TIGHT)
        return solution.displacement, marker_positions(changed, c, solution)

    return jax.vmap(lane)(lanes)


forward_and_reverse = both_ways(_solved)


def solved(z, model, lanes):
    """Displacements, and the markers there."""
    return ways(z, jnp.zeros(3), jnp.zeros((2, 2, 3)), model, lanes).value


def ways(z, dz, cotangent, model, lanes):
    """The same with derivatives of the markers."""
    still = jnp.zeros((2, model.n_points, 3))
    return forward_and_reverse(z, dz, (still, cotangent), model, lanes)


@jax.jit
def compliances(z, model, lanes, u):
    changed = SPACE.model_at(model, z)

    def lane(c, u):
        one = lambda method: parameter_compliance(
            changed, c, u, SPACE, z, method=method
        )
        return one("direct").W_ep, one("adjoint").W_ep

    return jax.vmap(lane)(lanes, u)


def stacked(positions):
    return np.asarray(positions).reshape(positions.shape[0], -1)


def test_direct_and_adjoint_sides_agree(body):
    model, lanes = body
    u, _ = solved(SPACE.start(), model, lanes)
    direct, adjoint = compliances(SPACE.start(), model, lanes, u)
    scale = float(jnp.max(jnp.abs(direct)))
    # The same numbers by transposed sums: the rounding of one solve between them.
    np.testing.assert_allclose(direct, adjoint, atol=1e-10 * scale, rtol=0)


@pytest.mark.parametrize("index", range(3), ids=SPACE.names)
def test_compliance_meets_differences_of_the_solution_at_second_order(body, index):
    model, lanes = body
    z = SPACE.start()
    u, _ = solved(z, model, lanes)
    W = np.asarray(compliances(z, model, lanes, u)[0])[:, :, index]
    error = []
    for h in (2e-2, 1e-2):
        dz = jnp.zeros(3).at[index].set(h)
        ahead, behind = (solved(z + s * dz, model, lanes)[1] for s in (1.0, -1.0))
        error.append(np.max(np.abs((stacked(ahead) - stacked(behind)) / (2 * h) - W)))
    assert np.max(np.abs(W)) > 1e-6  # a parameter without effect would pass all else
    # Half the step leaves a quarter of the error, up to terms of fourth order.
    np.testing.assert_allclose(error[0] / error[1], 4.0, rtol=0.02)


def test_compliance_is_the_implicit_derivative_of_the_solver(body):
    model, lanes = body
    z, dz = SPACE.start(), jnp.array([0.3, -0.2, 0.5])
    (u, _), (_, forward), _ = ways(z, dz, jnp.zeros((2, 2, 3)), model, lanes)
    W, _ = compliances(z, model, lanes, u)
    np.testing.assert_allclose(stacked(forward), W @ dz, rtol=1e-9, atol=1e-12)


def test_reverse_derivative_is_the_transpose_of_forward(body):
    model, lanes = body
    z, dz = SPACE.start(), jnp.array([0.3, -0.2, 0.5])
    cotangent = jax.random.normal(jax.random.key(0), (2, 2, 3))
    _, (_, forward), reverse = ways(z, dz, cotangent, model, lanes)
    np.testing.assert_allclose(
        jnp.vdot(cotangent, forward), jnp.vdot(reverse, dz), rtol=1e-9
    )


def test_force_of_a_denser_body_is_its_weight(body):
    model, lanes = body
    one = lane_of(lanes)
    u = solved(SPACE.start(), model, lanes)[0][0]
    H_p = parameter_forces(model, one, u, SPACE, SPACE.start())
    weight = 1000.0 * 0.1 * 0.02 * 0.02 * -9.81
    np.testing.assert_allclose(H_p[2].sum(axis=0), [0, 0, weight], atol=1e-12)


def test_derivative_check_finds_second_order(body):
    model, lanes = body
    one = lane_of(lanes)
    u = solved(SPACE.start(), model, lanes)[0][0]
    check = check_parameter_derivatives(model, one, u, SPACE, SPACE.start())
    # Over steps up to 0.1 the terms of fourth order still show in the third digit.
    np.testing.assert_allclose(check.orders, 2.0, atol=0.06)
    assert "order" in str(check)
    assert "nu" in str(check)


def test_derivative_check_of_a_linear_dependence_is_rounding(body):
    model, lanes = body
    one = lane_of(lanes)
    u = solved(SPACE.start(), model, lanes)[0][0]
    space = ParameterSpace((Parameter("E", "E", 1e5, 1e4, 1e6, scale="linear"),))
    check = check_parameter_derivatives(model, one, u, space, space.start())
    assert np.all(check.errors < 1e-9)
    assert np.isnan(check.orders).all()


def test_derivative_check_wants_falling_steps(body):
    model, lanes = body
    one = lane_of(lanes)
    u = jnp.zeros(model.mesh.points.shape)
    with pytest.raises(ValueError, match="at least two falling numbers"):
        check_parameter_derivatives(
            model, one, u, SPACE, SPACE.start(), steps=(1e-3, 1e-2)
        )
