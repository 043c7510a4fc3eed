"""The error budget against recalibration with each thing wrong, and closed forms."""

from dataclasses import replace
from functools import cache, partial

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from wording import says

from softcal_jax.actuators import Cable, Guide, Motor
from softcal_jax.bodies import Pose, RigidBody, hinge_axes, rotation_matrix
from softcal_jax.calibration import build_problem, calibrate as calibrate_with
from softcal_jax.configurations import (
    Configuration,
    ImposedDisplacement,
    ImposedForce,
    Markers,
    Support,
    SurfaceForce,
)
from softcal_jax.equilibrium import NewtonSettings, build_model
from softcal_jax.fields import (
    FUNCTIONS,
    Parameter,
    Uncertain,
    exactly_known,
    gravity_tilt,
    load_factor,
    recording_offset,
)
from softcal_jax.inference import NOISE, Cause, ErrorBudget
from softcal_jax.materials import NeoHookean
from softcal_jax.mesh import beam, to_quadratic
from softcal_jax.robots import simulated_measurements
from softcal_jax.unknowns import noise_columns, unknowns

calibrate = partial(calibrate_with, intervals=None)

EXACT = NewtonSettings(rtol=1e-12)
MARKERS = Markers(("a", "b"), [[0.06, 0.01, 0.01], [0.09, 0.01, 0.02]], std=1e-4)
GUIDES = [(0.04, 0.01, 0.02), (0.07, 0.01, 0.015)]
MESH = beam(0.1, 0.02, 0.02, (3, 1, 1), order=1)


def robot(mounting=(0.0, 0.0, 0.0), shorter=0.0):
    """A beam on a motor, with a cable; `shorter` moves what the motor holds."""
    mesh = MESH
    if shorter:
        points = np.array(mesh.points)
        points[mesh.nodes("x_min"), 0] -= shorter
        mesh = eqx.tree_at(lambda m: m.points, mesh, points)
    base = RigidBody(
        "base",
        "x_min",
        origin=(0.0, 0.01, 0.01),
        axes=hinge_axes((0, 1, 0)),
        mounting=Pose(mounting),
    )
    model = build_model(
        mesh,
        NeoHookean(5e5, 0.3),
        density=1000.0,
        bodies=[base],
        actuators=[
            Motor("m", "base"),
            Cable("c", [Guide((0.0, 0.01, 0.06), "ground"), *GUIDES]),
        ],
    )
    return model


def poses(scale=1.0, stiffness=2e6, tension=0.5, gravity=(0.0, 0.0, -9.81), more=0.0):
    """Two recordings under the same gravity, one of them with a load."""
    force = scale * np.array([0.0, 0.05, -0.1]) + more
    pose = Configuration(
        "pose",
        Support("x_max", "xz", (0.0, 0.0, 1e-3), stiffness=stiffness),
        gravity,
        SurfaceForce("x_max", tuple(force.tolist())),
        MARKERS,
        MARKERS.positions,
        actuation={"m": ImposedDisplacement(0.2), "c": ImposedForce(tension)},
        recording="tuesday",
    )
    other = replace(
        pose, name="other", loads=(), actuation={"c": ImposedForce(0.3 * tension)}
    )
    return [pose, replace(other, recording=None)]


def tilted(angle, axis):
    """Gravity of `poses` turned about an axis that is normal to it."""
    turn = np.asarray(rotation_matrix(jnp.asarray(angle * np.eye(3)[axis])))
    return tuple(turn @ [0.0, 0.0, -9.81])


def read_off(data, shift, which):
    """As if the frame of one recording were off: what is simulated is read further."""
    return [
        replace(c, measured=c.measured - np.asarray(shift)) if k == which else c
        for k, c in enumerate(data)
    ]


E = Parameter("E", "E", 5e5, 1e5, 2e6, unit="Pa")
STD = Uncertain()
SAME_MESH = replace(STD, mesh=0.0)
ALL = replace(SAME_MESH, load_offsets=2e-3)


@cache
def data():
    return simulated_measurements(robot(), poses(), newton=EXACT)


