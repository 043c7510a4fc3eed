"""Compliances of parameters: W_ep (Eq. 9), with equilibria too, and W_pp (Sec. V-C)."""

from typing import Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from softcal_jax._typing import Array, Bool, Float
from softcal_jax.configurations import Configuration, ConfigurationArrays
from softcal_jax.equilibrium import (
    EquilibriumSolution,
    InputRows,
    Linearisation,
    Model,
    NewtonSettings,
    Sensitivity,
    continue_equilibrium,
    effector_values,
    linearise,
    one_lane,
    sensitivity,
)
from softcal_jax.fields import ParameterSpace
from softcal_jax.sensitivity._rows import following_rows, parameter_rows

FEW_PARAMETERS = 12
"""Number of parameters up to which the direct method is used, which yields dx/dp too.

The next equilibria start from that; a dozen right-hand sides cost one factorization.
"""


def parameter_compliance(
    model: Model,
    configuration: Configuration | ConfigurationArrays,
    u: Float[Array, "n_points 3"],
    space: ParameterSpace,
    z: Float[Array, " n_p"],
    *,
    method: Literal["auto", "direct", "adjoint"] = "auto",
) -> Sensitivity:
    """Compute W_ep = H_e K^-1 H_p^T at an equilibrium, with one factorization; Eq. (9).

    Effector coordinates are in the order effector, axis. The displacement u is that at
    the equilibrium with the parameters of z [m]. "direct" solves for the n_p columns of
    H_p^T, "adjoint" for the n_e rows of H_e; "auto" chooses the fewer right-hand sides.

    Raises:
        ValueError: If the configuration is a batch, or of another model.
    """
    lane = one_lane(model, configuration)
    return _parameter_compliance(model, lane, u, space, z, method)


@eqx.filter_jit
def _parameter_compliance(model, configuration, u, space: ParameterSpace, z, method):
    changed, lane = space.apply(model, configuration, z)
    lin = linearise(changed, one_lane(changed, lane), u)
    rows = parameter_rows(lin, space, z)
    fewer = z.shape[0] > configuration.effectors.measured.size
    adjoint = method == "adjoint" or (method == "auto" and fewer)
    return sensitivity(lin, rows, effector_values, adjoint=adjoint)


class EnergyCompliance(NamedTuple):
    """W_ep and W_pp of configurations, one lane each; no measurements are needed.

    Attributes:
        W_ep: Change of each effector coordinate per unit of lambda_p, in its unit.
        W_pp: H_p K^-1 H_p^T, symmetric and positive semidefinite in a stable state [J].
        ok: Whether there is an equilibrium with a regular tangent.
        displacement: dx/dz by rows [m].
    """

    W_ep: Float[Array, "*batch n_e n_p"]
    W_pp: Float[Array, "*batch n_p n_p"]
    ok: Bool[Array, "*batch"]
    displacement: Float[Array, "*batch n_p n_points 3"]


@eqx.filter_jit
def energy_compliance(
    model: Model,
    configuration: ConfigurationArrays,
    u: Float[Array, "n_points 3"],
    space: ParameterSpace,
    z: Float[Array, " n_p"],
    slopes: Float[Array, "n_p n_stages n_points 3"] | None = None,
) -> EnergyCompliance:
    """Compute W_ep and W_pp = H_p K^-1 H_p^T at an equilibrium, with one factorization.

    Paper Eq. (9) and Sec. V-C. Row i of u' = K^-1 H_p^T is the motion of the nodes per
    unit of lambda_p,i, and the rows h_i of H_p^T are the forces that cause it. So
    W_pp,ij = h_i . u'_j = u'_i . K u'_j is positive definite if K is. With m(z) =
    min_u Pi(u; z), it is the curvature of the energy lost by relaxation: W_pp =
    d2 Pi/dz2 at fixed u minus d2 m/dz2. Arguments as for `parameter_compliance` and
    `following_rows`.
    """
    lin = linearise(*space.apply(model, configuration, z), u)
    rows = following_rows(lin, parameter_rows(lin, space, z), slopes)
    changes = sensitivity(lin, rows, effector_values)
    W = _relaxation(lin, rows, changes, still=all(space.sets_fields))
    W_pp = 0.5 * (W + W.T)  # symmetric up to the rounding of the factorization
    ok = changes.ok & jnp.all(jnp.isfinite(W_pp)) & jnp.all(jnp.isfinite(changes.W_ep))
    assert changes.displacement is not None
    return EnergyCompliance(changes.W_ep, W_pp, ok, changes.displacement)


