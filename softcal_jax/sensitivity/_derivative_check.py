"""Check of the paper's finite differences against autodiff."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from softcal_jax._typing import Array, Float, HostArray
from softcal_jax.configurations import ConfigurationArrays
from softcal_jax.equilibrium import Model
from softcal_jax.fields import ParameterSpace
from softcal_jax.sensitivity._rows import parameter_forces


class DerivativeCheck(eqx.Module):
    """Error of the finite-difference H_p against autodiff, per step and parameter.

    Attributes:
        names: Names of the parameters.
        steps: Steps, in scaled units [-].
        errors: Largest difference over the nodes, relative to the largest force [-].
        orders: Order of each error, from steps above rounding [-]; 2 is expected.
    """

    names: tuple[str, ...]
    steps: Float[HostArray, " n_steps"]
    errors: Float[HostArray, "n_steps n_p"]
    orders: Float[HostArray, " n_p"]

    def __str__(self) -> str:
        """Format a table with one row per step."""
        lines = ["step      " + "  ".join(f"{name:>12}" for name in self.names)]
        for step, row in zip(self.steps, self.errors, strict=True):
            lines.append(f"{step:8.1e}  " + "  ".join(f"{e:12.3e}" for e in row))
        lines.append("order     " + "  ".join(f"{o:12.2f}" for o in self.orders))
        return "\n".join(lines)


def check_parameter_derivatives(
    model: Model,
    configuration: ConfigurationArrays,
    u: Float[Array, "n_nodes 3"],
    space: ParameterSpace,
    z: Float[Array, " n_p"],
    *,
    steps: tuple[float, ...] = (1e-1, 3e-2, 1e-2, 3e-3, 1e-3),
) -> DerivativeCheck:
    """Compare the paper's finite-difference H_p with autodiff over a sweep of steps.

    Args:
        model: The model.
        configuration: One configuration.
        u: Displacement at which forces are compared, not all zero [m].
        space: The parameters.
        z: Their scaled values [-].
        steps: Decreasing steps in scaled units [-].

    Returns:
        Errors and orders. If the force is linear in a parameter, like a modulus on a
        linear scale, there is only rounding and the order is nan.

    Raises:
        ValueError: If fewer than two steps are given, or they do not decrease.
    """
    if len(steps) < 2 or np.any(np.diff(steps) >= 0):
        raise ValueError(f"steps must be at least two falling numbers, got {steps}.")
    exact = parameter_forces(model, configuration, u, space, z)
    size = jnp.max(jnp.abs(exact), axis=(1, 2))

    @eqx.filter_jit
    def error(step):
        forces = parameter_forces(
            model,
            configuration,
            u,
            space,
            z,
            derivative="finite-difference",
            step=step,
        )
        return jnp.max(jnp.abs(forces - exact), axis=(1, 2)) / size

    errors = np.stack([np.asarray(error(jnp.asarray(step))) for step in steps])
    orders = np.full(len(space.names), np.nan)
    for i, column in enumerate(errors.T):
        clear = column > 1e-9  # above the rounding of the difference
        if clear.sum() >= 2:
            h, e = np.log(np.asarray(steps)[clear]), np.log(column[clear])
            orders[i] = np.polyfit(h, e, 1)[0]
    return DerivativeCheck(tuple(space.names), np.asarray(steps), errors, orders)
