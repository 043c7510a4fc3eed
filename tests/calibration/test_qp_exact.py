"""The QP of a step against an exact solver, on random problems of many kinds."""

import numpy as np
import pytest
from qp_families import FAMILIES, cost, exact_step, problems, steps, violation

OF_SIX = [name for name in FAMILIES if not name.endswith(("parameter", "parameters"))]
"""Families of one shape, so that one compiled program serves them."""


def check(family, count):
    """Every step keeps its limits and costs what the exact one costs."""
    drawn = problems(family, count)
    solutions, kkt, _ = steps(drawn)
    for k, (problem, step) in enumerate(zip(drawn, solutions, strict=True)):
        exact = cost(problem, exact_step(problem))
        scale = exact + 0.5 * np.sum(problem.error**2)
        np.testing.assert_allclose(
            cost(problem, step), exact, rtol=0, atol=1e-8 * scale, err_msg=f"number {k}"
        )
        assert violation(problem, step) < 1e-12, f"number {k}"
        assert kkt[k] < 1e-9, f"number {k}"


@pytest.mark.parametrize("family", OF_SIX)
def test_step_costs_what_the_exact_one_costs(family):
    check(family, 20)


@pytest.mark.slow
@pytest.mark.parametrize("family", FAMILIES)
def test_step_costs_what_the_exact_one_costs_in_a_hundred_problems(family):
    check(family, 100)
