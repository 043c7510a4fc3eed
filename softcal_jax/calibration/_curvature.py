"""The part of the cost's Hessian that Gauss-Newton leaves out, from past steps.

The Hessian of ||error||^2 / 2 is W^T W + sum_i error_i H_i, with H_i the Hessian of
each error. The second part vanishes with the errors. Where a fit leaves some, by noise
or because the model is not the robot, it decides along directions that the data hardly
see, and Gauss-Newton steps converge slowly there, if at all. The gradients at both ends
of each step tell it for nothing (Dennis, Gay and Welsch, ACM Trans. Math. Softw. 7,
1981), here by the symmetric update of rank one, which may become indefinite as the true
one (Conn, Gould and Toint, Math. Prog. 50, 1991). It is used while the cost falls
slowly (Fletcher and Xu, IMA J. Numer. Anal. 7, 1987), if it told the last step better.
"""

import equinox as eqx
import jax.numpy as jnp

from softcal_jax._typing import Array, Bool, Float

QUICK = 0.2
"""Fall of the cost, relative to it, at which Gauss-Newton needs no help [-]."""

BOUNDED = 1e-4
"""Smallest cosine between a step and what it tells, for a bounded update [-]."""

FLATTEST = 1e-8
"""Smallest curvature of the convex model, relative to the largest [-]."""


class Curvature(eqx.Module):
    """What is known of the second part of the Hessian.

    Attributes:
        matrix: The matrix, in step coordinates [-].
        used: Whether the next step is taken with it.
    """

    matrix: Float[Array, "n_p n_p"]
    used: Bool[Array, ""]


def no_curvature(z: Float[Array, " n_p"]) -> Curvature:
    """What is known before the first step."""
    return Curvature(jnp.zeros((z.shape[0], z.shape[0]), z.dtype), jnp.zeros((), bool))


def learned(
    curvature: Curvature,
    step: Float[Array, " n_p"],
    change: Float[Array, " n_p"],
    before: Float[Array, ""],
    after: Float[Array, ""],
    predicted: Float[Array, "2"],
) -> Curvature:
    """What is known after a step, kept or not.

    Args:
        curvature: What was known before.
        step: The step.
        change: Change of W along it, transposed, times the errors.
        before: Cost before the step.
        after: Cost after it; infinite if there is none.
        predicted: That of the linear model of the errors, and with the curvature.
    """
    left = change - curvature.matrix @ step
    along = jnp.sum(left * step)
    norm = jnp.linalg.norm
    bounded = jnp.abs(along) > BOUNDED * norm(left) * norm(step)
    update = jnp.outer(left, left) / jnp.where(bounded, along, 1.0)
    sound = bounded & jnp.all(jnp.isfinite(update)) & jnp.isfinite(after)
    matrix = curvature.matrix + jnp.where(sound, update, 0.0)
    miss = jnp.abs(after - predicted)
    slow = jnp.isfinite(after) & (before - after < QUICK * before)
    return Curvature(matrix, slow & (miss[1] < miss[0]))


def convex_model(
    W: Float[Array, "n_e n_p"],
    error: Float[Array, " n_e"],
    matrix: Float[Array, "n_p n_p"],
) -> tuple[Float[Array, "n_p n_p"], Float[Array, " n_p"]]:
    """W' and error' with the gradient of the cost and, if convex, its whole Hessian.

    Curvatures are those along the eigenvectors of the Hessian, for columns of W of unit
    length; negative ones count by their size, so that a step goes downhill.

    Args:
        W: Stacked compliances [-].
        error: Stacked errors [-].
        matrix: Second part of the Hessian [-].
    """
    size = jnp.linalg.norm(W, axis=0)
    size = jnp.where(size > 0.0, size, 1.0)
    unit = W / size[None, :]
    hessian = unit.T @ unit + matrix / size[:, None] / size[None, :]
    curvatures, axes = jnp.linalg.eigh(hessian)
    curvatures = jnp.abs(curvatures)
    root = jnp.sqrt(jnp.maximum(curvatures, FLATTEST * jnp.max(curvatures)))
    gradient = axes.T @ (unit.T @ error)
    return root[:, None] * axes.T * size[None, :], gradient / root
