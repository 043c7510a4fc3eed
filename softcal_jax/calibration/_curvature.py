"""The part of the cost's Hessian that Gauss-Newton leaves out, from past steps.

The Hessian of ||error||^2 / 2 is W^T W + sum_i error_i H_i, with H_i the Hessian of
each error. The second term vanishes with the errors. Where errors remain, from noise or
an imperfect model, it dominates along directions that the data hardly see, and
Gauss-Newton steps converge slowly there, if at all. It is estimated at no extra cost
from the gradients at both ends of each step (Dennis, Gay and Welsch, ACM Trans. Math.
Softw. 7, 1981), by the symmetric rank-one update, which can become indefinite, as the
true term can (Conn, Gould and Toint, Math. Prog. 50, 1991). It is used while the cost
falls slowly (Fletcher and Xu, IMA J. Numer. Anal. 7, 1987) and only if it predicted the
last step better than Gauss-Newton.
"""

import jax.numpy as jnp

from softcal_jax._module import Module
from softcal_jax._typing import Array, Bool, Float

QUICK = 0.2
"""Relative fall of the cost from which plain Gauss-Newton is used [-]."""

BOUNDED = 1e-4
"""Smallest cosine between step and residual of the update: keeps it bounded [-]."""

FLATTEST = 1e-8
"""Smallest curvature of the convex model, relative to the largest [-]."""


class Curvature(Module):
    """Second term of the Hessian in step coordinates, and whether a step uses it."""

    matrix: Float[Array, "n_p n_p"]
    used: Bool[Array, ""]


def no_curvature(z: Float[Array, " n_p"]) -> Curvature:
    """Return the estimate before the first step: zero, unused."""
    return Curvature(jnp.zeros((z.shape[0], z.shape[0]), z.dtype), jnp.zeros((), bool))


def learned(
    curvature: Curvature,
    step: Float[Array, " n_p"],
    change: Float[Array, " n_p"],
    before: Float[Array, ""],
    after: Float[Array, ""],
    predicted: Float[Array, "2"],
) -> Curvature:
    """Update the estimate after a step, accepted or refused.

    `change` is that of W along the step, transposed, times the errors. The cost `after`
    is infinite if there is no equilibrium; `predicted` are those by the linear model of
    the errors, without and with the curvature.
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
    """Return W' and error' that have the cost's gradient and, if convex, its Hessian.

    The Hessian is taken apart into eigenvalues, with the columns of W scaled to unit
    length. Negative ones are replaced by their size, so that a step goes downhill.
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
