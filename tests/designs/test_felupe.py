"""A designed body solved by FElupe: its goals are met there, too."""

from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

from benchmarks import _oracle
from softcal_jax.configurations import Configuration, Markers, SurfaceForce
from softcal_jax.designs import design, published_foam
from softcal_jax.equilibrium import build_model
from softcal_jax.fields import ControlPointParameters, ControlPoints, ParameterSpace
from softcal_jax.materials import Corotational, Fibre, ReducedTransverseIsotropic
from softcal_jax.mesh import TetMesh, beam

LENGTH, SIDE, NU = 0.1, 0.015, 0.3
TOLERANCE = 2e-4

pytestmark = pytest.mark.slow


def solved(mesh: TetMesh, law: Any, load: SurfaceForce):
    """Displacements by FElupe of a strip clamped at its root."""
    each = lambda value: np.broadcast_to(np.asarray(value, float), mesh.n_tets)
    E_t, E_l, phi = each(law.E_t), each(law.E_l), each(law.fibre.theta)
    constants = {
        "E_t": E_t,
        "E_l": E_l,
        "nu_t": each(NU),
        "nu_tl": NU * np.sqrt(E_t / E_l),  # Li and Barbic 2014
        "mu_l": 0.5 * np.sqrt(E_t * E_l) / (1.0 + NU),
        "phi": phi,
    }
    free = np.ones(mesh.points.shape, bool)
    free[np.isclose(mesh.points[:, 0], 0.0)] = False
    forces = np.asarray(load.nodal_forces(mesh))
    body = _oracle.Body(
        mesh.points, mesh.tets, "transverse", constants, False, free, forces
    )
    u = _oracle.equilibrium(_oracle.Assembly(body))
    assert u is not None
    return u


def test_felupe_meets_the_goals_of_a_design():
    """A strip that its weight at the tip shall bend so far down, and sideways."""
    mesh = beam(LENGTH, SIDE, SIDE, (6, 1, 1), order=2)
    fibre = Fibre(0.4, plane="xy")
    law = ReducedTransverseIsotropic(6e5, 3e5, NU, fibre)
    model = build_model(mesh, Corotational(law), density=1000.0)
    points = ControlPoints({"root": (0.0, 0.0, 0.0), "tip": (LENGTH, 0.0, 0.0)})
    moduli: dict[str, Any] = {"interpolation": "log", "unit": "Pa"}
    space = ParameterSpace(
        [
            ControlPointParameters("E_t", points, 6e5, 1e5, 5e6, **moduli),
            ControlPointParameters("E_l", points, 3e5, 5e4, 3e6, **moduli),
            ControlPointParameters(
                "theta",
                points,
                0.4,
                -np.pi / 2,
                np.pi / 2,
                interpolation="director",
                scale="linear",
                unit="rad",
            ),
        ]
    )
    # What another field does, solved by FElupe alone, is the goal.
    true = jnp.asarray([7e5, 4e5, 2.5e5, 2e5, 0.9, 0.3])
    load = SurfaceForce("x_max", (0.0, 0.0, -0.05))
    wanted: Any = space.model_at(model, space.to_scaled(true)).law
    nodes = [
        np.argmin(np.linalg.norm(mesh.points - p, axis=1))
        for p in ((0.5 * LENGTH, 0.0, 0.0), (LENGTH, 0.0, 0.0), (LENGTH, SIDE, 0.0))
    ]
    places = mesh.points[nodes]
    goals = places + solved(mesh, wanted.elasticity, load)[nodes]
    goal = Configuration(
        "weight",
        "x_min",
        gravity=(0.0, 0.0, 0.0),
        loads=[load],
        markers=Markers(("half", "tip", "edge"), places, TOLERANCE),
        measured=goals,
    )
    made = design(model, space, goal, foam=published_foam(), starts=1)
    assert made.met
    found: Any = made.fit.model.law
    reached = places + solved(mesh, found.elasticity, load)[nodes]
    assert np.abs(goals - places).max() > 50.0 * TOLERANCE
    assert np.abs(reached - goals).max() < TOLERANCE
    for shown, there in zip(made.goals, reached, strict=True):
        np.testing.assert_allclose(shown.reached, there, atol=1e-8)
