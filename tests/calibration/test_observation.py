"""A reading of one's own, beside what the package reads."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from problems import central_difference

from softcal_jax import (
    Configuration,
    Markers,
    NeoHookean,
    Observation,
    Parameter,
    ParameterSpace,
    beam,
    build_model,
    calibrate,
    identify,
    lanes,
    parameter_compliance,
    rank_configurations,
    set_field,
    simulated_measurements,
    solve_equilibrium,
)
from softcal_jax.configurations import SurfaceForce
from softcal_jax.control import with_goals
from softcal_jax.equilibrium import (
    NewtonSettings,
    energy_and_force,
    linearise,
    sensitivity,
)
from softcal_jax.fields import exactly_known
from softcal_jax.results import result_dict
from softcal_jax.sensitivity import parameter_rows

MESH = beam(0.1, 0.02, 0.02, (3, 1, 1), order=1)
MODEL = build_model(MESH, NeoHookean(1e5, 0.3), density=1000.0)
SPACE = ParameterSpace(
    [Parameter("E", "E", 1e5, 2e4, 1e6), Parameter("rho", "density", 1e3, 500.0, 2e3)]
)
Z = SPACE.start()
TIP = int(np.argmax(MESH.points.sum(axis=1)))
STD = 1e-4
TIGHT = NewtonSettings(rtol=1e-12)
E = Parameter("E", "E", 1e5, 2e4, 1e6, unit="Pa")
NO_LOAD = SurfaceForce("x_max", (0.0, 0.0, 0.0))
"""Equilibria are then those of one program, that of loaded poses of other tests."""


def tip(model, configuration, state):
    return model.positions(state.displacement)[TIP]


def energy(model, configuration, state):
    return energy_and_force(model, state.displacement)[0]


def posed(name, gravity, *effectors, **more):
    return Configuration(
        name, "x_min", (0.0, 0.0, gravity), NO_LOAD, effectors=effectors, **more
    )


STORED = Observation("stored", energy, "J", std=1e-6)


def test_a_reading_that_sees_a_parameter_has_its_whole_derivative():
    """The energy of a state changes with E, and so does the state."""
    lane = lanes(MODEL, [posed("hang", -9.81, replace(STORED, measured=1e-3))])[0]

    def at(z):
        model, _ = SPACE.apply(MODEL, lane, jnp.asarray(z))
        return model, solve_equilibrium(model, lane, settings=TIGHT).displacement

    def slope(along, h=1e-2):
        """Differences of steps h and h / 2, without their error of second order."""
        stored = lambda z: float(energy_and_force(*at(z))[0])
        whole, half = (
            central_difference(stored, np.asarray(Z), along, size)
            for size in (h, 0.5 * h)
        )
        return (4.0 * half - whole) / 3.0

    expected, (_, u) = [slope(along) for along in np.eye(2)], at(Z)
    for method in ("direct", "adjoint"):
        W = parameter_compliance(MODEL, lane, u, SPACE, Z, method=method).W_ep
        np.testing.assert_allclose(W[0], expected, rtol=1e-7)


def test_a_point_that_is_observed_is_what_a_marker_is():
    """Here where only one of two poses has it."""
    E = Parameter("E", "E", 1e5, 2e4, 1e6)
    marker = Markers(("tip",), MESH.points[TIP][None], std=STD)
    by_marker = [posed(n, g, markers=marker) for n, g in (("up", 9.81), ("down", -9.8))]
    true = set_field(MODEL, "E", 1.3e5)
    seen = simulated_measurements(true, by_marker, seed=0)
    observed = [
        posed(c.name, g, Observation("tip", tip, "m", measured=c.measured[0], std=STD))
        for c, g in zip(seen, (9.81, -9.8), strict=True)
    ]
    held_out = replace(observed[1], name="held out")
    options = {"noise": "stated", "uncertain": exactly_known(), "intervals": None}
    expected = calibrate(MODEL, E, seen, validation=held_out, **options)
    both = [observed[0], seen[1]]
    result = calibrate(MODEL, E, both, validation=held_out, **options)
    assert result.converged
    assert result.value("E") == pytest.approx(expected.value("E"), rel=1e-8)
    errors = (r.parameters[0].standard_error for r in (result, expected))
    assert next(errors) == pytest.approx(next(errors), rel=1e-8)
    predicted = result.configurations[-1]
    assert predicted.name == "held out"
    assert np.linalg.norm(predicted.effectors[0].residual) < 5.0 * STD
    assert result_dict(result)["configurations"]
    (record,) = result.configurations[0].effectors
    assert (record.name, record.unit) == ("tip", "m")
    np.testing.assert_allclose(record.residual, record.simulated - seen[0].measured[0])


BLIND = replace(STORED, name="blind", function=lambda model, configuration, state: 1.0)


def test_what_it_tells_is_identified():
    telling, nothing = (
        str(identify(MODEL, E, posed("hang", -9.81, *pair), uncertain=exactly_known()))
        for pair in (
            (replace(STORED, std=1e-8), BLIND),
            (replace(STORED, std=1e9), replace(BLIND, std=1e-8)),
        )
    )
    assert nothing.startswith("Not identifiable")
    assert not telling.startswith("Not identifiable")


def test_what_it_would_add_is_ranked():
    fitted = posed("fitted", -9.81, replace(STORED, std=1e-3))
    candidates = [posed("blind", -9.81, BLIND), posed("telling", -5.0, STORED)]
    ranking = rank_configurations(
        MODEL, E, fitted, candidates, uncertain=exactly_known()
    )
    text = str(ranking)
    assert 0 < text.index("telling") < text.index("blind")


def root(model, configuration, state):
    """Singular where nothing moves."""
    return jnp.sqrt(jnp.abs(state.displacement[TIP, 2]))


def test_what_another_pose_does_not_have_is_not_computed_there():
    at_rest = Markers(("tip",), MESH.points[TIP][None], std=STD)
    still = posed("still", 0.0, markers=at_rest, measured=at_rest.positions)
    observed = Observation("root", root, "m", measured=0.07, std=1e-3)
    options = {"noise": "stated", "uncertain": exactly_known(), "intervals": None}
    hang = posed("hang", -9.81, observed)
    alone = calibrate(MODEL, E, hang, validation=still, **options)
    beside = calibrate(MODEL, E, [hang, still], **options)
    assert beside.converged
    assert beside.value("E") == pytest.approx(alone.value("E"), rel=1e-6)
    assert "nan" not in str(alone)


def test_a_checkpoint_of_another_function_is_refused(tmp_path):
    """Also where only what it closes over differs."""
    path = tmp_path / "c.npz"

    def fit(factor):
        scaled = lambda model, configuration, state: (
            factor * energy(model, configuration, state)
        )
        seen = replace(STORED, function=scaled, measured=1e-4)
        return calibrate(
            MODEL,
            E,
            posed("hang", -9.81, seen),
            noise="stated",
            uncertain=exactly_known(),
            intervals=None,
            checkpoint=path,
        )

    first = fit(1.0)
    assert fit(1.0).value("E") == first.value("E")
    with pytest.raises(ValueError, match="checkpoint of another calibration"):
        fit(2.0)


def test_it_takes_a_goal():
    aimed = with_goals(posed("hang", -9.81, STORED), {"stored": 2e-3})
    assert aimed.effectors[0].measured == 2e-3
    with pytest.raises(ValueError, match="has 3 numbers, expected 1"):
        with_goals(aimed, {"stored": (1.0, 2.0, 3.0)})


def test_values_that_do_not_fit_are_named():
    wrong = Observation("tip", tip, "m", measured=0.1, std=STD)
    lane = lanes(MODEL, [posed("hang", -9.81, wrong)])[0]
    u = solve_equilibrium(MODEL, lane).displacement
    with pytest.raises(ValueError, match=r"'tip' returned .* \(3,\), .* has 1"):
        parameter_compliance(MODEL, lane, u, SPACE, Z)
    with pytest.raises(ValueError, match=r"std .*'tip' has 3 .*measured value 1:"):
        lanes(MODEL, [posed("hang", -9.81, replace(wrong, std=np.full(3, STD)))])
    long = Observation("all", energy, "J", measured=np.ones(5), std=1.0)
    with pytest.raises(ValueError, match=r"hang.*'all' has 5 values"):
        lanes(MODEL, [posed("hang", -9.81, long)])


def test_an_observation_needs_a_std():
    with pytest.raises(ValueError, match=r"'x' .*std \[J\]"):
        Observation("x", energy, "J", 0.1)


def test_a_reading_without_a_derivative_is_named():
    """The distance of a node that is held has none; good markers stand beside it."""
    held = int(np.argmin(MESH.points.sum(axis=1)))
    size = lambda model, c, state: jnp.linalg.norm(state.displacement[held])
    seen = Markers(("tip",), MESH.points[TIP][None], std=STD)
    far = Observation("far", size, "m", measured=0.0, std=STD)
    pose = posed("hang", -9.81, far, markers=seen, measured=seen.positions)
    for use in (identify, calibrate):
        with pytest.raises(ValueError, match=r"'far' .*derivative .* 'hang'"):
            use(MODEL, SPACE, pose, uncertain=exactly_known())


def test_readings_of_a_loop_of_ones_own():
    """They have their own derivatives, and their number must be that of the rows."""
    marker = Markers(("tip",), MESH.points[TIP][None], std=STD)
    lane = lanes(MODEL, [posed("hang", -9.81, markers=marker)])[0]
    u = solve_equilibrium(MODEL, lane).displacement

    def depth(model, configuration, u, lambda_a, unbalanced):
        return model.positions(u)[TIP, 2]

    @jax.jit
    def compliance(u):
        lin = linearise(MODEL, lane, u)
        for adjoint in (False, True):
            with pytest.raises(ValueError, match=r"for 3 readings.* 1 .*`readings`"):
                sensitivity(lin, parameter_rows(lin, SPACE, Z), depth, adjoint=adjoint)
        bare = linearise(MODEL, lanes(MODEL, [posed("hang", -9.81)])[0], u)
        with pytest.raises(ValueError, match=r"for 0 readings.* 1 .*`readings`"):
            sensitivity(bare, parameter_rows(bare, SPACE, Z), depth)
        return sensitivity(lin, parameter_rows(lin, SPACE, Z, depth), depth).W_ep

    W = compliance(u)
    assert W.shape == (1, 2)
    whole = parameter_compliance(MODEL, lane, u, SPACE, Z).W_ep
    np.testing.assert_allclose(W[0], whole[2], rtol=1e-10)
