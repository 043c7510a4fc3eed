"""Points of a sweep, and the names and seeds of trials."""

import numpy as np
import pytest

from softcal_jax.sweeps import Range, Trial, grid, sample

AXES = {"a": [1, 2, 3], "b": ["u", "v"]}


def test_grid_has_every_combination_the_last_axis_first():
    points = grid(AXES)
    assert len(points) == 6
    assert points[:3] == [
        {"a": 1, "b": "u"},
        {"a": 1, "b": "v"},
        {"a": 2, "b": "u"},
    ]


def test_sample_of_lists_takes_different_points_of_the_grid():
    whole, some = grid(AXES), sample(AXES, 4, seed=1)
    assert len(some) == 4
    assert all(point in whole for point in some)
    assert len({str(point) for point in some}) == 4
    assert [*some] == [*sample(AXES, 4, seed=1)]
    assert [*some] != [*sample(AXES, 4, seed=2)]


def test_sample_with_a_range_meets_each_part_of_it_once():
    axes = {"nu": Range(0.1, 0.5), "E": Range(1.0, 100.0, "log", "{:.9g} kPa"), **AXES}
    points = sample(axes, 12, seed=3)
    parts = sorted(int((p["nu"] - 0.1) / 0.4 * 12) for p in points)
    assert parts == list(range(12))
    decades = sorted(np.log10(float(p["E"].removesuffix(" kPa"))) for p in points)
    assert [int(6 * d) for d in decades] == list(range(12))
    # Latin hypercube: lists are met evenly too.
    assert sorted(p["b"] for p in points) == ["u"] * 6 + ["v"] * 6


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: grid({}), "at least one axis"),
        (lambda: grid({"a": []}), "axis 'a' .*no values"),
        (lambda: grid({"a": "uv"}), "axis 'a' .*got the text"),
        (lambda: grid({"a": Range(0, 1)}), "axis 'a' .*range.* sample = 100"),
        (lambda: sample(AXES, 7), "6 different points.* 7"),
        (lambda: sample(AXES, 0), "sample .*at least 1 .*got 0"),
        (lambda: Range(2.0, 1.0), "got 2.0 and 1.0"),
        (lambda: Range(0.0, 1.0, "log"), r"log scale .*positive.* 0\.0"),
    ],
)
def test_bad_points(call, message):
    with pytest.raises(ValueError, match=message):
        call()


def test_key_and_seed_depend_on_the_point_alone():
    one = Trial({"a": 1, "b": ["u", 2.0]})
    same = Trial({"b": ("u", np.float64(2.0)), "a": np.int64(1)})
    assert one.key == same.key
    assert one.seed == same.seed
    other = Trial({"a": 2, "b": ["u", 2.0]})
    assert other.key != one.key
    assert other.seed != one.seed
    # What trials share, like a draw of noise, is a matter of the axes that are named.
    assert one.seed_of("b") == other.seed_of("b") != one.seed_of("a")
    # Another sweep draws other numbers at the same point.
    again = Trial(one.point, sweep_seed=1)
    assert again.key == one.key
    assert again.seed != one.seed


def test_seeds_are_pinned():
    """Rows of earlier versions stay comparable: the derivation must not change."""
    trial = Trial({"a": 1, "b": "u"})
    assert trial.seed == 7775481122895314701


def test_bad_values_and_axes():
    for value, shown in ((float("nan"), "nan"), ({}, r"\{\}")):
        with pytest.raises(ValueError, match=rf"axis 'a' .* {shown}; .*text"):
            Trial({"a": value})
    with pytest.raises(ValueError, match=r"axis 'c'.* Known: 'a'"):
        Trial({"a": 1})["c"]
