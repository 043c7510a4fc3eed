"""The cushion between surfaces: its potential and its pressure over a modulus."""

import jax
import jax.numpy as jnp

from softcal_jax._typing import Array, Float


def cushion(d: Float[Array, "..."], s: Float[Array, ""]) -> Float[Array, "..."]:
    """Compute phi of the module `_contacts` [m]."""
    near = jnp.clip(d, 0.0, 2.0 * s)
    far = jnp.maximum(d / s, 2.0)
    deep = s * (0.5 * far**2 - far + 2.0 / 3.0)
    return jnp.where(d < 2.0 * s, near**3 / (12.0 * s**2), deep)


def cushion_pressure(
    d: Float[Array, "..."], s: Float[Array, ""]
) -> Float[Array, "..."]:
    """Compute phi'(d) [-]."""
    near = jnp.clip(d, 0.0, 2.0 * s)
    return jnp.where(d < 2.0 * s, near**2 / (4.0 * s**2), d / s - 1.0)


def tamed_pressure(
    most: Float[Array, ""], d: Float[Array, "..."], s: Float[Array, ""]
) -> Float[Array, "..."]:
    """Return the pressure up to `most`, with the derivative of the whole [-]."""
    still = jax.lax.stop_gradient
    slope = jnp.clip(d / (2.0 * s), 0.0, 1.0) / s
    return still(jnp.minimum(cushion_pressure(d, s), most)) + still(slope) * (
        d - still(d)
    )


def mean_over_faces(
    p: Float[Array, "n_faces n_qp"], area: Float[Array, "n_faces n_qp"]
) -> Float[Array, " n_faces"]:
    """Average values at points of faces by their areas; 0 for faces without area."""
    whole = jnp.sum(area, axis=1)
    return jnp.sum(area * p, axis=1) / jnp.where(whole > 0.0, whole, 1.0)