@cache
def fitted():
    return calibrate(robot(), E, data(), noise="stated", newton=EXACT, uncertain=ALL)


def refitted(model=None, configurations=None, measured=None):
    """ln E with something changed, where the data are those of `data`."""
    configurations = configurations or poses()
    seen = [
        replace(c, measured=read.measured)
        for c, read in zip(configurations, measured or data(), strict=True)
    ]
    result = calibrate(
        model or robot(),
        E,
        seen,
        noise="stated",
        newton=EXACT,
        uncertain=replace(exactly_known(), recordings=STD.recordings),  # same weights
        intervals=None,
    )
    return float(result.z[0])


def with_law(nu):
    return robot().with_law(NeoHookean(5e5, nu))


def with_density(density):
    return eqx.tree_at(lambda m: m.density, robot(), jnp.asarray(density, float))


def with_zero(angle):
    zero = lambda m: m.mechanism.motor_zero
    return eqx.tree_at(zero, robot(), zero(robot()).at[0].set(angle))


# Shapes have no elastic supports: see sensitivity/test_shape_offset.py.
CAUSES = sorted(set(vars(STD)) - {"mesh", "contact", "shapes"})
STEP = 0.1
"""Share of a standard deviation by which things are changed: errors of second order."""

MM = lambda s: s * 1e-3
CHANGES = {
    "nu": lambda s: refitted(with_law(0.3 + STD.nu * s)),
    "density": lambda s: refitted(with_density(1000.0 * (1.0 + STD.density * s))),
    "gravity_tilt first": lambda s: refitted(
        configurations=poses(gravity=tilted(STD.gravity * s, 0))
    ),
    "gravity_tilt second": lambda s: refitted(
        configurations=poses(gravity=tilted(-STD.gravity * s, 1))
    ),
    "load_factor loads": lambda s: refitted(configurations=poses(1.0 + STD.loads * s)),
    **{
        f"load_offset loads {axis}": lambda s, k=k: refitted(
            configurations=poses(more=ALL.load_offsets * s * np.eye(3)[k])
        )
        for k, axis in enumerate("xyz")
    },
    "actuator_factor c": lambda s: refitted(
        configurations=poses(tension=0.5 * (1.0 + STD.actuators * s))
    ),
    "clamp_stiffness x_max": lambda s: refitted(
        configurations=poses(stiffness=2e6 * (1.0 + STD.supports * s))
    ),
    "motor_zero m": lambda s: refitted(with_zero(STD.zeros * s)),
    **{
        f"mounting base {axis}": lambda s, k=k: refitted(
            robot(STD.mountings * s * np.eye(3)[k])
        )
        for k, axis in enumerate("xyz")
    },
    **{
        f"recording_offset {axis} in {name}": lambda s, k=k, which=which: refitted(
            measured=read_off(data(), STD.recordings * s * np.eye(3)[k], which)
        )
        for which, name in enumerate(("tuesday", "other"))
        for k, axis in enumerate("xyz")
    },
    "clamp": lambda s: refitted(robot(shorter=STD.clamp * s)),
}
"""ln E if something is off by a share of its standard deviation, by its name."""


def deviations():
    """Change of ln E per standard deviation of each error."""
    return {
        error: float(change)
        for cause in fitted().budget.causes
        for error, change in zip(cause.errors, cause.deviations[0], strict=True)
    }


@pytest.mark.slow
def test_all_causes_are_here():
    """A cause that the budget has and `CHANGES` does not, or the other way round."""
    assert set(deviations()) == set(CHANGES)
    assert {cause.name for cause in fitted().budget.causes} == set(CAUSES)


def test_what_would_calibrate_a_cause_along_is_a_key_of_setup():
    along = {cause.name: cause.fitted for cause in fitted().budget.causes}
    assert set(along.values()) - {""} <= set(FUNCTIONS)
    wanted = {
        "gravity": "gravity_tilt",
        "mountings": "mounting",
        "loads": "load_factor",
    }
    assert wanted.items() <= along.items()


