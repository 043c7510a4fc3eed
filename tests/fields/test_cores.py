"""Where the axes of control points cancel, the contrast of the moduli fades."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from softcal_jax.equilibrium import build_model
from softcal_jax.fields import ControlPointParameters, ControlPoints, ParameterSpace
from softcal_jax.materials import Corotational, Fibre, ReducedTransverseIsotropic
from softcal_jax.mesh import beam

CORE = 0.2
MESH = beam(1.0, 0.5, 0.5, (3, 1, 1)).with_tet_group("one", [4])
CENTROIDS = MESH.points[MESH.tets].mean(axis=1)
POINTS = ControlPoints(
    {"a": (0.0, 0.25, 0.2), "b": (1.0, 0.2, 0.25), "c": (0.4, 0.5, 0.0)}
)
# The centroid of the tet "one" lies half way between these two.
MIDDLE = ControlPoints(CENTROIDS[4] + np.array([[0.3, 0.0, 0.1], [-0.3, 0.0, -0.1]]))


@pytest.fixture(scope="module")
def model():
    n = np.ones(MESH.n_tets)
    fibre = Fibre(0.0 * n, plane="xy")
    law = ReducedTransverseIsotropic(800.0 * n, 400.0 * n, 0.3, fibre)
    return build_model(MESH, Corotational(law), density=1000.0)


def entries(points=POINTS, *, core=CORE, of_angle=(), **options):
    half = np.pi / 2
    moduli = [
        ControlPointParameters(
            field, points, start=500.0, lower=100.0, upper=1e4, **options
        )
        for field in ("E_t", "E_l")
    ]
    turned = {"scale": "linear", "S": 1.0, "interpolation": "director", "core": core}
    options |= turned | dict(of_angle)
    theta = ControlPointParameters(
        "theta", points, start=0.0, lower=-half, upper=half, **options
    )
    return (*moduli, theta)


def space(points=POINTS, **options):
    return ParameterSpace(entries(points, **options), axes=[("E_l", "E_t", "theta")])


def scaled(space, E_t, E_l, degrees):
    n = len(space.names) // 3
    columns = (E_t, E_l, np.deg2rad(degrees))
    p = np.concatenate([np.broadcast_to(column, n) for column in columns])
    return space.to_scaled(jnp.asarray(p, float))


def fields(model, space, z):
    """E_t, E_l and theta of each tet."""
    law = space.model_at(model, z).law.elasticity
    return jnp.stack([law.E_t, law.E_l, law.fibre.theta])


def test_contrast_by_hand(model):
    """Moduli and rho from inverse squares of distances, in ordinary NumPy."""
    faded = space()
    E_t, E_l, degrees = [900.0, 700.0, 1200.0], [300.0, 350.0, 200.0], [70, -10, -40]
    values = fields(model, faded, scaled(faded, E_t, E_l, degrees))
    places = np.asarray(POINTS.positions)
    w = 1.0 / np.sum((CENTROIDS[:, None] - places[None]) ** 2, axis=2)
    w /= w.sum(axis=1, keepdims=True)
    mixed = w @ np.exp(2j * np.deg2rad(degrees))
    rho = np.abs(mixed)
    assert rho.min() < 0.6
    assert rho.max() > 0.9
    left = rho * np.sqrt((1.0 + CORE**2) / (rho**2 + CORE**2))
    high, low = w @ E_t, w @ E_l
    np.testing.assert_allclose(values[0] * values[1], high * low, rtol=1e-12)
    contrast = np.log(values[0] / values[1])
    np.testing.assert_allclose(contrast, left * np.log(high / low), rtol=1e-11)
    np.testing.assert_allclose(values[2], 0.5 * np.angle(mixed), rtol=1e-11)


def test_axes_that_agree_have_their_full_contrast(model):
    faded = space()
    values = fields(model, faded, scaled(faded, 900.0, 300.0, 25.0))
    expected = np.array([[900.0], [300.0], [np.deg2rad(25.0)]])
    np.testing.assert_allclose(values, np.broadcast_to(expected, values.shape))


def test_without_a_core_the_contrast_is_full(model):
    full = space(core=0.0)
    values = fields(model, full, scaled(full, 900.0, 300.0, [70.0, -10.0, -40.0]))
    np.testing.assert_allclose(values[0] / values[1], 3.0, rtol=1e-12)


def test_half_way_between_right_angles_it_is_isotropic(model):
    """And a tensor with a small step about it: the angle turns, the stress does not."""
    faded = space(MIDDLE, region="one")
    z = scaled(faded, 900.0, 300.0, [0.0, 90.0])
    at = jax.jit(lambda z: fields(model, faded, z)[:, 4])
    E_t, E_l, _ = at(z)
    np.testing.assert_allclose([E_t, E_l], np.sqrt(900.0 * 300.0), rtol=1e-8)
    assert np.isfinite(jax.jit(jax.jacfwd(at))(z)).all()

    def tensor(z):
        E_t, E_l, theta = np.asarray(at(z))
        half = 0.5 * np.log(E_t / E_l)
        return np.stack([half * np.cos(2 * theta), half * np.sin(2 * theta)])

    # Either side of the defect: the slope of the tensor is the same, to first order.
    h = 1e-5
    steps = h * np.asarray([[0, 0, 0, 0, 1.0, 0], [0, 0, 0, 0, 1.0, 1.0]])
    for step in steps:
        ahead, behind = tensor(z + step), tensor(z - step)
        np.testing.assert_allclose(ahead, -behind, rtol=1e-3, atol=10.0 * h**2)
        assert np.linalg.norm(ahead) < 10.0 * h * np.log(3.0) / CORE


def test_derivatives_meet_differences_at_second_order(model):
    """Forward and reverse."""
    faded = space()
    z = scaled(faded, [900.0, 700.0, 1200.0], [300.0, 350.0, 200.0], [70, -10, -40])
    z += 1e-2

    @jax.jit
    def size(z):
        law = faded.model_at(model, z).law.elasticity
        return jnp.sum(jnp.sin(law.E_t / 300.0)) + jnp.sum(jnp.cos(law.E_l / 100.0))

    slope = np.asarray(jax.jit(jax.grad(size))(z))
    forward = jax.jit(jax.jacfwd(size))(z)
    np.testing.assert_allclose(forward, slope, rtol=1e-10, atol=1e-12)
    errors = []
    for h in (1e-2, 5e-3):
        differences = [
            float(size(z + h * e) - size(z - h * e)) / (2.0 * h) for e in np.eye(len(z))
        ]
        errors.append(np.linalg.norm(np.stack(differences) - slope))
    assert 3.8 < errors[0] / errors[1] < 4.2


def test_plain_steps_and_numbers_keep_the_fields(model):
    faded = space()
    z = scaled(faded, 900.0, 300.0, [70.0, -10.0, -40.0])
    expected = fields(model, faded, z)
    plain = faded.in_plain_steps()
    assert plain.chart is None
    assert len(plain.order_names()) == 3
    np.testing.assert_array_equal(fields(model, plain, z), expected)
    np.testing.assert_array_equal(fields(model, faded.numbered, z), expected)
    assert plain.numbered.chart is None


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"core": 1.0}, r"core of theta is 1, .*\[0, 1\)"),
        ({"core": -0.1}, r"core of theta is -0\.1, .*\[0, 1\)"),
        ({"of_angle": {"interpolation": "linear"}}, "theta .*director.*'linear'"),
        ({"of_angle": {"region": "one"}}, "theta .*E_l .* region='one'"),
    ],
)
def test_bad_core(options, message):
    with pytest.raises(ValueError, match=message):
        space(**options)


def test_a_core_needs_an_axis():
    with pytest.raises(ValueError, match=r"theta .*core.* in axes, "):
        ParameterSpace(entries())
