"""`vmap` that runs its lanes one after the other, each to its own end."""

import functools
from collections.abc import Callable
from typing import TypeVar

import equinox as eqx
import jax

T = TypeVar("T", bound=Callable)


def lane_by_lane(function: T) -> T:
    """Make `vmap` of a function loop over the lanes inside the compiled program.

    A `while_loop` under an ordinary `vmap` runs every lane until the slowest has ended.
    Here a lane that has converged costs nothing more, a batch gives bit for bit what
    its members give alone, and arrays that the lanes share are never copied. Assembly
    already fills the vector units from the tets of one lane, and the sparse solver
    takes one matrix at a time.

    A loop of lanes keeps one core busy, but for what PARDISO and XLA share within a
    lane: `Workers`, outside of compiled programs, runs lanes on all cores. 16
    evaluations of the beam of `benchmarks.batch` took 126 and 141 ms there, in two
    rounds on two cores of which two independent processes would have made 119 ms. A
    rule that calls back to the host, where threads run a compiled lane each, took 135
    and 137 ms, but two threads of a user that call such a program wait for each other
    for ever. `shard_map` over two CPU devices took 117 and 159 ms, but the devices must
    be asked for before JAX starts, and PARDISO would be held to one core also where a
    lane is alone.

    Args:
        function: Takes and returns pytrees of arrays.

    Returns:
        The function with its batching rule; nested `vmap` loops too.
    """
    batched = jax.custom_batching.custom_vmap(function)

    @batched.def_vmap
    def _rule(axis_size, in_batched, *args):
        del axis_size
        mapped, shared = eqx.partition(args, tuple(in_batched))

        def one(mapped):
            return batched(*eqx.combine(mapped, shared))

        out = jax.lax.map(one, mapped)
        return out, jax.tree.map(lambda _: True, out)

    return functools.wraps(function)(batched)  # type: ignore[return-value]
