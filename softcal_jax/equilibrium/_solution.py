"""Result of the search for an equilibrium."""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._results import RESULTS
from softcal_jax._typing import Array, Float, Int


class EquilibriumSolution(eqx.Module):
    """Equilibrium of one configuration, or of a batch (leading axis on every field).

    Attributes:
        displacement: Displacement u of the nodes of the mesh, then of the four nodes
            of each rigid body's frame [m]; nan where no equilibrium was found.
        multipliers: Forces of the actuators whose displacement is imposed, 0 for the
            others; `actuator_forces` gives those of all.
        result: Outcome; only `RESULTS.converged` is an equilibrium.
        steps: Newton iterations, each on a factor of its own, all load steps together.
        load_steps: Load increments that were taken (1: full load at once).
        load_reached: Share of the load at the last equilibrium [-]; 1 if converged.
        residual: Residual relative to the larger of external and internal force [-].
        min_det_F: Smallest det F over all quadrature points [-].
        n_negative: Number of negative eigenvalues of the last tangent, 0 for a stable
            state; -1 if unknown, because the linear solver does not count them or the
            model is not conservative.
    """

    displacement: Float[Array, "*batch n_points 3"]
    multipliers: Float[Array, "*batch n_a"]
    result: RESULTS
    steps: Int[Array, "*batch"]
    load_steps: Int[Array, "*batch"]
    load_reached: Float[Array, "*batch"]
    residual: Float[Array, "*batch"]
    min_det_F: Float[Array, "*batch"]
    n_negative: Int[Array, "*batch"]

    @property
    def converged(self) -> Array:
        """Whether each configuration reached a regular equilibrium."""
        return self.result == RESULTS.converged


def check_converged(solution: EquilibriumSolution, names: tuple[str, ...]) -> None:
    """Raise an error that names every configuration without an equilibrium.

    Args:
        solution: Solutions of a batch.
        names: Names of its configurations.

    Raises:
        RuntimeError: If a lane did not converge; the message says which and why.
    """
    bad = np.flatnonzero(~np.atleast_1d(np.asarray(solution.converged)))
    if bad.size == 0:
        return
    lines = []
    for lane in bad:
        of = partial(_of_lane, lane)
        result = jax.tree.map(lambda a, of=of: jnp.asarray(of(a)), solution.result)
        lines.append(
            f"configuration {names[lane]!r}: {RESULTS[result]} "
            f"({of(solution.steps)} Newton steps, "
            f"{100 * of(solution.load_reached):.0f} % of the load carried, residual "
            f"{of(solution.residual):.1e}, smallest det F {of(solution.min_det_F):.3g})"
        )
    raise RuntimeError("no equilibrium found.\n" + "\n".join(lines))


def _of_lane(lane, leaf):
    """Return the value of one lane; an unbatched solution is lane 0."""
    return np.atleast_1d(np.asarray(leaf))[lane]
