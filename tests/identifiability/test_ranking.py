"""Gains of candidates against their formulas, and against `identify`."""

from dataclasses import replace
from functools import partial

import cable_project
import equinox as eqx
import numpy as np
import pytest
from two_part_beam import (
    HANG,
    NEAR,
    PULL,
    ROOT,
    SPACE,
    SWAP,
    TIP,
    crushed,
    pose,
    two_part_beam,
)
from wording import says

from softcal_jax.calibration import build_problem, evaluate
from softcal_jax.configurations import Configuration, PointForce, Support
from softcal_jax.fields import exactly_known
from softcal_jax.identifiability import (
    identify as identify_with,
    proposals,
    rank_configurations as rank_with,
)
from softcal_jax.results import headline

KNOWN = {"uncertain": exactly_known()}
identify = partial(identify_with, **KNOWN)
rank_configurations = partial(rank_with, **KNOWN)

BARE = Configuration("bare", (Support("x_min"),))
AGAIN = pose("near again", ROOT)
CANDIDATES = (AGAIN, HANG, crushed(), PULL, SWAP, BARE)
ASKED = 0.1
"""Standard error asked for, of the logarithm of a modulus."""


@pytest.fixture(scope="module")
def information():
    """W^T W of each pose, from the compliances of a calibration."""
    # Two markers of the last one make the program that of other fits.
    poses = (NEAR, AGAIN, HANG, PULL, SWAP, pose("two", ROOT + TIP))
    posed = [
        eqx.tree_at(
            lambda c: c.measured, c, c.markers.positions, is_leaf=lambda v: v is None
        )
        for c in poses
    ]
    problem = build_problem(two_part_beam(), SPACE, posed)
    evaluation = evaluate(problem, SPACE.start())
    W = np.asarray(evaluation.rows.W)[:-2].reshape(len(poses), -1, 2)
    return {c.name: w.T @ w for c, w in zip(poses, W, strict=True)}


@pytest.fixture(scope="module")
def ranking():
    return rank_configurations(two_part_beam(), SPACE, NEAR, CANDIDATES)


def test_errors_are_those_of_the_information(ranking, information):
    """Errors by the inverse of G^T G, in units of what is asked; squares are summed."""
    root_of = lambda A: np.sqrt(np.diag(np.linalg.inv(A))) / ASKED
    for gain in ranking.gains:
        after = root_of(information["near"] + information[gain.name])
        np.testing.assert_allclose(gain.errors, after, rtol=1e-4)
        before = root_of(information["near"])
        np.testing.assert_allclose(gain.cost, (0, np.sum(after**2)), rtol=1e-4)
        best = int(np.argmax(before - after))
        assert gain.parameter == SPACE.names[best]
        # Logarithms of moduli of 1e5 Pa.
        ends = [1e5 * ASKED * error[best] for error in (before, after)]
        np.testing.assert_allclose([gain.before, gain.after], ends, rtol=1e-4)


def test_the_first_leaves_the_smallest_errors(ranking):
    costs = [gain.cost for gain in ranking.gains]
    assert costs == sorted(costs)
    assert [gain.name for gain in ranking.gains[::3]] == ["swap", "near again"]
    assert ranking.gains[0].parameter == "E of tip"


def test_the_fewest_that_reach_a_target():
    """One for a rough target, two for a finer one, then readings, then nothing."""
    rank = partial(rank_configurations, two_part_beam(), SPACE, NEAR, [SWAP, PULL])
    ranked = rank()
    errors = {gain.name: float(np.max(gain.errors)) for gain in ranked.gains}
    at = lambda factor: f"{rank(precision=factor * ASKED * errors['swap']).reached}"
    assert says(at(1.01), "Fewest that reach", "swap; expected error of E of")
    assert says(at(0.1), "No 4 candidates reach", "swap and pull", "readings", "noise")
    unsure = replace(exactly_known(), loads=0.5, density=0.5)
    held = rank_with(two_part_beam(), SPACE, NEAR, [PULL], uncertain=unsure)
    assert says(held.reached, "Nothing in reach gives 10 %", "held fixed")
    everything = rank(precision=1e3).reached
    assert says(everything, "The poses that are there reach")


