"""Calibrations that cannot tell anything are refused, before or at the first solve."""

import numpy as np
import pytest

from softcal_jax.calibration import (
    FROM_ANYWHERE,
    Evaluator,
    build_problem,
    calibrate,
    checked_problem,
    images_of,
    run_start,
)
from softcal_jax.configurations import Configuration, Markers, Support, SurfaceForce
from softcal_jax.equilibrium import NewtonSettings, Workers, build_model
from softcal_jax.fields import (
    Parameter,
    ParameterSpace,
    exactly_known,
    gravity_tilt,
    load_factor,
    load_offset,
    recording_offset,
)
from softcal_jax.identifiability import identify
from softcal_jax.materials import NeoHookean
from softcal_jax.mesh import TetMesh, beam

TIP = (0.1, 0.01, 0.0), (0.1, 0.0, 0.0), (0.08, 0.01, 0.0)
CLAMPED = (0.0, 0.01, 0.02), (0.0, 0.0, 0.0), (0.0, 0.01, 0.0)
NONE = SurfaceForce("x_max", (0.0, 0.0, 0.0))
"""With it a lane has the shapes of those of other tests, and no other program."""

DOWN = (0.0, 0.0, -9.81)
KNOWN = {"uncertain": exactly_known(), "intervals": None}
E = Parameter("E", "E", 1e5, 3e4, 1e6, unit="Pa")


@pytest.fixture(scope="module")
def model():
    mesh = beam(0.1, 0.02, 0.02, (3, 1, 1), order=1)
    return build_model(mesh, NeoHookean(1e5, 0.3), density=1e3)


def pose(where=TIP, *, gravity=DOWN, held="x_min", loads=NONE, std=1e-3):
    places = np.array(where)
    markers = Markers(["a", "b", "c"], places, std)
    return Configuration("pose", [Support(held)], gravity, loads, markers, places)


def refused(model, parameters, configuration, match):
    with pytest.raises(ValueError, match=match):
        calibrate(model, parameters, configuration, uncertain=exactly_known())


def test_all_markers_on_the_clamp(model):
    refused(model, E, pose(CLAMPED), "nothing to learn of 'E'.*held")


def test_a_marker_on_the_clamp_tells_where_the_recording_is(model):
    offset = ParameterSpace(recording_offset(limit=0.01, prior_std=None))
    settings = {"newton": NewtonSettings(), "uncertain": exactly_known()}
    problem, _ = checked_problem(model, offset, (pose(CLAMPED),), **settings)
    assert problem.space.names == offset.names


def test_a_region_that_is_held():
    """The first cell of a beam."""
    box = beam(0.1, 0.02, 0.02, (4, 1, 1))
    first = box.points[box.tets].mean(axis=1)[:, 0] < 0.025
    groups = {"first": np.flatnonzero(first)}
    mesh = TetMesh(box.points, box.tets, box.node_groups, box.surface_groups, groups)
    law = NeoHookean(np.full(mesh.n_tets, 1e5), 0.3)
    model = build_model(mesh, law, density=1e3)
    cell = np.flatnonzero(mesh.points[:, 0] < 0.026)
    modulus = Parameter("E of first", "E", 1e5, 3e4, 1e6, region="first", unit="Pa")
    refused(model, modulus, pose(held=cell), "'E of first'.* tets of 'first' .*held")


@pytest.mark.parametrize(
    ("entry", "match"),
    [
        (
            Parameter("rho", "density", 1e3, 5e2, 2e3, unit="kg/m^3"),
            "'rho': no .*gravity",
        ),
        (
            gravity_tilt(prior_std=None)[0],
            "'first tilt of gravity': no .*gravity",
        ),
        (
            load_factor(prior_std=0.05),
            "'factor of loads': no .*dead load",
        ),
    ],
    ids=["density", "tilt", "loads"],
)
def test_what_no_configuration_depends_on(model, entry, match):
    refused(model, [E, entry], pose(gravity=(0.0, 0.0, 0.0), loads=()), match)


def test_an_offset_of_a_load_without_a_resultant_has_no_place(model):
    """A couple that cancels up to rounding does not say which nodes share it."""
    loads = [
        SurfaceForce(s, (f, 0.0, 0.0)) for s, f in (("z_max", 0.3), ("z_min", -0.3))
    ]
    offset = load_offset(limit=0.1, prior_std=None)[2]
    match = "'z offset of loads': no .*'loads' with a resultant"
    refused(model, [E, offset], pose(loads=loads), match)


def test_a_body_without_any_load_is_refused_at_its_first_equilibrium(model):
    """It stays as it is with any modulus; once "converged, E = 1e5 +- nan"."""
    still = pose(gravity=(0.0, 0.0, 0.0))
    refused(model, E, still, "nothing to learn of 'E'.*Check .*load")
    # The question what it would tell has an answer.
    outlook = identify(model, E, still, uncertain=exactly_known())
    assert outlook.verdict == "not identifiable"


def test_one_blind_parameter_among_others_is_no_error(model):
    """The load pulls at the clamp, where no factor of it moves anything."""
    clamped = pose(loads=[SurfaceForce("x_min", (0.0, 0.0, 1.0))])
    both = [E, load_factor(prior_std=None)]
    result = calibrate(model, both, clamped, **KNOWN)
    assert not np.any(result.linear.W[:, 1])
    assert np.isnan(result.parameters[1].standard_error)


def test_a_cost_that_is_not_finite_is_never_converged(model):
    """Squares of errors overflow beside so small a standard deviation."""
    tiny = pose(std=1e-300)
    problem = build_problem(model, E, tiny)
    with Workers(problem.model, 1) as workers:
        start = problem.space.start()
        images = images_of(problem.space, False)
        run = run_start(
            Evaluator(problem, workers), FROM_ANYWHERE, start, images=images
        )
    assert run.best.cost == np.inf
    assert not run.best.converged
    refused(model, E, tiny, "cost.*not finite.* 1e-300.* configuration")
