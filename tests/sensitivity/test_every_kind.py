"""Every kind of parameter, by the one function that makes sensitivities of it.

The reference is the equilibrium to rounding at other values: differences of it, whose
error falls at second order. A kind that `KINDS` has and this file does not fails.
"""

from functools import cache

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from problems import lane_of

from softcal_jax.actuators import Cable, Guide, Motor
from softcal_jax.bodies import Pose, RigidBody, hinge_axes
from softcal_jax.configurations import (
    ActuatorForce,
    BodyFrame,
    Configuration,
    ContactForce,
    ContactMoment,
    ImposedDisplacement,
    ImposedForce,
    Markers,
    PointForce,
    Support,
    SupportReaction,
    SurfaceForce,
    configuration_arrays,
)
from softcal_jax.contact import HalfSpace
from softcal_jax.equilibrium import (
    NewtonSettings,
    build_model,
    effector_values,
    solve_equilibrium,
)
from softcal_jax.fields import (
    KINDS,
    AbstractEntry,
    Parameter,
    ParameterSpace,
    SetupParameter,
    actuator_factor,
    check_parameters,
    check_scopes,
    clamp_stiffness,
    command,
    friction,
    gravity_tilt,
    load_factor,
    load_offset,
    marker_offset,
    motor_zero,
    mounting,
    recording_offset,
)
from softcal_jax.materials import NeoHookean
from softcal_jax.mesh import beam
from softcal_jax.sensitivity import (
    check_parameter_derivatives,
    energy_compliance,
    parameter_compliance,
    parameter_forces,
)

MESH = beam(0.1, 0.02, 0.02, (3, 1, 1), order=1)
MODEL = build_model(
    MESH,
    NeoHookean(5e5, 0.3),
    density=1000.0,
    bodies=[
        RigidBody(
            "base",
            "x_min",
            axes=hinge_axes((0, 1, 0)),
            mass=0.02,
            centre_of_mass=(0.02, 0.01, 0.02),
        ),
        # The cushion is so thick that no point leaves it: all is smooth.
        RigidBody("table", shape=HalfSpace(), origin=(0.0, 0.0, -0.075), friction=0.5),
    ],
    contact_scale=0.2,
    actuators=[
        Motor("m", "base"),
        Cable(
            "c",
            [
                Guide((0.0, 0.01, 0.06), "ground"),
                (0.03, 0.01, 0.02),
                (0.07, 0.01, 0.015),
            ],
            friction=0.2,
            pulled_from="first",
        ),
    ],
)
MARKERS = Markers(("a", "b"), [[0.06, 0.01, 0.01], [0.09, 0.01, 0.02]])
POSE = Configuration(
    "pose",
    Support("x_max", "xz", (0.0, 0.0, 1e-3), stiffness=2e6),
    loads=[
        SurfaceForce("z_max", (0.0, 0.05, -0.1)),
        PointForce((0.1, 0.01, 0.01), (0.0, 0.02, -0.05), name="payload"),
    ],
    markers=MARKERS,
    measured=MARKERS.positions,
    effectors=(
        BodyFrame("sensor", "base"),
        ActuatorForce("torque", "m", 0.0),
        SupportReaction("reaction", "x_max", (0.0, 0.0, 0.0)),
        ContactForce("push", "table", measured=(0.0, 0.0, 0.0)),
        ContactMoment("moment", "table", (1.0, 0.0, 0.0), 0.0),
    ),
    bodies={"table": Pose((1e-3, 0.0, 0.0))},
    actuation={"m": ImposedDisplacement(0.2), "c": ImposedForce(0.5)},
    recording="tuesday",
)
PLAIN = Configuration("plain", "x_min", markers=MARKERS, measured=MARKERS.positions)
KNOWN = {"prior_std": None}


def factor(name, value):
    return Parameter(name, "", value, 0.5 * value, 2.0 * value)


