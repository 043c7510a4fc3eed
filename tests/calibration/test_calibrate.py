import itertools
import re
from dataclasses import replace
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from watching import only
from wording import says

from benchmarks._compilations import Compilations
from softcal_jax.calibration import (
    NOT_TAKEN,
    CalibrationSettings,
    CalibrationWarning,
    Evaluator,
    HistoryEntry,
    build_problem,
    calibrate as calibrate_with,
    decide,
    descend,
    evaluate,
    initial_state,
    propose,
)
from softcal_jax.configurations import (
    Configuration,
    Markers,
    Support,
    SurfaceForce,
)
from softcal_jax.equilibrium import NewtonSettings, Workers, build_model
from softcal_jax.fields import Parameter, exactly_known
from softcal_jax.materials import Corotational, Isotropic, NeoHookean
from softcal_jax.mesh import beam
from softcal_jax.robots import simulated_measurements

E_TRUE, NU_TRUE = 1.6e5, 0.33
MARKERS = Markers(
    ("a", "b", "c"), [[0.1, 0.01, 0.02], [0.1, 0.0, 0.0], [0.05, 0.02, 0.01]]
)
CRUSHED = Configuration(
    "crushed",
    (Support("x_min"),),
    (0.0, 0.0, 0.0),
    (SurfaceForce("x_max", (-1e6, 0.0, 0.0)),),
    MARKERS,
    MARKERS.positions,
)
calibrate = partial(calibrate_with, uncertain=exactly_known())
"""Nothing here is asked of the error budget, whose programs then are not compiled."""

LOADS = {"hang": 0.0, "pull": 0.05, "push": -0.03}


def posed(name, measured=None, mesh_pull=0.0):
    pull = SurfaceForce("x_max", (0.0, LOADS[name] + mesh_pull, 0.0))
    return Configuration(
        name,
        (Support("x_min"),),
        (0.0, 0.0, -9.81),
        (pull,),
        MARKERS,
        measured,
    )


def measure(mesh, law, names=tuple(LOADS), noise=0.0, seed=0, formulation="auto"):
    """Configurations with positions simulated on a mesh of their own."""
    model = build_model(mesh, law, density=1000.0, formulation=formulation)
    seen = simulated_measurements(model, [posed(name) for name in names])
    random = np.random.default_rng(seed)
    errors = noise * random.normal(size=(len(names), *MARKERS.positions.shape))
    pairs = zip(seen, errors, strict=True)
    return [replace(c, measured=c.measured + error) for c, error in pairs]


def seen_by_one(measured):
    """The first pose, of which one coordinate of one marker was seen."""
    few = Markers(("a",), MARKERS.positions[:1], axes="z")
    return replace(posed("hang"), markers=few, measured=measured[:1])


ALL_MARKERS = posed("push", MARKERS.positions)
"""Held out beside `seen_by_one`, whose program then is that of all markers."""


def parameter(start=1e5, lower=3e4, upper=1e6):
    return Parameter("E", "E", start, lower, upper, unit="Pa")


@pytest.fixture(scope="module")
def model():
    mesh = beam(0.1, 0.02, 0.02, (3, 1, 1))
    return build_model(mesh, NeoHookean(1e5, NU_TRUE), density=1000.0)


@pytest.fixture(scope="module")
def exact(model):
    """Data of the model itself, so that the answer is known to rounding."""
    return measure(model.mesh, NeoHookean(E_TRUE, NU_TRUE))


@pytest.fixture(scope="module")
def recovered(model, exact):
    poses, held_out = exact[:2], exact[2:]
    return calibrate(model, [parameter()], poses, validation=held_out, intervals=None)


def test_two_parameters_are_recovered(model, exact):
    nu = Parameter("nu", "nu", 0.2, 0.0, 0.45, scale="linear")
    result = calibrate(model, [parameter(), nu], exact)
    assert result.converged
    assert result.value("E") == pytest.approx(E_TRUE, rel=1e-6)
    assert result.value("nu") == pytest.approx(NU_TRUE, rel=1e-5)


@pytest.mark.parametrize("E", np.geomspace(5e4, 5e5, 6))
def test_equilibria_from_rest_are_as_exact_as_those_on_the_way(model, exact, E):
    """Else the cost at the start of a fit is off by more than a step can lower it.

    Every step is refused then: a fit from its own optimum was "not converged".
    """
    nu = Parameter("nu", "nu", 0.2, 0.0, 0.45, scale="linear")
    problem = build_problem(model, [parameter(), nu], exact)
    z = problem.space.to_scaled(jnp.array([E, 0.3]))
    from_rest = evaluate(problem, z)
    near = evaluate(problem, z, from_rest.equilibrium.displacement)
    motion = float(np.max(np.abs(from_rest.equilibrium.displacement)))
    np.testing.assert_allclose(
        from_rest.effectors, near.effectors, rtol=0, atol=1e-12 * motion
    )


