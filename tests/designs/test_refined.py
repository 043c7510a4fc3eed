"""A design on the mesh refined once: goals shift by what the error of its mesh says.

Quadratic tets of half the size have a quarter of the error. So tets of twice the size
differ from those of the design by three times the error of the latter (Richardson),
and on tets of half the size three quarters of it are gone.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Float

from softcal_jax.actuators import Cable
from softcal_jax.configurations import Configuration, ImposedForce, Markers
from softcal_jax.control import Limits
from softcal_jax.designs import DesignResult, design, published_foam
from softcal_jax.equilibrium import Model, build_model
from softcal_jax.fields import ControlPointParameters, ControlPoints, ParameterSpace
from softcal_jax.materials import Corotational, Fibre, ReducedTransverseIsotropic
from softcal_jax.mesh import beam
from softcal_jax.robots import simulated_measurements

LENGTH, SIDE = 0.12, 0.015
MIDDLE = SIDE / 2
PLACES = np.array([(x, MIDDLE, MIDDLE) for x in (LENGTH / 2, LENGTH)])
TOLERANCE = 2e-4
ORDER = 2
"""Of the error of a reading by quadratic tets: half the cells, a quarter of it."""

ROOM = 1.5
"""Factor for what is not of this order yet, with one cell across: found up to 1.32."""

Heights = Float[np.ndarray, "n_configurations n_markers"]

pytestmark = pytest.mark.slow


class Seen(NamedTuple):
    """A design, and the heights of its markers in each configuration [m]."""

    made: DesignResult
    goals: Heights
    own: Heights
    fine: Heights
    error: Heights


def finger(across: int) -> Model:
    """A beam under one cable, with as many cells across."""
    mesh = beam(LENGTH, SIDE, SIDE, (4 * across, across, across), order=2)
    law = ReducedTransverseIsotropic(6e5, 4e5, 0.3, Fibre(0.0, plane="xy"))
    guides = [(x, MIDDLE, 0.001) for x in (0.0, LENGTH / 2, LENGTH)]
    cable = Cable("cable", guides)
    return build_model(mesh, Corotational(law), density=1000.0, actuators=[cable])


def fields() -> ParameterSpace:
    """E_t, E_l and theta at both ends."""
    ends = {"root": (0.0, MIDDLE, MIDDLE), "tip": (LENGTH, MIDDLE, MIDDLE)}
    points = ControlPoints(ends)
    moduli: dict[str, Any] = {"interpolation": "log", "unit": "Pa"}
    angle: dict[str, Any] = {"interpolation": "director", "scale": "linear", "S": 1.0}
    quarter = np.pi / 2
    return ParameterSpace(
        [
            ControlPointParameters("E_t", points, 6e5, 1e5, 5e6, **moduli),
            ControlPointParameters("E_l", points, 4e5, 5e4, 3e6, **moduli),
            ControlPointParameters(
                "theta", points, 0.5, -quarter, quarter, unit="rad", core=0.1, **angle
            ),
        ],
        axes=[("E_l", "E_t", "theta")],
    )


def curve(name: str, bend: float) -> Configuration:
    """A curve that turns by `bend` in all, linearly more along it, as heights."""
    s = np.linspace(0.0, LENGTH, 1001)
    slopes = np.sin(bend * (s / LENGTH) ** 2)
    fall = np.concatenate([[0.0], np.cumsum(slopes[:-1] * np.diff(s))])
    down = np.interp(PLACES[:, 0], s, fall)
    return Configuration(
        name,
        "x_min",
        gravity=(0.0, 0.0, 0.0),
        markers=Markers(("half", "tip"), PLACES, TOLERANCE, axes="z"),
        measured=PLACES - np.outer(down, [0.0, 0.0, 1.0]),
        actuation={"cable": ImposedForce(0.5)},
    )


def reached(made: DesignResult, across: int, z: Any = None) -> np.ndarray:
    """Heights of the markers on a mesh, with the fields and tensions of a design."""
    z = jnp.asarray(made.fit.z if z is None else z)
    model = made.fit.space.model_at(finger(across), z)
    simulated = simulated_measurements(model, made.configurations)
    return np.array([np.asarray(pose.measured)[:, 2] for pose in simulated])


@pytest.fixture(scope="module")
def seen() -> Seen:
    """A finger that takes a curve, little and much, designed with two cells across."""
    goals = [curve("little", 0.2), curve("much", 0.4)]
    limits = {"cable": Limits(force=(0.0, 10.0))}
    made = design(
        finger(2), fields(), goals, limits=limits, foam=published_foam(), starts=1
    )
    assert made.met
    wanted = np.array([np.asarray(goal.measured)[:, 2] for goal in goals])
    coarse, own, fine = (reached(made, across) for across in (1, 2, 4))
    return Seen(made, wanted, own, fine, error=(own - coarse) / (2.0**ORDER - 1.0))


def explained(seen: Seen, fine: np.ndarray) -> bool:
    """Whether goals shift by three quarters of the error, to within a factor."""
    share = (fine - seen.own) / seen.error
    expected = 1.0 - 0.5**ORDER
    return bool(np.all((share > expected / ROOM) & (share < expected * ROOM)))


def test_goals_shift_by_the_error_of_the_mesh(seen):
    """But for the quarter of it that halved cells still have."""
    assert explained(seen, seen.fine)


def test_goals_are_met_to_what_the_error_of_the_mesh_says(seen):
    """And not without it: the mesh moves a tip by more than its tolerance."""
    off = np.abs(seen.fine - seen.goals)
    assert np.all(off <= TOLERANCE + np.abs(seen.error))
    assert off.max() > TOLERANCE


@pytest.mark.parametrize(
    ("field", "change"), [("theta", 0.1), ("theta", -0.1), ("E_l", 0.1), ("E_t", -0.1)]
)
def test_the_error_of_the_mesh_does_not_explain_other_fields(seen, field, change):
    """A tenth of a modulus, or six degrees."""
    of_field = [name.startswith(field) for name in seen.made.fit.space.names]
    z = np.asarray(seen.made.fit.z) + change * np.array(of_field)
    assert not explained(seen, reached(seen.made, 4, z))
