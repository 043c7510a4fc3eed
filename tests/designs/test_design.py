"""Designs of a small finger under a cable: goals, limits, foam and prints."""

from dataclasses import replace
from functools import partial
from types import SimpleNamespace
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import foldnorm
from watching import only
from wording import says

from softcal_jax.actuators import Cable
from softcal_jax.calibration import build_problem, evaluate
from softcal_jax.configurations import (
    Configuration,
    ImposedForce,
    Markers,
    configuration_arrays,
)
from softcal_jax.control import Limits
from softcal_jax.designs import (
    Change,
    DesignResult,
    Peak,
    Printing,
    design,
    published_foam,
)
from softcal_jax.equilibrium import build_model, marker_positions, solve_equilibrium
from softcal_jax.fields import (
    ControlPointParameters,
    ControlPoints,
    ParameterSpace,
    command,
)
from softcal_jax.materials import Corotational, Fibre, ReducedTransverseIsotropic
from softcal_jax.mesh import beam
from softcal_jax.results import headline

LENGTH, SIDE = 0.1, 0.02
MIDDLE = SIDE / 2
TIP = (LENGTH, MIDDLE, MIDDLE)
HALF = (LENGTH / 2, MIDDLE, MIDDLE)
RANGE = {"cable": Limits(force=(0.0, 5.0))}
TOLERANCE = 1e-4


def finger():
    law = ReducedTransverseIsotropic(4e5, 3e5, 0.3, Fibre(0.0, plane="xy"))
    guides = [(x, MIDDLE, 0.002) for x in (0.0, LENGTH / 2, LENGTH)]
    mesh = beam(LENGTH, SIDE, SIDE, (4, 1, 1))
    cable = Cable("cable", guides)
    return build_model(mesh, Corotational(law), density=1000.0, actuators=[cable])


MODEL = finger()
POINTS = ControlPoints({"root": (0.0, MIDDLE, MIDDLE), "tip": TIP})


def moduli():
    """E_t and E_l at the control points; the foam says which of them is larger."""
    options: dict[str, Any] = {"interpolation": "log", "unit": "Pa"}
    return ParameterSpace(
        [
            ControlPointParameters("E_t", POINTS, 4e5, 1e5, 5e6, **options),
            ControlPointParameters("E_l", POINTS, 3e5, 5e4, 3e6, **options),
        ]
    )


MARKERS = Markers(["half", "end"], [HALF, TIP], std=TOLERANCE, axes="xz")


def pose(name, tension, goal=None, markers=MARKERS):
    goal = None if goal is None else np.asarray(goal)
    return Configuration(
        name,
        ["x_min"],
        gravity=(0.0, 0.0, 0.0),
        markers=markers,
        measured=goal,
        actuation={"cable": ImposedForce(tension)},
    )


def simulated(model, configuration):
    """Where the markers are, solved without any of the design."""
    lane = configuration_arrays(model.mesh, [configuration], model.mechanism)[0]
    return np.asarray(marker_positions(model, lane, solve_equilibrium(model, lane)))


@pytest.fixture(scope="module")
def wanted():
    """Two shapes that a graded finger takes."""
    true = np.log([9e5, 3e5, 2.5e5, 1.5e5])
    model = moduli().model_at(MODEL, jnp.asarray(true))
    shapes = [("little", 0.4), ("much", 1.0)]
    return [pose(n, 0.7, simulated(model, pose(n, T))) for n, T in shapes]


@pytest.fixture
def uncompared(monkeypatch):
    """Without the fits that a design is compared with."""
    monkeypatch.setattr("softcal_jax.designs._design._alternatives", lambda *_: [])


@pytest.fixture(scope="module")
def answers():
    """What a design says before it is compared with anything."""
    return []


@pytest.fixture(scope="module")
def made(wanted, answers):
    return design(
        MODEL,
        moduli(),
        wanted,
        limits=RANGE,
        foam=published_foam(),
        starts=1,
        watch=only(DesignResult, answers.append),
    )


@pytest.mark.slow
def test_what_a_graded_finger_can_do_is_designed(made, wanted):
    assert made.met
    assert headline(made).startswith("Designed: all 4")
    assert "off by" not in str(made).partition("Goals")[0]
    # Forces of the cable follow the scale of the moduli, which the goals leave open.
    tensions = [c.actuation["cable"].value for c in made.configurations]
    assert tensions[1] / tensions[0] == pytest.approx(2.5, rel=0.02)
    model = made.fit.space.model_at(MODEL, jnp.asarray(made.fit.z))
    for goal, commanded in zip(wanted, made.configurations, strict=True):
        off = simulated(model, commanded) - goal.measured
        assert np.abs(off[:, [0, 2]]).max() < TOLERANCE
    assert [goal.error < 2e-4 for goal in made.goals] == [True] * 4


