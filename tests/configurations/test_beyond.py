"""What a pose does that no fitted one does."""

import pytest

from softcal_jax.configurations import (
    Configuration,
    ImposedDisplacement,
    ImposedForce,
    PointForce,
    SurfaceForce,
    beyond,
)

PULL, TIP = ImposedForce(2.0), SurfaceForce("tip", (0.0, 0.0, -1.0))
FITTED = (
    Configuration("a", "x_min", actuation={"left": PULL}),
    Configuration("b", "x_min", actuation={"right": PULL}),
    Configuration("c", "x_min", loads=TIP),
    Configuration("d", "x_min"),
)


@pytest.mark.parametrize(
    ("loads", "actuation", "words"),
    [
        ((), {}, ""),
        (TIP, {}, ""),
        ((), {"left": ImposedForce(1.0)}, ""),
        ((), {"left": ImposedForce(3.0)}, "left is 1.5 times the largest fitted"),
        ((), {"left": ImposedForce(-1.0)}, "left acts the other way round"),
        ((), {"left": ImposedDisplacement(5e-3)}, ""),  # not to be compared
        ((), {"top": PULL}, "top acts in no fitted pose"),
        ((), {"left": PULL, "right": PULL}, "left with right, only fitted apart"),
        (TIP, {"left": PULL}, "a load on tip with left, only fitted apart"),
        (SurfaceForce("tip", (0.0, 2.0, 0.0)), {}, "a load on tip is 2 times"),
        (PointForce((0.0, 0.0, 0.0), (1.0, 0.0, 0.0)), {}, "a load acts in no fitted"),
        (SurfaceForce("tip", (0.0, 1.0, 0.0), name="w"), {}, "w acts in no fitted"),
    ],
)
def test_in_words(loads, actuation, words):
    pose = Configuration("e", "x_min", loads=loads, actuation=actuation)
    text = beyond(FITTED, pose)
    assert words in text
    assert bool(text) == bool(words)


def test_two_that_were_fitted_together_are_not_apart():
    both = Configuration("both", "x_min", actuation={"left": PULL, "right": PULL})
    assert beyond((*FITTED, both), both) == ""