@pytest.mark.parametrize("error", CHANGES)
def test_recalibration_moves_as_the_budget_says(error):
    """Central differences; what is left is of second order in a tenth of a std."""
    change = CHANGES[error]
    moved = (change(STEP) - change(-STEP)) / (2.0 * STEP)
    predicted = deviations()[error]
    largest = max(map(abs, deviations().values()))
    np.testing.assert_allclose(predicted, moved, rtol=2e-3, atol=1e-6 * largest)
    assert abs(predicted) > 1e-6, "it should matter here"


L = 0.1
LINEAR = beam(L, 0.02, 0.02, (6, 1, 1), order=1)
NEAR = np.flatnonzero(LINEAR.points[LINEAR.tets].mean(axis=1)[:, 0] < 0.05)
BEAM = to_quadratic(replace(LINEAR, tet_groups={"near": NEAR}))
END = Markers(("a",), [[L, 0.01, 0.02]], std=1e-4)
CANTILEVER = build_model(BEAM, NeoHookean(2e5, 0.0), density=1000.0)
"""Without a Poisson's ratio, so that the clamp does not hold its width."""

WIDE = Parameter("E", "E", 2e5, 3e4, 1e6, unit="Pa")
NONE = SurfaceForce("x_max", (0.0, 0.0, 0.0))
HANGING = Configuration("hang", Support("x_min"), loads=NONE, markers=END)
PULLED = Configuration(
    "pull",
    Support("x_min"),
    (0.0, 0.0, 0.0),
    SurfaceForce("x_max", (0.0, 0.0, -0.01)),
    markers=END,
)


@cache
def cantilever(name):
    pose = {"hang": HANGING, "pull": PULLED}[name]
    measured = simulated_measurements(CANTILEVER, [pose])
    return calibrate(CANTILEVER, WIDE, measured, noise="stated", uncertain=SAME_MESH)


def relative(result):
    return {name: float(std[0]) / 2e5 for name, std in result.budget.by_cause().items()}


@pytest.mark.parametrize(
    ("name", "powers", "shear"), [("pull", (3, 1), 0.6), ("hang", (4, 2), 0.8)]
)
def test_free_length_of_a_cantilever(name, powers, shear):
    """E ~ F L^3 / f or w L^4 / f, and less by the share that shears.

    Timoshenko's beam of height h, shear factor 5/6, nu = 0: under an end load the
    deflection by shear is 0.6 (h/L)^2 of that by bending and in proportion to L; under
    its weight it is 0.8 (h/L)^2 and in proportion to L^2.
    """
    share = shear * (0.02 / L) ** 2
    power = (powers[0] + powers[1] * share) / (1.0 + share)
    clamp = relative(cantilever(name))["clamp"]
    np.testing.assert_allclose(clamp, power * STD.clamp / L, rtol=0.01)


@pytest.mark.parametrize(
    ("name", "cause", "std"), [("pull", "loads", 0.02), ("hang", "density", 0.03)]
)
def test_load_and_modulus_are_in_proportion(name, cause, std):
    """Only their ratio counts: exact for a law that is linear in its modulus."""
    np.testing.assert_allclose(relative(cantilever(name))[cause], std, rtol=1e-5)


def test_what_a_configuration_does_not_have_is_no_cause():
    assert set(relative(cantilever("pull"))) == {
        NOISE,
        "nu",
        "loads",
        "clamp",
        "recordings",
    }


def test_the_standard_error_is_the_root_of_the_sum_of_squares():
    result = cantilever("hang")
    parts = result.budget.by_cause()
    total = np.sqrt(sum(std**2 for std in parts.values()))[0]
    np.testing.assert_allclose(result.parameters[0].standard_error, total, rtol=1e-12)
    # What the likelihood knows of: jitter, and the offsets of recordings.
    noise = 2e5 * np.sqrt(result.uncertainty.covariance[0, 0])
    both = np.hypot(parts[NOISE], parts["recordings"])
    np.testing.assert_allclose(both, noise, rtol=1e-6)


