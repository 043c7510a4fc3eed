"""Compliances of parameters: W_ep (Eq. 9) and W_pp (Sec. V-C)."""

from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._typing import Array, Bool, Float, HostArray
from softcal_jax.configurations import ConfigurationArrays
from softcal_jax.equilibrium import (
    InputRows,
    Linearisation,
    Model,
    Sensitivity,
    effector_values,
    linearise,
    residual,
    sensitivity,
)
from softcal_jax.fields import ParameterSpace
from softcal_jax.sensitivity._rows import Derivative, parameter_rows


class Compliance(NamedTuple):
    """W_ep of one configuration, with the displacements behind it.

    Attributes:
        W_ep: Change of each effector coordinate per unit of lambda_p, in its unit.
        displacement: dx/dz by rows, for warm starts [m]; None if adjoint.
        ok: False if the tangent could not be factorized; W_ep is then zero.
    """

    W_ep: Float[Array, "n_e n_p"]
    displacement: Float[Array, "n_p n_points 3"] | None
    ok: Bool[Array, ""]


def parameter_compliance(
    model: Model,
    configuration: ConfigurationArrays,
    u: Float[Array, "n_points 3"],
    space: ParameterSpace,
    z: Float[Array, " n_p"],
    *,
    method: Literal["auto", "direct", "adjoint"] = "auto",
    derivative: Derivative = "autodiff",
) -> Compliance:
    """Compute W_ep = H_e K^-1 H_p^T at an equilibrium, with one factorization; Eq. (9).

    Args:
        model: The model.
        configuration: One configuration with its effectors.
        u: Displacement at its equilibrium with the parameters of `z` [m].
        space: The parameters.
        z: Their scaled values [-].
        method: "direct" solves for the n_p columns of H_p^T, "adjoint" for the n_e rows
            of H_e; "auto" chooses the fewer right-hand sides.
        derivative: How H_p is computed, see `parameter_forces`.

    Returns:
        W_ep, with effector coordinates in the order effector, axis.
    """
    lin = linearise(*space.apply(model, configuration, z), u)
    rows = parameter_rows(lin, space, z, derivative=derivative)
    fewer = z.shape[0] > configuration.effectors.measured.size
    adjoint = method == "adjoint" or (method == "auto" and fewer)
    found = sensitivity(lin, rows, effector_values, adjoint=adjoint)
    return Compliance(found.W_ep, found.displacement, found.ok)


class EnergyCompliance(NamedTuple):
    """W_ep and W_pp of configurations, one lane each; needs no measurements.

    Attributes:
        W_ep: Change of each effector coordinate per unit of lambda_p, in its unit.
        W_pp: H_p K^-1 H_p^T, symmetric and positive semidefinite in a stable state [J].
        ok: Whether there is an equilibrium with a regular tangent.
    """

    W_ep: Float[Array, "*batch n_e n_p"]
    W_pp: Float[Array, "*batch n_p n_p"]
    ok: Bool[Array, "*batch"]


def energy_compliance(
    model: Model,
    configuration: ConfigurationArrays,
    u: Float[Array, "n_points 3"],
    space: ParameterSpace,
    z: Float[Array, " n_p"],
) -> EnergyCompliance:
    """Compute W_ep and W_pp = H_p K^-1 H_p^T at an equilibrium, with one factorization.

    Paper Eq. (9) and Sec. V-C. Row i of u' = K^-1 H_p^T is the motion of the nodes per
    unit of lambda_p,i, and the rows h_i of H_p^T are the forces that cause it (sign as
    in `parameter_forces`). So W_pp,ij = h_i . u'_j = u'_i . K u'_j is positive definite
    if K is. With m(z) = min_u Pi(u; z), it is the curvature of the energy lost by
    relaxation: W_pp = d2 Pi/dz2 at fixed u minus d2 m/dz2.

    Args:
        model: The model.
        configuration: One configuration with its effectors.
        u: Displacement at its equilibrium with the parameters of `z` [m].
        space: The parameters.
        z: Their scaled values [-].

    Returns:
        Both compliances, effector coordinates in the order effector, axis.
    """
    lin = linearise(*space.apply(model, configuration, z), u)
    rows = parameter_rows(lin, space, z)
    found = sensitivity(lin, rows, effector_values)
    W_pp = _relaxation(lin, rows, found, np.asarray(space.sets_fields))
    ok = found.ok & jnp.all(jnp.isfinite(W_pp)) & jnp.all(jnp.isfinite(found.W_ep))
    return EnergyCompliance(found.W_ep, W_pp, ok)


def _relaxation(
    lin: Linearisation, rows: InputRows, found: Sensitivity, fields: HostArray
) -> Float[Array, "n_p n_p"]:
    """Compute W_pp = u'_i . K u'_j, with the motion of held nodes where they move.

    Parameters that set `fields` of the law move nothing that is held.
    """
    moved, unknowns = found.displacement, found.unknowns
    assert moved is not None
    assert unknowns is not None
    W = rows.force @ unknowns.T  # the force is K u' on the free unknowns
    if not np.all(fields):
        force = lambda u: residual(lin.model, lin.configuration, u, lin.lambda_a)
        stiff = jax.vmap(lambda du: jax.jvp(force, (lin.u,), (du,))[1])(moved)
        whole = jnp.einsum("ink,jnk->ij", moved, stiff)
        W = jnp.where(fields[:, None] & fields[None], W, whole)
    # Symmetric up to the rounding of the factorization.
    return 0.5 * (W + W.T)
