"""The shape of a body as an unknown: fitted, considered, and designed.

Data come from meshes that are made with the other thickness.
"""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from problems import both_ways

from softcal_jax.calibration import calibrate
from softcal_jax.configurations import (
    Configuration,
    Markers,
    NodalForces,
    Support,
    SurfaceForce,
)
from softcal_jax.designs import design
from softcal_jax.equilibrium import (
    NewtonSettings,
    build_model,
    effector_values,
    lanes,
    solve_equilibrium,
)
from softcal_jax.fields import (
    ControlPointParameters,
    ControlPoints,
    Parameter,
    ParameterSpace,
    Uncertain,
    check_parameters,
    exactly_known,
    shape_offset,
)
from softcal_jax.identifiability import identify
from softcal_jax.materials import (
    ClassicalCorotational,
    Corotational,
    Isotropic,
    SofaCorotational,
)
from softcal_jax.mesh import beam, straightened, surface_motion
from softcal_jax.robots import simulated_measurements
from softcal_jax.sensitivity import parameter_compliance

L, B, H = 0.1, 0.02, 0.004
THICKER = 0.5e-3
E, NU, DENSITY = 1e6, 0.3, 1000.0
KNOWN = {"prior_std": None}


def plate(height=H, nu=NU, cells=(8, 1, 1), modulus=E, **shapes):
    mesh = beam(L, B, height, cells, order=2)
    law = Corotational(Isotropic(modulus, nu))
    shapes = {name: surface_motion(mesh, *where) for name, where in shapes.items()}
    return build_model(mesh, law, density=DENSITY, shapes=shapes)


MODEL = plate(wall=("z_max",), slanted=("y_max", (0.3, 1.0, 0.0)))
# On the lower face, which stays.
MARKERS = Markers(["half", "tip"], [(L / 2, B / 2, 0.0), (L, B / 2, 0.0)], std=5e-5)
WALL = shape_offset("wall", limit=1.5e-3, **KNOWN)


def pose(name, force=0.0, weight=0.0, model=MODEL, **more):
    nodes = model.mesh.nodes("x_max")
    forces = np.outer(np.full(len(nodes), force / len(nodes)), (0.0, 0.0, -1.0))
    return Configuration(
        name,
        "x_min",
        (0.0, 0.0, -weight),
        loads=NodalForces(nodes, forces) if force else (),
        markers=MARKERS,
        **more,
    )


def test_a_model_with_an_offset_is_that_of_the_other_thickness():
    space = ParameterSpace([WALL])
    moved = space.model_at(MODEL, space.to_scaled([jnp.asarray(THICKER)]))
    built = plate(H + THICKER)
    for of in (lambda m: m.mesh.points, lambda m: m.weights, lambda m: m.mass):
        np.testing.assert_allclose(of(moved), of(built), rtol=1e-10, atol=1e-14)
    again = space.model_at(moved, space.to_scaled([jnp.asarray(THICKER)]))
    np.testing.assert_array_equal(again.mesh.points, moved.mesh.points)
    assert float(again.shapes.offset[0]) == THICKER


FIELD = ControlPointParameters(
    "E",
    ControlPoints({"root": (0.0, 0.0, 0.0), "tip": (L, B, H)}),
    start=[1e6, 1.3e6],
    lower=1e5,
    upper=1e7,
)
# The order of entries does not count: weights of the field are of the shape.
SPACE = ParameterSpace([FIELD, WALL, shape_offset("slanted", limit=2e-3, **KNOWN)])


@pytest.mark.slow
def test_derivatives_meet_differences_and_forward_equals_reverse():
    lane = lanes(MODEL, pose("hang", 0.002, 9.81))[0]

    @jax.jit
    def values(z):
        model, here = SPACE.apply(MODEL, lane, z)
        settings = NewtonSettings(rtol=1e-12)
        u = solve_equilibrium(model, here, settings=settings).displacement
        return effector_values(model, here, u).ravel(), u

    z = SPACE.start().at[2:].set(jnp.asarray([0.3, -0.4]))
    at = MODEL, lane, values(z)[1], SPACE, z
    W = np.asarray(parameter_compliance(*at, method="direct").W_ep)
    errors = []
    for h in (0.1, 0.03):
        columns = [
            (values(z + h * d)[0] - values(z - h * d)[0]) / (2.0 * h) for d in np.eye(4)
        ]
        errors.append(np.abs(np.stack(columns, axis=1) - W).max(axis=0))
    # Second order: 0.3 of the step leaves 0.09 of the error.
    np.testing.assert_allclose(errors[1] / errors[0], 0.09, rtol=0.1)

    size = np.abs(W).max(axis=0)
    adjoint = np.asarray(parameter_compliance(*at, method="adjoint").W_ep)
    np.testing.assert_allclose(adjoint / size, W / size, rtol=0, atol=1e-9)
    random = np.random.default_rng(0)
    tangent, cotangent = (jnp.asarray(random.normal(size=n)) for n in W.T.shape)
    _, e_dot, pulled = both_ways(lambda z: values(z)[0])(z, tangent, cotangent)
    np.testing.assert_allclose(e_dot, W @ tangent, rtol=1e-8, atol=1e-12)
    np.testing.assert_allclose(
        jnp.vdot(pulled, tangent), jnp.vdot(cotangent, e_dot), rtol=1e-10
    )


def modulus_and_wall():
    return ParameterSpace([Parameter("E", "E", 0.7 * E, 1e5, 1e7, unit="Pa"), WALL])


