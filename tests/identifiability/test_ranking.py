"""Gains of candidates against their formulas, and against `identify`."""

from dataclasses import replace
from functools import partial

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
from softcal_jax.configurations import Configuration, Support
from softcal_jax.fields import exactly_known
from softcal_jax.identifiability import (
    identify as identify_with,
    rank_configurations as rank_with,
)

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


def test_gains_are_those_of_the_formulas(ranking, information):
    """In units of what is asked: D = ln det(M + J) - ln det M, E by the eigenvalues.

    Ten times the asked error stands for knowing nothing.
    """
    M = np.eye(2) / 10.0**2 + ASKED**2 * information["near"]
    for gain in ranking.gains:
        more = M + ASKED**2 * information[gain.name]
        D = np.linalg.slogdet(more)[1] - np.linalg.slogdet(M)[1]
        E = np.linalg.eigvalsh(more)[0] - np.linalg.eigvalsh(M)[0]
        np.testing.assert_allclose(gain.d_gain, D, rtol=1e-6)
        np.testing.assert_allclose(gain.e_gain, E, rtol=1e-5, atol=1e-9)
        shrink = np.sqrt(np.linalg.det(M) / np.linalg.det(more))
        np.testing.assert_allclose(gain.volume, shrink, rtol=1e-6)
        old, new = (np.sqrt(np.diag(np.linalg.inv(A))) for A in (M, more))
        best = SPACE.names.index(gain.parameter)
        assert best == np.argmax(old - new)
        # Logarithms of moduli of 1e5 Pa, without what stands for knowing nothing.
        data = information["near"], information["near"] + information[gain.name]
        old, new = (1e5 * np.sqrt(np.diag(np.linalg.inv(A))) for A in data)
        np.testing.assert_allclose(gain.before, old[best], rtol=1e-4)
        np.testing.assert_allclose(gain.after, new[best], rtol=1e-4)
        variance, V = np.linalg.eigh(np.linalg.inv(data[1]))
        worst = np.sqrt(variance) * np.max(np.abs(V), axis=0)
        assert gain.blind_left == np.sum(worst > 3.0 * ASKED)


def test_order_is_that_of_the_gain(ranking):
    gains = [gain.d_gain for gain in ranking.gains]
    assert gains == sorted(gains, reverse=True)
    assert [gain.name for gain in ranking.gains[::3]] == ["swap", "near again"]
    assert ranking.gains[0].parameter == "E of tip"
    assert (ranking.blind_before, ranking.gains[0].blind_left) == (1, 0)


def test_what_shrinks_most_need_not_shrink_the_worst():
    """A very fine marker near the clamp: first by volume, no help for the tip."""
    fine = pose("fine", ROOT, std=2e-6)
    first, second = rank_configurations(
        two_part_beam(), SPACE, NEAR, [SWAP, fine]
    ).gains
    assert (first.name, second.name) == ("fine", "swap")
    assert first.d_gain > second.d_gain
    assert first.e_gain < second.e_gain
    assert (first.blind_left, second.blind_left) == (1, 0)


def test_a_candidate_that_cannot_be_judged_is_named_with_its_reason(ranking):
    reasons = {u.name: u.reason for u in ranking.unranked}
    assert set(reasons) == {"crushed", "bare"}
    assert "no markers" in reasons["bare"]
    assert "equilibrium" in reasons["crushed"] or "load" in reasons["crushed"]
    assert len(ranking.gains) == 4


def test_text(ranking):
    lines = str(ranking).splitlines()
    assert says(lines[0], "'swap'", "E of tip")
    assert [line.split()[0] for line in lines[2:4]] == ["swap", "pull"]
    assert says(lines[6], "1 of 2 directions", "blind", "target standard error")
    assert sum(line.startswith("Not ranked") for line in lines) == 2
    assert "nan" not in str(ranking)


def test_a_repetition_in_words():
    """A pose that is known well: a second look at it changes hardly anything."""
    model = two_part_beam()
    known = [pose("a", TIP, std=1e-5), pose("b", SWAP.markers.positions, clamp="x_max")]
    worse = pose("c", TIP, std=1e-3)
    ranked = rank_configurations(model, SPACE, known, worse)
    assert says(ranked.gains[0].words, "hardly")


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
    assert ranked.gains[0].d_gain < 0.0
    assert says(ranked.headline, "No candidate", "held fixed")
    blind = replace(ranked, blind_before=1).headline
    assert says(blind, "held fixed", "fewer parameters")
    assert says(ranked, "D gain below 0", "noise")


def test_with_nothing_known_a_candidate_gives_its_own_verdict():
    model = two_part_beam()
    ranked = rank_configurations(model, SPACE, (), PULL)
    alone = identify(model, SPACE, PULL)
    index = SPACE.names.index(ranked.gains[0].parameter)
    np.testing.assert_allclose(
        ranked.gains[0].after, alone.parameters[index].standard_error, rtol=1e-9
    )
    assert ranked.gains[0].before == np.inf
    assert says(ranked.gains[0].words, "direction that was blind", "E of", "blind to")
    assert ranked.blind_before == 2


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
    assert ranked.n_parameters == 2
