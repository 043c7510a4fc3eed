"""A `vmap` that runs its lanes sequentially, each to its own convergence."""

import functools
from collections.abc import Callable
from typing import TypeVar

import equinox as eqx
import jax

T = TypeVar("T", bound=Callable)


def lane_by_lane(function: T) -> T:
    """Make `vmap` of a function loop over the lanes inside the compiled program.

    An ordinary `vmap` of a `while_loop` runs every lane until the slowest has ended.
    Here a converged lane costs nothing more, a batch gives bit for bit the results of
    its members, and arrays that the lanes share are never copied; also if nested.
    Assembly already fills the vector units with the tets of one lane, and the sparse
    solver takes one matrix at a time.

    Apart from the threads of PARDISO and XLA within a lane, this loop uses one core;
    `Workers`, outside of compiled programs, runs lanes on all cores. Measured for 16
    evaluations of the beam of `benchmarks.batch`, two rounds on two cores on which two
    independent processes would take 119 ms: `Workers` took 126 and 141 ms. A batching
    rule that calls back to host threads took 135 and 137 ms, but deadlocks if two user
    threads call such a program. `shard_map` over two CPU devices took 117 and 159 ms,
    but needs the devices before JAX starts, and confines PARDISO to one core even for
    a single lane.
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