def test_a_candidate_that_cannot_be_judged_is_named_with_its_reason(ranking):
    reasons = ranking.unranked
    assert set(reasons) == {"crushed", "bare"}
    assert "no markers" in reasons["bare"]
    assert "equilibrium" in reasons["crushed"] or "load" in reasons["crushed"]
    assert len(ranking.gains) == 4


def test_text(ranking):
    lines = str(ranking).splitlines()
    assert says(lines[0], "'swap' tells most: expected error of E of tip", "blind ->")
    rows = [line.split()[0] for line in lines if "expected error" in line]
    assert rows[1:3] == ["swap", "pull"]
    assert sum(line.startswith("Not ranked") for line in lines) == 2
    assert "nan" not in str(ranking)


def test_a_candidate_that_passes_on_more_error_than_it_tells():
    """Very fine readings of a pose whose load is hardly known outweigh the others.

    The fit weighs readings by their noise alone, so it follows the load.
    """
    model = two_part_beam()
    other_end = pose("b", SWAP.markers.positions, clamp="x_max", std=1e-4)
    known = [pose("a", TIP, std=1e-4), other_end]
    unsure = replace(exactly_known(), loads=0.5)
    fine = replace(pose("fine", TIP, std=1e-5), loads=PULL.loads)
    ranked = rank_with(model, SPACE, known, [fine], uncertain=unsure)
    assert says(headline(ranked), "No candidate", "held fixed")


def test_with_nothing_known_a_candidate_gives_its_own_verdict():
    model = two_part_beam()
    ranked = rank_configurations(model, SPACE, (), PULL)
    alone = identify(model, SPACE, PULL)
    index = SPACE.names.index(ranked.gains[0].parameter)
    np.testing.assert_allclose(
        ranked.gains[0].after, alone.parameters[index].standard_error, rtol=1e-9
    )
    assert ranked.gains[0].before == np.inf
    assert says(ranked.gains[0].effect, "expected error of E of", "blind ->")


def test_wrong_calls():
    rank = partial(rank_configurations, two_part_beam(), SPACE)
    with pytest.raises(ValueError, match="at least one candidate"):
        rank(HANG, ())
    with pytest.raises(ValueError, match=r"'hang'.*more than once"):
        rank(HANG, [HANG])
    with pytest.raises(RuntimeError, match="configuration 'crushed'"):
        rank(crushed(), HANG)


def test_a_candidate_cannot_tell_what_all_poses_share():
    """However many poses hang under their weight: its error stays in the moduli."""
    share = 0.05
    heavy = replace(exactly_known(), density=share)
    ranked = rank_with(two_part_beam(), SPACE, HANG, [SWAP], uncertain=heavy)
    (gain,) = ranked.gains
    (exact,) = rank_configurations(two_part_beam(), SPACE, HANG, [SWAP]).gains
    assert gain.after > 0.99 * share * gain.value > exact.after


def test_proposals_leave_out_what_is_there():
    """Five other directions of gravity, the other end, a weight at the tip, again."""
    proposed = [*proposals(two_part_beam(), [HANG, NEAR])]
    assert [c.name for c in proposed] == [
        "hang again",
        *[f"gravity along {axis}" for axis in ("-x", "-y", "+x", "+y", "+z")],
        "the other end held",
        "200 mN at m0",  # half of 40 ml of water is 0.196 N
    ]
    end, weight = proposed[-2:]
    points = two_part_beam().mesh.points[end.supports[0].where]
    assert np.all(points[:, 0] == 0.1)
    (load,) = [load for load in weight.loads if isinstance(load, PointForce)]
    np.testing.assert_allclose(load.force, (0.0, 0.0, -0.2))
    np.testing.assert_allclose(load.point, TIP[0], atol=1e-12)
    assert [*proposals(two_part_beam(), [BARE])] == []


def test_proposals_of_a_robot_with_a_cable():
    poses = [p for p in cable_project.poses() if p.name != "wound up"]
    proposed = {c.name: c for c in proposals(cable_project.cable_beam(), poses)}
    assert proposed["cable 750 mN"].actuation["cable"].value == 0.75
    assert "cable 1.5 N" not in proposed  # that is measured
    assert "the other end held" not in proposed  # it is a rigid body
