"""Sensitivities per tet against differences of whole equilibria."""

import equinox as eqx
import numpy as np
import pytest
from bars import MID, STD, TIP, bar, pose, stretched
from problems import lane_of

from softcal_jax.configurations import Configuration, configuration_arrays
from softcal_jax.equilibrium import (
    NewtonSettings,
    build_model,
    marker_positions,
    solve_equilibrium,
)
from softcal_jax.fields import Parameter, ParameterSpace, set_field
from softcal_jax.layouts import tet_sensitivities
from softcal_jax.materials import (
    ClassicalCorotational,
    Fibre,
    ReducedTransverseIsotropic,
)
from softcal_jax.sensitivity import parameter_compliance

# Equilibria to rounding, so that differences show their own error.
TIGHT = NewtonSettings(rtol=1e-12)
POSES = (pose("bent", (MID, TIP)), stretched(MID, TIP))
SIZES = {"E": 1e5, "density": 1e3}
FIELDS = tuple(SIZES)
"""Asked for together, so that one program serves all tests of this law."""


def with_each(field="E", values: float | np.ndarray = 1e5):
    """The bar with a value of its own in every tet, of both fields."""
    model = set_field(bar((2, 1, 1)), "density", np.full(12, 1e3))
    return set_field(model, field, np.broadcast_to(values, 12).copy())


@pytest.fixture(scope="module")
def sensitivities():
    return tet_sensitivities(with_each(), POSES, FIELDS, newton=TIGHT)


markers_at = eqx.filter_jit(marker_positions)


def moved(field, tet, step, c):
    """All coordinates with the field of one tet raised, in units of the noise."""
    values = np.full(12, SIZES[field])
    values[tet] += step
    model = with_each(field, values)
    arrays = lane_of(configuration_arrays(model.mesh, [c]))
    solution = solve_equilibrium(model, arrays, settings=TIGHT)
    return np.asarray(markers_at(model, arrays, solution)).ravel() / STD


@pytest.mark.parametrize(("field", "size"), SIZES.items())
@pytest.mark.parametrize("tet", [0, 7])
def test_against_central_differences(sensitivities, field, size, tet):
    exact = sensitivities[field][:6, tet]
    errors = []
    for step in (2e-2 * size, 1e-2 * size):
        ends = [moved(field, tet, sign * step, POSES[0]) for sign in (1.0, -1.0)]
        difference = (ends[0] - ends[1]) / (2.0 * step)
        errors.append(np.abs(difference - exact).max())
    assert errors[1] < 1e-3 * np.abs(exact).max()
    # Second order: half the step leaves a quarter of the error.
    np.testing.assert_allclose(errors[0] / errors[1], 4.0, rtol=0.05)


def test_rows_follow_configuration_and_marker(sensitivities):
    """The weight does not matter where there is none; a stiffer tet stretches less."""
    assert sensitivities["E"].shape == (12, 12)
    np.testing.assert_array_equal(sensitivities["density"][6:], 0.0)
    mid, tip = sensitivities["E"][6], sensitivities["E"][9]
    assert np.all(mid[:6] < 0.0)
    assert tip.sum() < mid.sum() < 0.0


def test_only_measured_axes_have_rows(sensitivities):
    bent, other = POSES
    upright = eqx.tree_at(lambda c: c.markers.axes, bent, "z")
    measured = tet_sensitivities(with_each(), (upright, other), FIELDS, newton=TIGHT)
    rows = [2, 5, *range(6, 12)]
    np.testing.assert_allclose(measured["E"], sensitivities["E"][rows], rtol=1e-9)


@pytest.mark.slow
def test_all_tets_together_without_a_potential():
    """Rows add up to the direct side, whose tangent is not transposed."""
    reduced = ReducedTransverseIsotropic(1e5, 4e4, 0.3, Fibre(0.5))
    law = ClassicalCorotational(reduced)
    model = build_model(bar((2, 1, 1)).mesh, law, density=1000.0)
    side = pose("side", (MID, TIP), force=(0.0, 0.03, 0.0))
    rows = tet_sensitivities(model, side, "E_t", newton=TIGHT)["E_t"]
    E_t = Parameter("E_t", "E_t", 1e5, 1e4, 1e6, scale="linear", S=1.0)
    space = ParameterSpace((E_t,))

    @eqx.filter_jit
    def direct(lane):
        u = solve_equilibrium(model, lane, settings=TIGHT).displacement
        z = space.start()
        return parameter_compliance(model, lane, u, space, z, method="direct").W_ep

    batch = configuration_arrays(model.mesh, [side])
    whole = np.asarray(direct(lane_of(batch)))[:, 0] / STD
    # Rounding of one solve; with the tangent itself it is 0.2 % off.
    np.testing.assert_allclose(
        rows.sum(axis=1), whole, rtol=0, atol=1e-9 * np.max(np.abs(whole))
    )


def test_a_pose_without_markers_is_named():
    bare = Configuration("bare", "x_min")
    with pytest.raises(ValueError, match="'bare' has no markers"):
        tet_sensitivities(bar((2, 1, 1)), (POSES[0], bare), "E")


def test_a_pose_without_equilibrium_is_named():
    crushed = pose("crushed", (MID, TIP), force=(-1e4, 0.0, 0.0))
    with pytest.raises(RuntimeError, match="'crushed'"):
        tet_sensitivities(with_each(), (POSES[0], crushed), FIELDS, newton=TIGHT)
