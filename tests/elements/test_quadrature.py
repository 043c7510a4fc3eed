from itertools import product
from math import factorial, prod

import numpy as np
import pytest

from softcal_jax.elements import tet_rule, triangle_rule

RULES = {3: triangle_rule, 4: tet_rule}


def exact_mean(powers):
    """Mean of a monomial of barycentric coordinates over a simplex (Stroud 1971)."""
    d = len(powers) - 1
    return factorial(d) * prod(map(factorial, powers)) / factorial(sum(powers) + d)


def worst_error(rule, total):
    """Largest error over the monomials of one total degree."""
    n = rule.barycentric.shape[1]
    return max(
        abs(
            rule.weights @ np.prod(rule.barycentric ** np.array(p), axis=1)
            - exact_mean(p)
        )
        for p in product(range(total + 1), repeat=n)
        if sum(p) == total
    )


@pytest.mark.parametrize("n_corners", [3, 4])
@pytest.mark.parametrize("degree", [1, 2, 3, 4])
def test_exact_up_to_the_degree_and_not_beyond(n_corners, degree):
    rule = RULES[n_corners](degree)
    np.testing.assert_allclose(rule.barycentric.sum(axis=1), 1.0, rtol=1e-14)
    # Abscissae are kept to 15 digits.
    assert max(worst_error(rule, k) for k in range(degree + 1)) < 1e-14
    assert worst_error(rule, 5) > 1e-5


@pytest.mark.parametrize("rule", [tet_rule, triangle_rule])
@pytest.mark.parametrize("degree", [0, 5])
def test_degree_that_is_not_kept(rule, degree):
    with pytest.raises(ValueError, match=f"degree 1 to 4, got {degree}"):
        rule(degree)
