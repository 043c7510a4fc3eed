"""Sensitivities to the values at control points, mixed in every way."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from problems import lane_of

from softcal_jax.configurations import Configuration, Markers, configuration_arrays
from softcal_jax.equilibrium import (
    NewtonSettings,
    build_model,
    marker_positions,
    solve_equilibrium,
)
from softcal_jax.fields import ControlPointParameters, ControlPoints, ParameterSpace
from softcal_jax.materials import Corotational, Fibre, TransverseIsotropic
from softcal_jax.mesh import beam
from softcal_jax.sensitivity import (
    parameter_compliance,
)

# Equilibria to rounding, so that differences show their own error.
TIGHT = NewtonSettings(rtol=1e-12)
SIZE = (0.06, 0.02, 0.02)
ENDS = ControlPoints({"root": (0.0, 0.01, 0.01), "tip": (0.06, 0.01, 0.01)})
STARTS = {
    # Field: values at the two control points, bounds, scale.
    "E_t": ((9e4, 6e4), 1e4, 1e6, "log"),
    "E_l": ((3e4, 2e4), 1e4, 1e6, "log"),
    "mu_l": ((2e4, 1e4), 1e3, 1e6, "log"),
    "nu_tl": ((0.2, 0.3), 0.0, 0.45, "linear"),
    "theta": ((0.35, -0.9), -np.pi / 2, np.pi / 2, "linear"),
    "phi": ((0.2, -0.4), -np.pi / 2, np.pi / 2, "linear"),
}
NAMES = [f"{field} of {end}" for field in STARTS for end in ("root", "tip")]


MIXING = {"theta": "director", "mu_l": "log"}  # the others, phi with them: linear


@pytest.fixture(scope="module")
def space():
    """Six fields of the full set with two values each; S = 1 for ratio and angle."""
    return ParameterSpace(
        tuple(
            ControlPointParameters(
                field,
                ENDS,
                start=np.array(values),
                lower=lower,
                upper=upper,
                scale=scale,
                S=1.0 if scale == "linear" else None,
                interpolation=MIXING.get(field, "linear"),
            )
            for field, (values, lower, upper, scale) in STARTS.items()
        )
    )


@pytest.fixture(scope="module")
def body():
    """A soft anisotropic beam that sags visibly, and a marker on its free end."""
    mesh = beam(*SIZE, (2, 1, 1), order=2)
    fibre = Fibre(0.0, plane="xy")
    law = Corotational(TransverseIsotropic(6e4, 3e4, 0.3, 0.2, 2e4, fibre))
    model = build_model(mesh, law, density=1000.0)
    markers = Markers(("tip", "side"), [[0.06, 0.01, 0.01], [0.04, 0.02, 0.005]])
    configuration = Configuration(
        "down", "x_min", (0.0, -9.81, 4.0), markers=markers, measured=markers.positions
    )
    lanes = configuration_arrays(mesh, [configuration])
    return model, lane_of(lanes)


model_at = eqx.filter_jit(ParameterSpace.model_at)
markers_at = eqx.filter_jit(marker_positions)


def solved(z, space, model, lane):
    """Displacements, and the markers there."""
    changed = model_at(space, model, jnp.asarray(z))
    solution = solve_equilibrium(changed, lane, settings=TIGHT)
    markers = np.asarray(markers_at(changed, lane, solution))
    return solution.displacement, markers.ravel()


@pytest.fixture(scope="module")
def at_start(body, space):
    model, lane = body
    z = space.start()
    u = solved(z, space, model, lane)[0]
    return z, u, np.asarray(parameter_compliance(model, lane, u, space, z).W_ep)


def test_names(space):
    assert space.names == NAMES


def test_marker_positions_meet_differences_of_the_equilibrium(body, space, at_start):
    """W_ep against the solver itself, column by column, at second order."""
    model, lane = body
    z, _, W = map(np.asarray, at_start)
    error = []
    for h in (2e-2, 1e-2):
        moves = h * np.eye(len(NAMES))
        around = np.concatenate([z + moves, z - moves])
        x = np.stack([solved(near, space, model, lane)[1] for near in around])
        difference = (x[: len(NAMES)] - x[len(NAMES) :]) / (2.0 * h)
        error.append(np.linalg.norm(difference - W.T, axis=1))
    size = np.linalg.norm(W, axis=0)
    assert np.all(error[1] < 1e-3 * size)
    assert np.all(error[1] > 1e-9 * size)  # above the rounding of the solves
    np.testing.assert_allclose(error[0] / error[1], 4.0, rtol=0.02)