def test_modulus_and_thickness_of_a_hanging_plate():
    """Weight bends it by E h^2, a force by E h^3."""
    poses = [pose("hang", weight=9.81), pose("load", 0.004, 9.81)]
    data = simulated_measurements(plate(H + THICKER), poses, noise=True, seed=2)
    space = modulus_and_wall()
    fit = calibrate(MODEL, space, data, noise="stated", uncertain=exactly_known())
    modulus, wall = fit.parameters
    assert wall.unit == "m"
    for found, true, most in ((modulus, E, 0.05 * E), (wall, THICKER, 1e-4)):
        assert abs(found.value - true) < 3.0 * found.standard_error < 3.0 * most


def test_a_force_alone_is_blind_for_one_of_them():
    seen = identify(MODEL, modulus_and_wall(), [pose("load", 0.0005)])
    assert seen.verdict == "not identifiable"
    assert "E up while offset of wall down (blind)" in str(seen)


def test_a_wall_that_is_not_fitted_counts_by_its_usual_error():
    """A force bends it by E h^3: E is off by three times what h is."""
    modulus = modulus_and_wall().entries[0]
    seen = identify(MODEL, modulus, [pose("load", 0.0005)])
    assert seen.budget is not None
    (of_shapes,) = seen.budget.by_cause()["shapes"]
    assert of_shapes / seen.budget.values[0] == pytest.approx(3 * 0.2e-3 / H, rel=0.03)
    sure = Uncertain(shapes=0.0)
    alone = identify(MODEL, modulus, [pose("load", 0.0005)], uncertain=sure)
    assert alone.budget is not None
    assert "shapes" not in alone.budget.by_cause()


def test_a_thickness_is_designed_for_a_deflection():
    """Euler-Bernoulli, w = F L^3 / (3 E I) with I = b h^3 / 12.

    Shear adds 0.6 (h / L)^2 = 0.13 % to w for nu = 0, so 0.04 % to h.
    """
    down, height = 1e-3, H + 0.6e-3
    force = E * B * height**3 * down / (4.0 * L**3)
    model = plate(nu=0.0, cells=(16, 1, 1), wall=("z_max",))
    tip = Markers(["tip"], [(L, B / 2, 0.0)], std=1e-6, axes="z")
    goal = replace(pose("goal", force, model=model), markers=tip)
    goal = replace(goal, measured=[[L, B / 2, -down]])
    made = design(model, WALL, goal)
    assert made.met
    assert H + made.fit.value("offset of wall") == pytest.approx(height, rel=2e-3)


SPREAD = {"loads": SurfaceForce("z_max", (0.0, 0.0, -0.01))}
ELASTIC = {"supports": Support("x_min", stiffness=1e9)}


@pytest.mark.parametrize("more", [SPREAD, ELASTIC])
def test_what_is_shared_out_by_area_is_refused(more):
    bent = replace(pose("bent"), **more)
    with pytest.raises(ValueError, match=r"\(wall, slanted\), .*do not follow"):
        identify(MODEL, WALL, [bent])
    measured = replace(bent, measured=MARKERS.positions)
    with pytest.raises(ValueError, match=r"\(wall, slanted\), .*do not follow"):
        calibrate(MODEL, modulus_and_wall().entries[0], measured)
    at = ParameterSpace([WALL]), jnp.zeros(1)
    rest = jnp.zeros((MODEL.n_points, 3))
    with pytest.raises(RuntimeError, match=r"do not follow points that are traced"):
        parameter_compliance(MODEL, bent, rest, *at)


def test_bad_offsets():
    one = lambda name, limit: ParameterSpace([shape_offset(name, limit=limit, **KNOWN)])
    with pytest.raises(ValueError, match=r"shape .*'Wall'.* mean 'wall'"):
        check_parameters(MODEL, one("Wall", 1e-3))
    with pytest.raises(ValueError, match=r"lower bound: .*'wall' by -0.005 m.*inside"):
        check_parameters(MODEL, one("wall", 5e-3))
    bare = plate().mesh
    law = Corotational(Isotropic(E, NU))
    for motion, message in (
        (np.zeros((2, 3)), r"\(2, 3\)"),
        (0.0 * bare.points, "not zero"),
    ):
        with pytest.raises(ValueError, match=f"shape 'wall' .*{message}"):
            build_model(bare, law, density=1.0, shapes={"wall": motion}, solver="none")


def test_a_law_that_holds_edges_of_the_mesh_has_no_shape():
    mesh = beam(L, B, H, (8, 1, 1), order=1)
    law = SofaCorotational.of_mesh(mesh, Isotropic(E, NU), "edge")
    shapes = {"wall": surface_motion(mesh, "z_max")}
    model = build_model(mesh, law, density=DENSITY, shapes=shapes, solver="none")
    with pytest.raises(ValueError, match="edges of its mesh"):
        check_parameters(model, ParameterSpace([WALL]))


def test_a_shape_that_is_inside_out_has_no_equilibrium():
    """Even if nothing depends on that corner, and no eigenvalue would tell."""
    mesh = MODEL.mesh
    corner = np.zeros_like(mesh.points)
    corner[np.argmax(mesh.points.sum(axis=1)), 2] = 1.0
    shapes = {"corner": straightened(mesh, corner)}
    law = ClassicalCorotational(Isotropic(E, NU))
    model = build_model(mesh, law, density=DENSITY, shapes=shapes)
    lane = lanes(model, pose("hang", weight=9.81))[0]
    space = ParameterSpace([shape_offset("corner", limit=1.5 * H, **KNOWN)])
    solved = jax.jit(lambda z: solve_equilibrium(*space.apply(model, lane, z)))
    assert bool(solved(jnp.zeros(1)).converged)
    assert not solved(-jnp.ones(1)).converged