def test_held_out_configuration_is_predicted_and_never_used(model, exact, recovered):
    roles = {fit.name: fit.role for fit in recovered.configurations}
    assert roles == {"hang": "calibration", "pull": "calibration", "push": "validation"}
    assert recovered.configurations[2].rms_after < 1e-8
    wrong = posed("push", exact[2].measured + 0.01)
    again = calibrate(model, [parameter()], exact[:2], validation=[wrong])
    assert again.value("E") == recovered.value("E")
    np.testing.assert_allclose(
        again.configurations[2].rms_after, np.sqrt(3) * 0.01, rtol=1e-6
    )


def test_history_falls_to_the_solution(recovered):
    cost = [entry.cost for entry in recovered.history if entry.accepted]
    assert all(b <= a for a, b in itertools.pairwise(cost))
    assert max(abs(v) for v in recovered.history[-1].lambda_p) <= 1e-6
    assert all(entry.kkt_residual < 1e-8 for entry in recovered.history)


def test_linear_tets_say_that_their_modulus_is_effective(recovered):
    assert any("effective numbers" in note for note in recovered.notes)


@pytest.mark.slow  # half a minute of compiling
def test_quadratic_tets_do_not():
    mesh = beam(0.1, 0.02, 0.02, (3, 1, 1), order=2)
    data = measure(mesh, Corotational(Isotropic(E_TRUE, NU_TRUE)), ("hang",))
    model = build_model(mesh, Corotational(Isotropic(1e5, NU_TRUE)), density=1000.0)
    result = calibrate(model, [parameter()], data)
    assert result.value("E") == pytest.approx(E_TRUE, rel=1e-6)
    assert not any("effective" in note for note in result.notes)


def test_steps_that_no_standard_error_could_see_are_not_taken(model):
    data = measure(model.mesh, NeoHookean(E_TRUE, NU_TRUE), noise=3e-4, seed=9)
    parameters = [parameter(), Parameter("nu", "nu", 0.2, 0.0, 0.45, scale="linear")]
    fitted = calibrate(model, parameters, data, intervals=None)
    assert fitted.converged
    problem, settings = build_problem(model, parameters, data), CalibrationSettings()
    problem = problem.with_noise(fitted.noise)
    with Workers(model, len(data)) as workers:
        evaluator = Evaluator(problem, workers)
        state = initial_state(settings, evaluator.from_rest(fitted.z))
        settled = descend(evaluator, settings, state, lambda _: None)
    assert np.any(settled.z != fitted.z)
    for few, value in zip(
        fitted.parameters, problem.space.from_scaled(settled.z), strict=True
    ):
        assert abs(few.value - value) <= NOT_TAKEN * few.standard_error


@pytest.mark.slow  # noise_coverage records it
def test_standard_error_predicts_the_scatter_of_noisy_data(model):
    """Sixty noisy data sets: the scatter of E is what its standard error says."""
    sigma, estimates, errors = 5e-4, [], []
    for seed in range(60):
        data = measure(
            model.mesh, NeoHookean(E_TRUE, NU_TRUE), ("hang",), noise=sigma, seed=seed
        )
        result = calibrate(model, [parameter()], data)
        estimates.append(np.log(result.value("E")))
        errors.append(result.parameters[0].standard_error / result.value("E"))
    # The scatter of 60 draws has a standard error of 1 / sqrt(118) = 9 %: 3 of them.
    assert np.std(estimates, ddof=1) / np.mean(errors) == pytest.approx(1.0, abs=0.28)
    assert abs(np.mean(estimates) - np.log(E_TRUE)) < 3 * np.mean(errors) / np.sqrt(60)


def test_stated_noise_scales_the_standard_error(model):
    data = measure(model.mesh, NeoHookean(E_TRUE, NU_TRUE), noise=5e-4)
    stated = calibrate(model, [parameter()], data, noise="stated")
    estimated = calibrate(model, [parameter()], data, noise="estimated")
    W = stated.linear.whitened().W[:, 0]
    by_hand = stated.value("E") / np.sqrt(np.sum(W**2))
    assert stated.parameters[0].standard_error == pytest.approx(by_hand, rel=1e-9)
    ratio = estimated.parameters[0].standard_error / stated.parameters[0].standard_error
    dof = 3 * 3 * 3 - 1
    assert estimated.uncertainty.degrees_of_freedom == dof
    assert ratio == pytest.approx(np.sqrt(stated.uncertainty.chi_squared / dof))