SPACE = ParameterSpace(
    (
        Parameter("E", "E", 5e5, 1e5, 2e6),
        Parameter("rho", "density", 1e3, 1e2, 1e4),
        motor_zero("m", limit=0.2, **KNOWN),
        *mounting("base", (0.0, 0.0, 0.0), limit=5e-3, **KNOWN),
        *mounting("table", (0.0, 0.0, 0.0), limit=5e-3, **KNOWN),
        SetupParameter("body_mass", "base", [factor("mass of base", 0.02)]),
        SetupParameter("contact_scale", "", [factor("scale of contact", 0.2)]),
        *gravity_tilt(limit=0.3, **KNOWN),
        load_factor(each=["pose", "another"], by="configuration", **KNOWN),
        load_factor("payload", **KNOWN),
        *load_offset("payload", limit=0.05, **KNOWN),
        actuator_factor("c", **KNOWN),
        friction("c", 0.2, limit=0.15, **KNOWN),
        friction("table", 0.5, limit=0.3, **KNOWN),
        *recording_offset(limit=5e-3, turn_limit=0.2, each=["tuesday"], **KNOWN),
        clamp_stiffness("x_max", 2e6, **KNOWN),
        *marker_offset("a", limit=5e-3, **KNOWN),
        *marker_offset("sensor", limit=5e-3, **KNOWN),
        command("c", {"tuesday": 0.5}, {"tuesday": (0.0, 2.0)}, unit="N"),
        command("m", {"tuesday": 0.2}, {"tuesday": (-0.5, 0.6)}, unit="rad"),
    )
)
LANES = configuration_arrays(MESH, [POSE], MODEL.mechanism)
LANE = lane_of(LANES)
IDLE = np.isin(SPACE.names, ["factor of loads in another", "mounting x of table"])
"""A factor of a pose that is not here, and a plane that stands elsewhere in itself."""


def point():
    """Values that are not the nominal ones, where derivatives may vanish."""
    away = np.linspace(0.1, 0.3, len(SPACE.names))
    return SPACE.start() + jnp.asarray(away)


@jax.jit
def values(z):
    model, lane = SPACE.apply(MODEL, LANE, z)
    solution = solve_equilibrium(model, lane, settings=NewtonSettings(rtol=1e-12))
    u = solution.displacement
    return effector_values(model, lane, u, solution.multipliers).ravel(), u


@cache
def compliance():
    z = point()
    return energy_compliance(MODEL, LANE, values(z)[1], SPACE, z)


def test_all_kinds_are_here():
    kinds = {e.kind for e in SPACE.entries if isinstance(e, SetupParameter)}
    # A shape is refused beside loads by area, and stands in test_shape_offset.
    assert kinds | {"shape_offset"} == set(KINDS)


def test_sensitivities_meet_differences_at_second_order():
    z, W = point(), np.asarray(compliance().W_ep)
    errors = []
    for h in (0.3, 0.1):
        columns = [
            (values(z + h * d)[0] - values(z - h * d)[0]) / (2.0 * h)
            for d in np.eye(len(z))
        ]
        errors.append(np.abs(np.stack(columns, axis=1) - W).max(axis=0))
    size = np.abs(W).max(axis=0)
    assert size[IDLE].max() < 1e-12
    for i, name in enumerate(SPACE.names):
        if IDLE[i]:
            continue
        assert size[i] > 1e-6, f"{name} has no effect"
        # A reading, or the arm of a moment, is linear in it: rounding.
        if name.startswith("offset") or name == "mounting y of table":
            assert errors[1][i] < 1e-12
        else:
            # A third of the step leaves a ninth of the error.
            assert 8.0 < errors[0][i] / errors[1][i] < 10.0, name


def test_direct_and_adjoint_side_agree():
    """Two ways through one factorization: rounding of the solve."""
    z = point()
    at = (MODEL, LANE, values(z)[1], SPACE, z)
    W = np.asarray(compliance().W_ep)
    direct = parameter_compliance(*at, method="direct")
    np.testing.assert_allclose(W, direct.W_ep, rtol=1e-8, atol=1e-12)
    adjoint = parameter_compliance(*at, method="adjoint")
    scale = np.abs(W).max(axis=0) + IDLE
    assert np.max(np.abs(adjoint.W_ep - W) / scale) < 1e-8
    assert adjoint.displacement is None


