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