def test_parameter_on_its_bound_has_no_standard_error(model, exact):
    result = calibrate(model, [parameter(1e5, 3e4, 1.2e5)], exact)
    assert result.value("E") == pytest.approx(1.2e5, rel=1e-9)
    assert result.parameters[0].at_bound
    assert np.isnan(result.parameters[0].standard_error)
    assert any("ended on a bound" in note for note in result.notes)


def test_unfinished_run_says_so(model, exact):
    settings = CalibrationSettings(max_steps=1)
    result = calibrate(model, [parameter()], exact, settings=settings)
    assert not result.converged
    assert any("Not converged" in note for note in result.notes)


def test_step_bound_is_kept_when_not_adapted(model, exact):
    settings = CalibrationSettings(step_bound=0.05, adapt=False, max_steps=30)
    result = calibrate(model, [parameter()], exact, settings=settings)
    sizes = [abs(entry.lambda_p[0]) for entry in result.history[1:]]
    assert result.converged
    np.testing.assert_allclose(sizes[:9], 0.05, rtol=1e-6)


def test_more_parameters_than_data_warns_and_says_what_is_missing(model, exact):
    data = [seen_by_one(exact[0].measured)]
    nu = Parameter("nu", "nu", 0.2, 0.0, 0.45, scale="linear")
    with pytest.warns(CalibrationWarning, match="2 parameters but only 1 measured"):
        result = calibrate(model, [parameter(), nu], data, validation=ALL_MARKERS)
    assert np.all(np.isfinite(result.z))
    assert np.isnan(result.parameters[0].standard_error)


def test_configuration_without_equilibrium_is_named(model):
    good = posed("hang", MARKERS.positions)
    with pytest.raises(RuntimeError, match="configuration 'crushed'") as error:
        calibrate(model, [parameter()], [good, CRUSHED])
    assert "hang" not in str(error.value)


def test_unmeasured_configuration_is_refused(model):
    with pytest.raises(ValueError, match=r"'hang'.*no measured"):
        calibrate(model, [parameter()], [posed("hang")])


def test_name_used_for_fit_and_validation_is_refused(model, exact):
    with pytest.raises(ValueError, match=r"'hang'.*more than once"):
        calibrate(model, [parameter()], exact[:1], validation=exact[:1])


def test_a_run_whose_steps_are_all_refused_is_not_converged(model, exact, monkeypatch):
    """No equilibrium beyond the start: the bound collapses where the slope is steep."""
    really = Evaluator.__call__

    def failed(self, *args):
        now = really(self, *args)
        return eqx.tree_at(lambda e: e.ok, now, jnp.zeros((), bool))

    monkeypatch.setattr(Evaluator, "__call__", failed)
    result = calibrate(model, parameter(), exact, noise="stated", intervals=None)
    assert not result.converged
    assert result.value("E") == pytest.approx(1e5)
    assert not any(entry.accepted for entry in result.history[1:])
    (note,) = [note for note in result.notes if "Not converged" in note]
    assert says(note, "refused")


def test_a_step_held_short_by_its_bound_is_no_convergence(model, exact):
    settings = CalibrationSettings()
    problem = build_problem(model, parameter(), exact)
    z = problem.space.start()
    evaluation = evaluate(problem, z)
    state = initial_state(settings, evaluation)
    held = eqx.tree_at(lambda s: s.step_bound, state, jnp.asarray(1e-7, float))
    proposal = propose(problem.space, settings, held)
    assert float(jnp.max(jnp.abs(proposal.qp.lambda_p))) <= settings.tol
    state = decide(problem.space, settings, held, proposal, evaluation)
    assert not bool(state.converged)


def test_blind_direction_is_left_alone(model):
    """Under gravity alone only E over density shows: neither may run away."""
    (hang,) = measure(model.mesh, NeoHookean(E_TRUE, NU_TRUE), ("hang",))
    tip = Markers(("a",), MARKERS.positions[:1])
    data = replace(hang, markers=tip, measured=hang.measured[:1])
    rho = Parameter("rho", "density", 1e3, 100.0, 1e4)
    result = calibrate(model, [parameter(), rho], data)
    assert result.converged
    assert result.configurations[0].rms_after < 1e-7
    # The shortest way to the valley E / rho = const shares the ratio evenly.
    ratio = np.sqrt(E_TRUE / 1e5)
    assert result.value("E") == pytest.approx(1e5 * ratio, rel=1e-2)
    assert result.value("rho") == pytest.approx(1e3 / ratio, rel=1e-2)
    assert says(result.notes, "cannot tell them apart")


def test_pose_that_the_model_cannot_explain_is_named(model, exact):
    strange = posed("push", exact[2].measured + np.array([0.0, 0.0, 0.03]))
    result = calibrate(model, parameter(), [exact[0], strange])
    assert any(doubt.startswith("push ") for doubt in result.doubts)


