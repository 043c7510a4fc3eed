import time

import jax
import jax.numpy as jnp
import pytest

from softcal_jax._process import Clock


def test_compiling_is_told_from_the_rest():
    slow_to_compile = jax.jit(lambda x: sum(jnp.sin(i * x) for i in range(200)))
    with Clock() as first:
        slow_to_compile(1.0).block_until_ready()
        time.sleep(0.05)
    assert first.seconds["compile"] > 0.02
    assert first.seconds["solve"] >= 0.05
    with Clock() as again:
        slow_to_compile(1.0).block_until_ready()
    assert again.seconds["compile"] == 0.0


def test_nested_traces_are_counted_once():
    inner = jax.jit(lambda x: sum(jnp.cos(i * x) for i in range(100)))
    with Clock() as clock:
        jax.jit(lambda x: inner(x) + inner(2.0 * x))(1.0).block_until_ready()
    # Were one counted twice, less than nothing would be left for solving.
    assert clock.seconds["compile"] > 0.0
    assert clock.seconds["solve"] > -0.01


def test_an_error_leaves_no_listener_behind():
    with pytest.raises(RuntimeError), Clock() as clock:
        raise RuntimeError
    jax.jit(lambda x: x + 3.25)(1.0)
    assert clock.seconds["compile"] == 0.0
