"""A property that is computed once belongs to one object, and to no trace."""

import pickle

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from softcal_jax.fields._parameters import once

CALLS = []


class Scaled(eqx.Module):
    """Counts how often it computes."""

    value: Float[Array, ""]

    @once
    def twice(self):
        """Its double."""
        CALLS.append("twice")
        return (2.0 * self.value,)


def test_it_is_computed_once_for_each_object():
    CALLS.clear()
    one = Scaled(jnp.asarray(1.5, float))
    assert [float(one.twice[0]) for _ in range(3)] == [3.0] * 3
    assert len(CALLS) == 1
    assert Scaled.twice.__doc__ == "Its double."
    other = eqx.tree_at(lambda m: m.value, one, jnp.asarray(4.0, float))
    assert float(other.twice[0]) == 8.0
    assert len(jax.tree.leaves(one)) == 1
    assert float(pickle.loads(pickle.dumps(one)).twice[0]) == 3.0


def test_what_is_traced_is_not_kept():
    """Neither that of a traced object, nor what a trace makes of a concrete one."""
    one = Scaled(jnp.asarray(1.5, float))
    with jax.checking_leaks():
        inside = jax.jit(lambda scaled: scaled.twice[0] + one.twice[0])(one)
    assert float(inside) == 6.0
    assert "twice" not in vars(one)
    np.testing.assert_array_equal(one.twice[0], 3.0)
    assert "twice" in vars(one)