def test_both_sides_know_of_a_displacement_that_is_imposed():
    """Its rows are of the cable's own unknown, its tension, and not of forces."""
    cable = Cable("c", [(0.03, 0.01, 0.02), (0.07, 0.01, 0.015)])
    model = build_model(MESH, NeoHookean(5e5, 0.3), density=1e3, actuators=[cable])
    pose = Configuration(
        "pose",
        "x_min",
        markers=MARKERS,
        measured=MARKERS.positions,
        effectors=(ActuatorForce("tension", "c", 0.0),),
        actuation={"c": ImposedDisplacement(1e-3)},
        recording="tuesday",
    )
    lane = lane_of(configuration_arrays(MESH, [pose], model.mechanism))
    pulled = command("c", {"tuesday": 1e-3}, {"tuesday": (0.0, 2e-3)}, unit="m")
    space = ParameterSpace((SPACE.entries[0], pulled))
    still = jnp.zeros((model.n_points, 3))
    direct, adjoint = (
        parameter_compliance(model, lane, still, space, space.start(), method=method)
        for method in ("direct", "adjoint")
    )
    by_command = np.asarray(direct.W_ep)[:, 1]
    assert np.count_nonzero(np.abs(by_command) > 1e-6) >= 3  # markers and the tension
    np.testing.assert_allclose(adjoint.W_ep[:, 1], by_command, rtol=1e-8, atol=1e-12)


def test_energy_compliance_is_symmetric_and_positive():
    W = np.asarray(compliance().W_pp)
    assert bool(compliance().ok)
    np.testing.assert_array_equal(W, W.T)
    assert np.linalg.eigvalsh(W[:2, :2]).min() > 0.0


def test_finite_differences_of_the_paper_show_second_order_for_forces():
    """H_p itself, at a fixed state; moduli on a log scale, density, loads, tilt."""
    cable = Cable("c", [(0.03, 0.01, 0.02), (0.07, 0.01, 0.015)])
    model = build_model(MESH, NeoHookean(5e5, 0.3), density=1e3, actuators=[cable])
    pose = Configuration("pose", "x_min", actuation={"c": ImposedForce(0.5)})
    lane = lane_of(configuration_arrays(MESH, [pose], model.mechanism))
    of_forces = gravity_tilt(limit=0.3, **KNOWN)[0], actuator_factor("c", **KNOWN)
    space = ParameterSpace((*SPACE.entries[:2], *of_forces))
    z = space.start() + jnp.asarray(np.linspace(0.1, 0.3, 4))
    u = jnp.asarray(np.random.default_rng(0).normal(size=(model.n_points, 3)))
    checked = check_parameter_derivatives(
        model, lane, 1e-3 * u, space, z, steps=(1e-1, 3e-2, 1e-2)
    )
    np.testing.assert_allclose(checked.orders, 2.0, atol=0.05)


class Forgotten(AbstractEntry):
    """A kind whose author forgot what it sets; `lie` has it claim a field."""

    param: Parameter
    lie: bool = False

    @property
    def parameters(self):
        return (self.param,)

    @property
    def fields(self):
        return ("E",) if self.lie else ()

    @property
    def tet_group(self):
        return None

    @property
    def label(self):
        return self.param.name

    def apply(self, model, configuration, values):
        if self.lie:
            return gravity_tilt(**KNOWN)[0].apply(
                model, configuration, {"first tilt of gravity": values[self.param.name]}
            )
        return model, configuration

    def check(self, model):
        pass

    def renamed(self, points, names):
        return self


@pytest.mark.parametrize(
    ("lie", "message"),
    [
        (False, "'mine' sets nothing"),
        (True, r"'mine' sets \[1\]\.tilt beside its fields"),
    ],
)
def test_a_forgotten_kind_fails_loudly(lie, message):
    entry = Forgotten(Parameter("mine", "", 0.1, 0.0, 1.0, scale="linear"), lie)
    with pytest.raises(ValueError, match=message):
        check_parameters(MODEL, ParameterSpace((entry,)), LANE)


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        (actuator_factor("d", **KNOWN), r"actuator .*'factor of d' 'd'.*'c'"),
        (clamp_stiffness("z_min", 1e6, **KNOWN), r"support with a stiffness.*'x_max'"),
        (marker_offset("c", limit=1.0, **KNOWN)[0], r"6-D sensor .*'c'.*'a'.*'b'"),
    ],
)
def test_what_no_configuration_has_is_refused(entry, message):
    with pytest.raises(ValueError, match=message):
        check_parameters(MODEL, ParameterSpace((entry,)), LANE)