def test_it_says_what_to_measure_first():
    result = cantilever("hang")
    parts = {c: 100.0 * share for c, share in relative(result).items()}
    (line,) = str(result.budget).splitlines()
    assert line.removeprefix("E: ") in str(result)
    assert line.startswith(f"E: noise {parts['noise']:.2g} %, clamp ")
    assert f", density {parts['density']:.2g} %" in line
    assert "gravity" not in line  # less than a tenth of the whole
    advice = result.budget.advice("E")
    total = np.sqrt(sum(share**2 for share in parts.values()))
    rest = np.sqrt(total**2 - parts["clamp"] ** 2)
    # Half of what is stated, 1 mm, since what is left is larger.
    known = np.hypot(rest, 0.5 * parts["clamp"])
    assert says(advice, "clamp grips to 0.5 mm. E ... by", f"{total:.2g} %")
    assert says(advice, f"{parts['clamp']:.2g} % through clamp", f"{known:.2g} %")


def test_it_says_to_what_a_cause_must_be_known():
    """Gravity is all: to a tenth of a degree, which leaves 1.2 % beside 1 % by noise.

    An axis that is known no better than its range is blind.
    """
    tilt = np.array([[0.12], [2.0]])
    gravity = Cause("gravity", ("gravity_tilt first",), tilt, np.deg2rad(1.0), "rad")
    budget = ErrorBudget(
        names=("E", "theta"),
        values=np.array([2e5, 0.3]),
        slopes=np.array([2e5, 1.0]),
        units=("Pa", "rad"),
        noise=np.diag([1e-4, 1e-4]),
        causes=(replace(gravity, fitted="gravity_tilt"),),
    )
    assert says(budget.advice("E"), "level the robot to 0.1 deg", "gravity_tilt")
    assert says(budget.advice("E"), "12 % through gravity alone", "1.6 %")
    assert says(budget.sentence("theta"), "gravity blind")


def recalibrated(**settings):
    return calibrate(robot(), E, data(), noise="stated", newton=EXACT, **settings)


def names(result):
    return {error for cause in result.budget.causes for error in cause.errors}


PLAIN = CANTILEVER.with_law(NeoHookean(2e5, 0.3))
"""The cantilever with a Poisson's ratio, and one program with it."""

ON_PLAIN = replace(PULLED, gravity=(0.0, 0.0, -9.81), recording="tuesday")


def plain_fit(*parameters, configurations=(), **settings):
    measured = simulated_measurements(PLAIN, configurations or [ON_PLAIN])
    options = {"uncertain": SAME_MESH} | settings
    return calibrate(PLAIN, (WIDE, *parameters), measured, noise="stated", **options)


@pytest.mark.parametrize("cause", CAUSES)
def test_zero_switches_a_cause_off(cause):
    known = recalibrated(uncertain=replace(ALL, **{cause: 0.0}))
    left = {c.name for c in known.budget.causes}
    assert left == set(CAUSES) - {cause}
    # Offsets of recordings weigh the data: without them all others change.
    whole = known if cause == "recordings" else fitted()
    kept = [c.variance for c in whole.budget.causes if c.name != cause]
    expected = sum(kept) + np.diag(known.budget.noise)
    np.testing.assert_allclose(
        np.diag(known.budget.covariance), expected, rtol=1e-5, atol=0
    )


def test_without_any_cause_the_noise_remains():
    known = recalibrated(uncertain=exactly_known())
    assert known.budget.causes == ()
    np.testing.assert_array_equal(known.budget.covariance, known.budget.noise)


def all_errors(*parameters):
    """Names of what a calibration of E and others counts as uncertain."""
    measured = simulated_measurements(PLAIN, [ON_PLAIN])
    problem = build_problem(PLAIN, (WIDE, *parameters), measured, uncertain=SAME_MESH)
    effectors = problem.configurations.effectors
    of_noise = noise_columns(problem.noise, effectors, measured).names
    every = unknowns(problem)
    held = [unknown.groups(1) for unknown in every if unknown.role == "considered"]
    return set(of_noise) | {name for groups in held for name, _ in groups}