def test_every_tet_is_a_foam(made):
    model = made.fit.space.model_at(MODEL, jnp.asarray(made.fit.z))
    law = model.law.elasticity
    found = published_foam().find(np.asarray(law.E_l), np.asarray(law.E_t))
    assert found.error.max() < 1e-6


def test_the_answer_comes_before_what_it_is_compared_with(made, answers):
    (answer,) = answers
    assert answer.alternatives == ()
    assert headline(answer) == headline(made)


def test_what_less_could_do(made):
    """One material does better than the cable alone, and the design best."""
    homogeneous, alone = made.alternatives
    assert homogeneous.name == "the best homogeneous material"
    assert alone.name == "actuation alone"
    assert made.error < 0.2 * homogeneous.error
    assert homogeneous.error <= alone.error * (1.0 + 1e-6)
    assert says(str(made), "homogeneous", "tolerances off", "with this design")
    unfinished = replace(homogeneous, result=replace(made.fit, converged=False))
    again = replace(made, alternatives=(unfinished,))
    assert says(str(again), "homogeneous", "or less", "did not converge")


@pytest.mark.usefixtures("uncompared")
def test_a_limit_holds_a_goal(wanted):
    """The cable may pull a third as much as it takes at its softest."""
    goals = [replace(goal, actuation={"cable": ImposedForce(0.1)}) for goal in wanted]
    tight = {"cable": Limits(force=(0.0, 0.15))}
    made = design(MODEL, moduli(), goals, limits=tight, foam=published_foam(), starts=1)
    assert not made.met
    assert says(headline(made), "Not designed", "goals are missed")
    assert says(made.held_by, "cable in much at its upper limit")
    assert says(made.held_by, "what Polyfoam reaches of E_l of root and E_t of root")
    assert says(str(made), "'end' in 'much' is off by", "mm")


@pytest.mark.slow
@pytest.mark.usefixtures("uncompared")
def test_two_goals_compete():
    """Under one tension the tip cannot be in two places; both give way alike."""
    end = Markers(["end"], [TIP], std=TOLERANCE, axes="z")
    goals = [
        pose(name, 0.5, [np.array(TIP) - [0.0, 0.0, down]], end)
        for name, down in (("here", 0.004), ("there", 0.008))
    ]
    made = design(MODEL, moduli(), goals, starts=1)
    offs = [float(goal.effector.residual[2]) for goal in made.goals]
    assert offs == pytest.approx([-0.002, 0.002], rel=0.02)
    assert [trade.loss for trade in made.trades] == pytest.approx([1.0, 1.0], rel=0.05)
    assert says(str(made), "'end' in 'here' competes with 'end' in 'there'")
    # An error of one coordinate is a folded normal distribution.
    for goal in made.goals:
        off = abs(float(goal.effector.residual[2]))
        std = np.sqrt(goal.expected**2 - off**2)
        ends = foldnorm(off / std, scale=std).ppf([0.025, 0.975])
        np.testing.assert_allclose(goal.interval, ends, rtol=0.1)


@pytest.mark.usefixtures("uncompared")
def test_a_change_that_costs(wanted, made):
    """Control points become alike as far as the tolerances allow, and say the balance.

    At the minimum the differences hold what the goals pull at: W^T r + A^T d = 0.
    """
    alike = design(MODEL, moduli(), wanted, limits=RANGE, change=Change(0.1), starts=1)
    graded = lambda of: np.log(of.fit.value("E_t of root") / of.fit.value("E_t of tip"))
    assert 0.0 < graded(alike) < 0.2 * graded(made)
    assert alike.error > made.error
    d, A = alike.fit.space.likeness.rows(jnp.asarray(alike.fit.z))
    assert float(d[0]) == pytest.approx(graded(alike) / 0.1)
    W, r = [], []
    poses = {pose.name: pose for pose in alike.fit.configurations}
    for goal in alike.goals:
        e = goal.effector
        rows = poses[goal.configuration].W_ep[e.index, : len(e.std)][e.seen]
        W.append(rows / TOLERANCE)
        r.append(goal.effector.residual[e.seen] / TOLERANCE)
    W, r = np.concatenate(W), np.concatenate(r)
    slope = W.T @ r + np.asarray(A).T @ np.asarray(d)
    assert np.all(np.abs(slope) < 1e-2 * (np.abs(W).T @ np.abs(r)))


