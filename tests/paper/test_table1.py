"""Table I: the orderings of its condition numbers, and what breaks without data."""

import numpy as np
import pytest
from wording import says

from benchmarks import paper_table1
from benchmarks.paper_table1 import FOUR, Design, broken_orderings, designs

CELLS = (6, 2, 2)


@pytest.mark.slow  # paper_table1 records them
@pytest.mark.parametrize("plane", ["xy", "xz"])
def test_orderings_of_the_paper(plane):
    numbers = paper_table1.condition_numbers(CELLS, plane)
    assert broken_orderings(numbers, FOUR) == []
    of_table = np.array([numbers[d] for d in designs((FOUR, "all"))])
    assert np.all((of_table > 10.0) & (of_table < 2000.0))


def test_names_of_the_figures():
    names = [design.figure for design in designs((FOUR, "all"))]
    assert names == [
        f"cond_p{p}_e{e}_c{c}" for p in (4, 6) for e in (1, 4) for c in (3, 4, 6)
    ]


def test_a_broken_ordering_is_named():
    numbers = {
        Design(f, e, c): 1000.0 * (f == "all") + 100.0 * (e == 1) + 30.0 / (c - 2)
        for f in (FOUR, "all")
        for e in (1, 4)
        for c in (3, 4, 6)
    }
    assert broken_orderings(numbers, FOUR) == []
    swapped = Design(FOUR, 1, 3), Design(FOUR, 4, 3)
    numbers |= dict(zip(swapped, [numbers[d] for d in swapped[::-1]], strict=True))
    worst, fourth, more = broken_orderings(numbers, FOUR)
    assert says(worst, "4 parameters, 1 effectors ... 3 ... worst")
    assert says(fourth, "4 parameters, 1 effectors ... 4th ... most")
    assert says(more, "4 parameters, 3 configurations ... 4 effectors")


@pytest.mark.slow
@pytest.mark.parametrize("paper", [True, False], ids=["the paper's loop", "ours"])
def test_calibrations_of_the_best_designs_converge(paper):
    wanted = [Design(FOUR, 4, 6), Design("all", 4, 6)]
    courses = paper_table1.calibrations((4, 1, 1), "xy", paper, wanted)
    assert all(course.startswith("converged") for course in courses.values()), courses
