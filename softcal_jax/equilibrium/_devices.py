"""Lanes of a batch side by side: a device of JAX for each core."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import AxisType, PartitionSpec

from softcal_jax._typing import is_traced
from softcal_jax.equilibrium._model import Model
from softcal_jax.equilibrium._workers import usable_cores


def use_cores(n: int | None = None) -> int:
    """Let `map_lanes` solve lanes on several cores at a time.

    Programs call it before JAX computes anything; libraries do not. Each core becomes a
    device of JAX, with a sparse solver of one thread; all else runs on the first.

    Args:
        n: Number of cores, which is returned; by default all that may be used.

    Raises:
        ValueError: If `n` is less than one.
        RuntimeError: If JAX has computed already, with another number of devices.
    """
    n = usable_cores() if n is None else n
    if n < 1:
        raise ValueError(f"the number of cores must be at least 1, got {n}.")
    try:
        jax.config.update("jax_num_cpu_devices", n)
    except RuntimeError:
        if (before := jax.local_device_count("cpu")) != n:  # equal in a cell run twice
            raise RuntimeError(
                f"use_cores({n}) came too late: JAX has computed already (CPU devices: "
                f"{before}). Call it first; in a notebook, restart the kernel before."
            ) from None
    return n


def map_lanes(
    function: Callable[..., Any], model: Model, lanes: Any, *others: Any
) -> Any:
    """Apply a function to all lanes of a batch, on the cores of `use_cores`.

    On one core this is `jax.vmap(lambda lane: function(model, lane, *others))(lanes)`.
    On several, each has a `vmap` over its share and a sparse solver of its own; only
    rounding may differ. Under `jit` and autodiff the results lie on all devices, where
    the next program runs too, until `jax.device_get` takes them from there. Pass what
    changes as an argument: each function and set of shapes compiles once.

    Args:
        function: Takes the model, one lane and the others; returns arrays.
        model: The model.
        lanes: Arrays with a leading axis, like `lanes(model, poses)`, moduli, or both.
        *others: What all lanes share; numbers are traced, but for int and bool.

    Returns:
        What the function returns, with a leading axis.

    Raises:
        ValueError: If there is no lane, or arrays differ in their number.
    """
    n = {(*jnp.shape(leaf), 0)[0] for leaf in jax.tree.leaves(lanes)}
    if len(n) != 1 or 0 in n:
        raise ValueError(f"expected as many lanes in all arrays, 1 or more, got {n}.")
    # Programs that call the solver back on the host deadlock side by side.
    if jax.local_device_count() == 1 or not model.solver.runs_in_threads:
        return jax.vmap(lambda lane: function(model, lane, *others))(lanes)
    as_array = lambda leaf: jnp.asarray(leaf) if isinstance(leaf, float) else leaf
    results = _on_devices(function, model, lanes, jax.tree.map(as_array, others))
    traced = any(map(is_traced, jax.tree.leaves(results)))
    return results if traced else jax.device_put(jax.device_get(results))


@eqx.filter_jit
def _on_devices(function, model, lanes, others):
    n, n_devices = len(jax.tree.leaves(lanes)[0]), jax.local_device_count()
    each = -(-n // n_devices)
    n_used = -(-n // each)  # the others would only repeat lanes
    # In turn, since neighbours often cost the same; the rest repeats the first lane.
    place = np.arange(n) % n_used * each + np.arange(n) // n_used
    lane_at = np.zeros(n_devices * each, int)
    lane_at[place] = np.arange(n)
    arrays, rest = eqx.partition((model, others), eqx.is_array)

    def share(arrays, lanes):
        (model, others), device = eqx.combine(arrays, rest), jax.lax.axis_index("lanes")
        model = replace(model, solver=model.solver.on_device(device))
        solved = lambda: jax.vmap(lambda lane: function(model, lane, *others))(lanes)
        zeros = lambda: jax.tree.map(jnp.zeros_like, jax.eval_shape(solved))
        return jax.lax.cond(device < n_used, solved, zeros)

    on_devices = jax.shard_map(
        share,
        mesh=jax.make_mesh((n_devices,), ("lanes",), (AxisType.Auto,)),
        in_specs=(PartitionSpec(), PartitionSpec("lanes")),
        out_specs=PartitionSpec("lanes"),
        check_vma=False,
    )
    taken = jax.tree.map(lambda leaf: jnp.asarray(leaf)[lane_at], lanes)
    return jax.tree.map(lambda leaf: leaf[place], on_devices(arrays, taken))