def test_what_is_calibrated_is_not_considered_as_well():
    calibrated = [
        *gravity_tilt(limit=0.3, prior_std=0.02),
        load_factor(prior_std=0.02),
        *recording_offset(limit=5e-3, prior_std=1e-3, each=["tuesday"]),
    ]
    assert all_errors() == names(plain_fit())
    assert all_errors() - all_errors(*calibrated) == {
        "gravity_tilt first",
        "gravity_tilt second",
        "load_factor loads",
        *(f"recording_offset {axis}" for axis in "xyz"),
    }


@pytest.mark.slow
def test_a_field_that_is_calibrated_in_a_part_is_considered_in_the_rest():
    """A Poisson's ratio of one tet group leaves the other."""
    of_group = {"scale": "linear", "region": "near"}
    near = Parameter("nu", "nu", 0.3, 0.0, 0.45, **of_group)
    only_nu = replace(exactly_known(), nu=0.05)
    parts = [plain_fit(*parameters, uncertain=only_nu) for parameters in ((), (near,))]
    whole, rest = (result.budget.by_cause()["nu"][0] for result in parts)
    assert 0.0 < rest
    assert rest != pytest.approx(whole, rel=1e-3)


def test_a_ratio_near_one_half_cannot_pass_it():
    """At 0.49 two standard deviations reach 0.5 and no farther."""
    soft = CANTILEVER.with_law(NeoHookean(2e5, 0.49))
    measured = simulated_measurements(soft, [PULLED])
    errors = [
        calibrate(
            soft, WIDE, measured, noise="stated", uncertain=replace(SAME_MESH, nu=std)
        ).budget.by_cause()["nu"]
        for std in (0.05, 0.005, 0.0025)
    ]
    np.testing.assert_allclose(errors[0], errors[1], rtol=1e-6)
    np.testing.assert_allclose(errors[2], 0.5 * errors[1], rtol=1e-6)


def test_errors_of_configurations_that_are_posed_alike_add_up():
    """One error of gravity for two recordings that state the same; two otherwise."""
    assert "gravity_tilt first" in names(fitted())
    other = replace(ON_PLAIN, name="other", gravity=(0.0, -9.81, 0.0))
    errors = names(plain_fit(configurations=[ON_PLAIN, other]))
    assert {"gravity_tilt first in group 1", "gravity_tilt first in group 2"} <= errors


@pytest.mark.parametrize("value", [-0.1, float("nan"), float("inf")])
def test_a_standard_deviation_is_not_negative(value):
    with pytest.raises(ValueError, match=f"nu.*finite.*{value}"):
        Uncertain(nu=value)


@pytest.mark.slow
def test_linear_tets_know_how_far_off_they_are():
    """Fitted to quadratic tets of the same mesh: ln E is off by ln(e_linear / e).

    The budget estimates e / e_linear - 1 to a factor of two.
    """
    linear = build_model(LINEAR, NeoHookean(2e5, 0.3), density=1000.0)
    light = replace(PULLED, loads=SurfaceForce("x_max", (0.0, 0.0, -5e-3)))
    measured = simulated_measurements(PLAIN, [light])
    result = calibrate(linear, WIDE, measured, noise="stated")
    (mesh_error,) = [c for c in result.budget.causes if c.name == "mesh"]
    off = np.exp(-result.z[0]) * 2e5 - 1.0
    assert off > 1.0  # a modulus of less than half
    assert 0.5 * off < abs(mesh_error.deviations[0, 0]) < 2.0 * off
    assert result.budget.advice("E").startswith("use quadratic tets.")
    known = calibrate(linear, WIDE, measured, noise="stated", uncertain=SAME_MESH)
    assert "mesh" not in {cause.name for cause in known.budget.causes}


def test_the_budget_is_that_of_the_fit_whatever_is_held_out():
    """Another clamp there gives no group here."""
    other = replace(ON_PLAIN, name="other", supports=(Support("x_max"),))
    fitted, held_out = simulated_measurements(PLAIN, [ON_PLAIN, other])
    result = calibrate(
        PLAIN, WIDE, fitted, validation=held_out, noise="stated", uncertain=SAME_MESH
    )
    assert "clamp" in names(result)
    assert names(result) == names(plain_fit())
