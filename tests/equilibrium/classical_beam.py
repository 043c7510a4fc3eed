"""The paper's beam with a law that has no potential, which two files of tests share.

150 x 15 x 15 mm of 32 g, with its fibre at 30 degrees.
"""

from functools import cache

import jax.numpy as jnp
import numpy as np
from bodies import TIGHT, solve

from softcal_jax.configurations import (
    Configuration,
    Markers,
    Support,
    configuration_arrays,
)
from softcal_jax.equilibrium import build_model
from softcal_jax.materials import Fibre, Isotropic, ReducedTransverseIsotropic
from softcal_jax.mesh import beam

LENGTH, SIDE, MASS = 0.150, 0.015, 0.032
E_T, E_L, NU, THETA = 700e3, 400e3, 0.3, float(np.deg2rad(30.0))
ELASTICITIES = {
    "fibre": ReducedTransverseIsotropic(E_T, E_L, NU, Fibre(THETA)),
    "isotropic": Isotropic(E_T, NU),
    "equal moduli": ReducedTransverseIsotropic(E_T, E_T, NU, Fibre(THETA)),
}
MESH = beam(LENGTH, SIDE, SIDE, (8, 1, 1), order=2)
LINEAR = beam(LENGTH, SIDE, SIDE, (8, 1, 1))  # stiffer; compiles fast
MESHES = {"quadratic": MESH, "linear": LINEAR}
TIP = (LENGTH, SIDE / 2, SIDE / 2)
MARKERS = Markers(("tip", "middle"), [TIP, (LENGTH / 2, SIDE / 2, SIDE / 2)])
CLAMP = Support("x_min")
LIFTED = Support("x_max", "z", (0.0, 0.0, 0.02))


def hanging(factor, *supports):
    """The clamped beam under a multiple of its weight, across the fibres."""
    gravity = (0.0, -9.81 * factor, 0.0)
    name = f"{factor} {len(supports)}"
    return Configuration(name, (CLAMP, *supports), gravity, markers=MARKERS)


LANES = configuration_arrays(
    MESH,
    [
        *(hanging(1.0), hanging(20.0), hanging(0.5, LIFTED), hanging(100.0)),
        *(hanging(50.0, LIFTED), hanging(200.0, LIFTED)),
    ],
)
ONE_G, TWENTY_G, HUNDRED_G, LIFTED_50_G, LIFTED_200_G = 0, 1, 3, 4, 5


@cache
def body(law, elasticity="fibre", *, mesh="quadratic", solver=None):
    density = MASS / (LENGTH * SIDE**2)
    return build_model(
        MESHES[mesh], law(ELASTICITIES[elasticity]), density=density, solver=solver
    )


@cache
def solution(law, elasticity="fibre", *, solver=None):
    """Equilibria to rounding."""
    return solve(body(law, elasticity, solver=solver), LANES, TIGHT)


def assert_same_shapes(one, other):
    """Displacements that differ by the rounding of a residual of 1e-12."""
    scale = float(jnp.max(jnp.abs(other.displacement)))
    np.testing.assert_allclose(
        one.displacement, other.displacement, rtol=0, atol=1e-9 * scale
    )