def test_held_out_poses_that_are_not_found_from_rest(model, exact):
    """One is found along its path; the other is none that the body can carry."""
    far = posed("hang", mesh_pull=2.0)
    far = replace(far, name="far", measured=_measured_of(model, far))
    few = NewtonSettings(max_steps=7)
    calibrated = calibrate(
        model,
        parameter(),
        exact[:2],
        validation=[exact[2], far, CRUSHED],
        newton=few,
        intervals=None,
    )
    assert calibrated.converged
    names = [fit.name for fit in calibrated.configurations]
    assert names == ["hang", "pull", "push", "far"]
    assert calibrated.configurations[-1].motion > 0.02
    assert calibrated.configurations[-1].rms_after < 1e-7
    (note,) = [note for note in calibrated.notes if "is not predicted" in note]
    assert note.startswith("crushed ")
    carried = re.search(r"carries at most ([\d.]+) %", note)
    assert carried is not None
    assert 0.0 < float(carried[1]) < 10.0


def _measured_of(model, pose):
    """Marker positions of a pose at the true modulus, by as many steps as it takes."""
    true = model.with_law(NeoHookean(E_TRUE, NU_TRUE))
    return simulated_measurements(true, [pose])[0].measured


def test_stated_noise_that_is_too_small_is_flagged(model):
    data = measure(model.mesh, NeoHookean(E_TRUE, NU_TRUE), noise=5e-3)
    result = calibrate(model, parameter(), data, noise="stated")
    assert says(result.doubts, "times what the stated errors explain")
    honest = measure(model.mesh, NeoHookean(E_TRUE, NU_TRUE), noise=1e-3)
    result = calibrate(model, parameter(), honest, noise="stated")
    assert result.notes == result.notes[:1]  # only the one on linear tets
    assert not result.doubts


def test_undetermined_parameters_are_named(model):
    data = seen_by_one(MARKERS.positions - [0.0, 0.0, 0.01])
    result = calibrate(model, parameter(), data, validation=ALL_MARKERS)
    assert result.converged
    assert np.isnan(result.parameters[0].standard_error)
    assert any("No standard error for E" in note for note in result.notes)
    assert any('noise = "stated"' in note for note in result.notes)


def test_poisson_ratio_that_may_lock_warns():
    mesh = beam(0.1, 0.02, 0.02, (3, 1, 1), order=2)
    model = build_model(mesh, NeoHookean(1e5, 0.3), density=1000.0)
    nu = Parameter("nu", "nu", 0.3, 0.0, 0.499, scale="linear")
    with pytest.warns(CalibrationWarning, match="may reach nu = 0.499, where"):
        build_problem(model, nu, posed("hang", MARKERS.positions))


def test_result_and_history_print_for_a_person(recovered):
    text = str(recovered)
    assert text.startswith("E = ")
    assert float(text.split()[2]) == pytest.approx(160.0, rel=1e-6)
    assert "Trust these values" in text
    assert "Held-out error of push: " in text
    assert str(recovered.history[0]).startswith("step 0: rms ")


# At the end, since what was traced before is forgotten.
def test_nothing_is_compiled_after_the_first_step(model, exact):
    """Nor for another shape of the body, start, bounds, names, data and tolerance.

    Another number of poses compiles what stacks them anew, but neither the equilibrium
    nor the QP.
    """
    law = NeoHookean(E_TRUE, NU_TRUE)
    longer = beam(0.11, 0.021, 0.02, (3, 1, 1))
    data = [replace(c, name=f"again {c.name}") for c in measure(longer, law)]
    jax.clear_caches()
    until = []
    with Compilations() as fresh:
        note = lambda entry: until.append(len(fresh.programs))
        # From a start of its own, of which no other test has left the response.
        own = parameter(1.1e5)
        calibrate(
            model,
            [own],
            exact[:2],
            validation=exact[2:],
            watch=only(HistoryEntry, note),
        )
    assert len(until) > 3
    assert fresh.programs.count("jit(equilibrium_response)") == 1
    assert fresh.programs.count("jit(_solved_each)") == 1
    # The last step, which is not taken, is told after the noise is estimated.
    assert set(until[1:-1]) == {until[1]}

    other = build_model(longer, NeoHookean(2e5, NU_TRUE), density=1100.0)
    softer = replace(parameter(8e4, 2e4, 9e5), name="softness")
    finer = NewtonSettings(rtol=1e-9)
    looser = CalibrationSettings(tol=1e-5, max_steps=60, step_bound=0.2)
    both = {"newton": finer, "settings": looser}
    with Compilations() as again:
        calibrate(other, [softer], data[:2], validation=data[2:], **both)
    assert again.programs == [], again.programs
    with Compilations() as more:
        calibrate(other, [softer], data)
    assert more.programs
    assert not {"jit(equilibrium_response)", "jit(_solved_each)"} & set(more.programs)
