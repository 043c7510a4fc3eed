"""Lanes of a batch: one configuration each, taken apart and joined on the host."""

from collections.abc import Sequence
from typing import TypeVar

import jax
import numpy as np

from softcal_jax._typing import Array, HostArray, Int

T = TypeVar("T")


def lane_of(batch: T, index: int | slice | Int[HostArray, " n"]) -> T:
    """Return one lane of a batch, or a batch of several."""
    # Sliced on the host: on the device, each shape compiles two more programs.
    return jax.device_put(jax.tree.map(lambda leaf: np.asarray(leaf)[index], batch))


def unstacked(batch: Array | HostArray) -> list[Array]:
    """Take a batch apart, without compiling for each of its shapes."""
    return jax.device_put([*np.asarray(batch)])


def stacked(lanes: Sequence[T]) -> T:
    """Stack lanes as a batch, without compiling for each number of lanes."""
    return jax.device_put(jax.tree.map(lambda *leaves: np.stack(leaves), *lanes))