def test_actuation_alone(wanted):
    """Without parameters only the cable is found, and there is nothing to compare."""
    model = moduli().model_at(MODEL, moduli().start())
    made = design(model, None, wanted, limits=RANGE, starts=1)
    assert made.material == ()
    assert made.alternatives == ()
    assert [p.name for p in made.fit.parameters] == ["cable in little", "cable in much"]
    assert not any(goal.hangs_on for goal in made.goals)


def test_prints_scatter_as_the_goals_say(made, wanted):
    """Random prints, each solved again: as many in the intervals as they say."""
    std = Printing().deviations(made.fit)
    assert std.tolist() == [0.3] * 4 + [0.0] * 2
    problem, z = build_problem(MODEL, made.fit.space, wanted), np.asarray(made.fit.z)
    guess = evaluate(problem, jnp.asarray(z)).equilibrium.displacement
    random, inside, squares = np.random.default_rng(3), [], []
    index = {goal.name: i for i, goal in enumerate(wanted)}
    for _ in range(30):
        print_ = z + std * random.standard_normal(len(z))
        off = np.asarray(evaluate(problem, jnp.asarray(print_), guess).delta_e)
        rows = [off[index[g.configuration], g.effector.index] for g in made.goals]
        errors = [
            np.linalg.norm(row[g.effector.seen])
            for row, g in zip(rows, made.goals, strict=True)
        ]
        ends = np.array([g.interval for g in made.goals])
        inside.append((ends[:, 0] <= errors) & (errors <= ends[:, 1]))
        squares.append(np.square(errors))
    assert 0.88 < np.mean(inside) <= 1.0
    expected = [g.expected for g in made.goals]
    np.testing.assert_allclose(np.sqrt(np.mean(squares, axis=0)), expected, rtol=0.4)


def test_derivatives_by_material_and_actuation_are_of_second_order(wanted):
    """Central differences: halving the step divides the error by four."""
    pull = command(
        "cable",
        {"little": 0.4, "much": 0.9},
        dict.fromkeys(("little", "much"), (0.0, 5.0)),
        unit="N",
    )
    space = ParameterSpace((*moduli().entries, pull))
    problem, z = build_problem(MODEL, space, wanted), np.asarray(space.start())
    here = evaluate(problem, jnp.asarray(z))
    W = np.asarray(here.response.W_ep).reshape(*here.delta_e.shape, len(z))
    guess, errors = here.equilibrium.displacement, []
    at = lambda shift: np.asarray(
        evaluate(problem, jnp.asarray(z + shift), guess).delta_e
    )
    direction = np.array([0.3, -0.5, 0.2, 0.4, 0.1, -0.2])
    for h in (0.2, 0.1):
        slope = (at(h * direction) - at(-h * direction)) / (2.0 * h)
        errors.append(np.abs(slope - W @ direction)[..., [0, 2]].max())
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2.0, abs=0.1)


@pytest.mark.parametrize("step", [0, 1])
@pytest.mark.parametrize("fits", [1, 2])
def test_an_interrupted_design_is_compared_with_nothing(
    made, wanted, monkeypatch, fits, step
):
    """Ctrl-C ends the search with what it has, or the comparison without any."""
    stopped = replace(made.fit, interrupted=True) if step else KeyboardInterrupt
    left = iter([made.fit, stopped][2 - fits :])
    monkeypatch.setattr("softcal_jax.designs._design.fit_problem", next_of(left))
    asked = partial(design, MODEL, moduli(), wanted, limits=RANGE)
    if fits == 1 and step == 0:  # there is no design yet
        with pytest.raises(KeyboardInterrupt):
            asked(foam=published_foam())
        return
    again = asked(foam=published_foam())
    assert again.alternatives == ()
    assert again.met
    assert again.fit.interrupted
    assert next(left, None) is None


def next_of(left):
    """Fits in turn, or what ends one before its first step."""

    def fit(*_, **__):
        result = next(left)
        if result is KeyboardInterrupt:
            raise result
        return SimpleNamespace(result=result)

    return fit


@pytest.mark.parametrize("part", ["specimens", "tighter"])
def test_what_is_interrupted_later_keeps_the_design(made, wanted, monkeypatch, part):
    """The least error over prints, and the fit that keeps a largest stretch better."""
    left = iter([made.fit, KeyboardInterrupt])
    monkeypatch.setattr("softcal_jax.designs._design.fit_problem", next_of(left))
    passed = Peak("stretch", "little", 1.2, 1.1, "")
    if part == "tighter":
        monkeypatch.setattr("softcal_jax.designs._design.peaks", lambda *_: (passed,))
    robust = part == "specimens"
    again = design(MODEL, moduli(), wanted, limits=RANGE, robust=robust)
    assert again.fit.interrupted
    assert again.alternatives == ()
    assert not again.met
    assert next(left, None) is None
