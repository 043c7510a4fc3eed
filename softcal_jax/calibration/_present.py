"""Which configurations have gravity, each dead load and each imposed force.

An error of what a configuration lacks cannot occur, and nothing can be learnt of it.
"""

import numpy as np

from softcal_jax._typing import Bool, HostArray
from softcal_jax.configurations import ConfigurationArrays


def with_gravity(arrays: ConfigurationArrays) -> Bool[HostArray, " n_c"]:
    """Tell which configurations have gravity."""
    return np.any(np.asarray(arrays.gravity), axis=1)


def with_loads(arrays: ConfigurationArrays) -> Bool[HostArray, "n_c n_loads"]:
    """Tell which configurations have each dead load."""
    return np.any(np.asarray(arrays.loads.force), axis=(2, 3))


def with_forces(arrays: ConfigurationArrays) -> Bool[HostArray, "n_c n_a"]:
    """Tell which configurations impose a force on each actuator."""
    actuation = arrays.actuation
    imposed = np.asarray(actuation.value) != 0.0
    return ~np.asarray(actuation.by_displacement) & imposed