def test_friction_of_one_cable_among_others_of_other_sizes():
    """Cables of other sizes stand in other arrays; each is found by its name."""
    paths = {
        "c1": [(0.0, 0.01, 0.02), (0.03, 0.01, 0.02), (0.07, 0.01, 0.01)],
        "c2": [
            (0.0, 0.005, 0.02),
            (0.02, 0.005, 0.01),
            (0.05, 0.005, 0.02),
            (0.09, 0.005, 0.01),
        ],
        "c3": [(0.0, 0.015, 0.02), (0.04, 0.015, 0.02), (0.08, 0.015, 0.01)],
    }
    cables = [
        Cable(name, path, friction=0.2, pulled_from="first")
        for name, path in paths.items()
    ]
    model = build_model(MESH, NeoHookean(5e5, 0.3), density=1e3, actuators=cables)
    x = jnp.asarray(model.mechanism.points)
    rows = eqx.filter_jit(lambda model: model.mechanism.actuators.rows(x))
    for index, name in enumerate(paths):
        entry = friction(name, 0.2, limit=0.1, **KNOWN)
        changed, _ = entry.apply(model, None, {f"friction of {name}": jnp.array(0.4)})
        moved = jnp.any(rows(changed) != rows(model), axis=(1, 2))
        np.testing.assert_array_equal(moved, np.arange(3) == index)


@pytest.mark.slow
def test_relaxation_of_a_modulus_does_not_depend_on_other_parameters():
    """A body that hangs freely on the beam turns with it."""
    hanging = build_model(
        MESH,
        NeoHookean(5e5, 0.3),
        density=1000.0,
        bodies=[RigidBody("plate", "x_max", mass=0.2)],
    )
    lanes = configuration_arrays(MESH, [PLAIN], hanging.mechanism)
    lane = lane_of(lanes)
    u = jax.jit(solve_equilibrium)(hanging, lane).displacement
    E, tilt = Parameter("E", "E", 5e5, 1e5, 2e6), gravity_tilt(**KNOWN)

    def relaxation(*entries):
        space = ParameterSpace((E, *entries))
        at = (hanging, lane, u, space, space.start())
        response = parameter_compliance(*at, method="direct")
        work = jnp.einsum("ink,jnk->ij", parameter_forces(*at), response.displacement)
        return energy_compliance(*at).W_pp, work

    alone, _ = eqx.filter_jit(relaxation)()
    beside, work = eqx.filter_jit(relaxation)(*tilt)
    np.testing.assert_allclose(beside[0, 0], alone[0, 0], rtol=1e-10)
    # Nothing that is held moves: it is the work of the forces on what they move.
    size = np.sqrt(np.outer(np.diag(work), np.diag(work)))
    np.testing.assert_allclose(beside / size, work / size, rtol=0, atol=1e-9)


@pytest.mark.parametrize(
    ("entries", "message"),
    [
        (
            recording_offset(limit=1e-3, each=["tuesdya"], **KNOWN),
            "'offset x in tuesdya' 'tuesdya'.* mean",
        ),
    ],
)
def test_an_unknown_of_no_recording_is_refused(entries, message):
    with pytest.raises(ValueError, match=message):
        check_scopes(ParameterSpace(entries), [POSE])


def test_one_quantity_is_not_set_twice():
    twice = (
        load_factor(each=["tuesday"], **KNOWN),
        load_factor(**KNOWN),
    )
    with pytest.raises(ValueError, match=r"'factor of loads'.* load factor.*`each`"):
        check_parameters(MODEL, ParameterSpace(twice), LANE)