def _relaxation(
    lin: Linearisation, rows: InputRows, changes: Sensitivity, *, still: bool
) -> Float[Array, "n_p n_p"]:
    """Compute u'_i . K u'_j, with the motion of held nodes unless they stay `still`.

    Without that motion the result would depend on the mesh: beside a moved support,
    only the tets that touch it would be strained.
    """
    assert changes.displacement is not None
    assert changes.unknowns is not None
    if still:
        return rows.force @ changes.unknowns.T  # the force is K u' on the free unknowns

    def forces(u):
        on_nodes = lin.unbalanced(u, lin.lambda_a)
        # The moments of forces on a body change as it turns.
        return on_nodes, lin.posed.gather(u, on_nodes)

    _, slope = jax.linearize(forces, lin.u)
    on_nodes, on_unknowns = jax.lax.map(slope, changes.displacement)
    held = jnp.einsum("ink,jnk->ij", rows.held, on_nodes)
    return changes.unknowns @ on_unknowns.T + held


class Response(NamedTuple):
    """Equilibrium of one configuration, with its effectors and their compliance.

    Attributes:
        W_ep: Change of each effector coordinate per unit of lambda_p, in its unit.
        displacement: dx/dz by rows [m]; None if adjoint.
        ok: False if there is no equilibrium or no tangent; W_ep is then zero.
    """

    equilibrium: EquilibriumSolution
    effectors: Float[Array, "*batch n_rows 3"]
    W_ep: Float[Array, "*batch n_e n_p"]
    displacement: Float[Array, "*batch n_p n_points 3"] | None
    ok: Bool[Array, "*batch"]


@eqx.filter_jit
def equilibrium_response(
    model: Model,
    space: ParameterSpace,
    newton: NewtonSettings,
    z: Float[Array, " n_p"],
    configuration: ConfigurationArrays,
    guess: Float[Array, "n_points 3"],
    before: Float[Array, "n_points 3"] | None = None,
    precise: bool | Bool[Array, ""] = False,
    slopes: Float[Array, "n_p n_stages n_points 3"] | None = None,
) -> Response:
    """Find the equilibrium near a guess, and W_ep = H_e K^-1 H_p^T there; Eq. (9).

    If none is near, it is not converged, see `continue_equilibrium`. W_ep reuses the
    factor of the last Newton step, and is exact only if `precise`. `vmap` runs
    configurations sequentially, each to its own convergence. Arguments as for
    `continue_equilibrium`, `parameter_compliance` and `following_rows`.
    """
    model, rest = eqx.partition(model, eqx.is_array_like)

    @jax.custom_batching.sequential_vmap
    def lane(model, space, z, configuration, guess, before, precise, slopes):
        model = eqx.combine(model, rest)
        model, configuration = space.apply(model, configuration, z)
        n_p, n_e = z.shape[0], configuration.effectors.measured.size
        adjoint = slopes is None and n_p > max(n_e, FEW_PARAMETERS)
        equilibrium, linearisation = continue_equilibrium(
            model,
            configuration,
            guess,
            settings=newton,
            before=before,
            precise=precise,
            # The factors of a matrix without symmetry do not serve its transpose.
            rows=n_p if not adjoint else n_e * model.solver.sparsity.symmetric,
        )
        rows = parameter_rows(linearisation, space, z)
        rows = following_rows(linearisation, rows, slopes)
        changes = sensitivity(linearisation, rows, effector_values, adjoint=adjoint)
        ok = changes.ok & equilibrium.converged
        or_zero = lambda a: jnp.where(ok, a, 0.0)
        assert changes.readings is not None
        e = changes.readings.reshape(configuration.effectors.measured.shape)
        return Response(
            equilibrium=equilibrium,
            effectors=jnp.where(equilibrium.converged, e, jnp.nan),
            W_ep=or_zero(changes.W_ep),
            displacement=jax.tree.map(or_zero, changes.displacement),
            ok=ok,
        )

    before = guess if before is None else before
    exact = jnp.asarray(precise)
    return lane(model, space, z, configuration, guess, before, exact, slopes)
