"""Row of the stiffness of the whole body."""

import jax.numpy as jnp

from softcal_jax.equilibrium import InputRows, Linearisation, internal_force
from softcal_jax.sensitivity._rows import readings_of_forces


def stiffness_row(linearisation: Linearisation) -> InputRows:
    """Compute the row of Eq. (9) of a factor of all moduli, per relative change.

    The internal force is proportional to them, so it is the row itself.

    Args:
        linearisation: The equilibrium.
    """
    lin = linearisation
    row = -internal_force(lin.posed.model, lin.u)
    return InputRows(
        force=lin.free(row)[None],
        held=jnp.zeros((1, *row.shape)),
        gap=jnp.zeros((1, lin.system.active.size)),
        reading=readings_of_forces(lin, row[None]),
    )
