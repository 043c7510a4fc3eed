"""Row of the stiffness of the whole body."""

import jax.numpy as jnp

from softcal_jax._typing import Array, Float
from softcal_jax.equilibrium import InputRows, Linearisation, internal_force
from softcal_jax.sensitivity._rows import rows_of_forces


def stiffness_row(
    linearisation: Linearisation,
    internal: Float[Array, "n_points 3"] | None = None,
) -> InputRows:
    """Compute the row of Eq. (9) of a factor of all moduli, per relative change.

    The internal force is proportional to them, so it is the row itself.

    Args:
        linearisation: The equilibrium.
        internal: The internal force; by default that of the equilibrium [N].
    """
    lin = linearisation
    row = -internal_force(lin.posed.model, lin.u) if internal is None else -internal
    return rows_of_forces(lin, row[None], held=jnp.zeros((1, *row.shape)))
