"""Cook's membrane: bending and shear of a tapered plate in plane strain."""

import jax.numpy as jnp
import numpy as np
import pytest
from bodies import lane, solve
from jax import Array
from jaxtyping import Float
from problems import COOK_MU, COOK_NU, COOK_RISE, cook_mesh, nearest_node

from softcal_jax.configurations import (
    Configuration,
    Support,
    SurfaceForce,
    configuration_arrays,
)
from softcal_jax.elements import determinant
from softcal_jax.equilibrium import RESULTS, build_model
from softcal_jax.materials import AbstractLaw


class CookLaw(AbstractLaw):
    """A user's law: its energy and nothing else.

    psi = mu/2 (J^-2/3 I1 - 3) + K/4 (J^2 - 1 - 2 ln J), as in the deal.II gallery.
    """

    mu: Float[Array, "..."]
    bulk: Float[Array, "..."]

    def energy_density(self, F: Float[Array, "3 3"]) -> Float[Array, ""]:
        J = determinant(F)
        volume = 0.25 * self.bulk * (J**2 - 1.0 - 2.0 * jnp.log(J))
        return 0.5 * self.mu * (J ** (-2 / 3) * jnp.sum(F * F) - 3.0) + volume


def rise(cells):
    mesh = cook_mesh(cells)
    bulk = 2.0 * COOK_MU * (1.0 + COOK_NU) / (3.0 * (1.0 - 2.0 * COOK_NU))
    law = CookLaw(jnp.asarray(COOK_MU), jnp.asarray(bulk))
    configuration = Configuration(
        "membrane",
        (Support("x_min"), Support(np.arange(mesh.n_nodes), axes="z")),
        gravity=(0.0, 0.0, 0.0),
        loads=(SurfaceForce("x_max", (0.0, 1.0, 0.0)),),
    )
    solution = solve(
        build_model(mesh, law, density=0.0), configuration_arrays(mesh, [configuration])
    )
    assert bool(lane(solution, 0).result == RESULTS.converged)
    np.testing.assert_array_equal(solution.displacement[0, :, 2], 0.0)
    node = nearest_node(mesh, (0.048, 0.052, 0.0))
    return float(solution.displacement[0, node, 1])


@pytest.mark.slow
def test_rise_of_the_edge():
    """Falls short by the mesh, half as much on the finer one; then the reference.

    Measured 14.715 and 14.731 mm on 8 and 16 cells; the clamped corner is singular.
    """
    short = [COOK_RISE - rise(cells) for cells in (8, 16)]
    assert 0.0 < short[1] < short[0] / 2.0
    np.testing.assert_allclose(short[1], 0.0, atol=1e-3 * COOK_RISE)
