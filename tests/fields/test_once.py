"""What a space of parameters computes once belongs to it, and to no trace."""

import pickle

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax.fields import Parameter, ParameterSpace
from softcal_jax.robots import anisotropic_beam


def test_it_is_computed_once_for_each_space():
    one = ParameterSpace([Parameter("E", "E", 2e5, 1e5, 1e6)])
    leaves = jax.tree.leaves(one)
    assert one.parameters is one.parameters
    assert ParameterSpace.parameters.__doc__ == "The unknowns one by one."
    assert len(jax.tree.leaves(one)) == len(leaves)
    other = eqx.tree_at(lambda s: s.entries[0].start, one, jnp.asarray(4e5, float))
    assert float(other.parameters[0].start) == 4e5
    assert float(pickle.loads(pickle.dumps(one)).parameters[0].start) == 2e5


def test_what_is_traced_is_not_kept():
    """Neither that of a traced space, nor what a trace makes of a concrete one."""
    one = anisotropic_beam(cells=(1, 1, 1), order=1).space
    with jax.checking_leaks():
        inside = jax.jit(lambda traced: (traced.chart.S, one.chart.S))(one)
    assert "chart" not in vars(one)
    for S in inside:
        np.testing.assert_array_equal(one.chart.S, S)
    assert "chart" in vars(one)
