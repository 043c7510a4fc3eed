"""What the solve of an equilibrium returns, and the error where there is none."""

import numpy as np

from softcal_jax._lanes import lane_of
from softcal_jax._module import Module
from softcal_jax._results import RESULTS
from softcal_jax._typing import Array, Bool, Float, Int


class EquilibriumSolution(Module):
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
        rounding: Residual that rounding leaves, estimated from the mean stiffness;
            forces below their own rounding count as large as that [-].
        at_rounding: Whether Newton stopped at rounding, with a residual above `rtol`.
        min_det_F: Smallest det F over all quadrature points [-].
        n_negative: Number of negative eigenvalues of the last tangent, 0 for a stable
            state; at a limit point the fewest of any iterate beyond it; -1 if unknown,
            because the linear solver does not count them or the model is not
            conservative.
        approached: Share of the way from the nearest equilibrium that was found where
            it did not lead to the end, see `equilibria`; nan if none was tried [-].
        along_path: Share of the load that its path carries where it does not lead to
            the end, see `LoadPath`; nan if none was followed [-].
    """

    displacement: Float[Array, "*batch n_points 3"]
    multipliers: Float[Array, "*batch n_a"]
    result: RESULTS
    steps: Int[Array, "*batch"]
    load_steps: Int[Array, "*batch"]
    load_reached: Float[Array, "*batch"]
    residual: Float[Array, "*batch"]
    rounding: Float[Array, "*batch"]
    at_rounding: Bool[Array, "*batch"]
    min_det_F: Float[Array, "*batch"]
    n_negative: Int[Array, "*batch"]
    approached: Float[Array, "*batch"]
    along_path: Float[Array, "*batch"]

    @property
    def converged(self) -> Array:
        """Whether each configuration reached a regular equilibrium."""
        return self.result == RESULTS.converged

    def _words(self) -> str:
        good = np.asarray(self.converged)
        steps, residual = np.max(np.asarray(self.steps)), np.max(self.residual)
        how = f"{steps} Newton steps, residual {residual:.1e}"
        if good.ndim == 0:
            return f"{RESULTS[self.result]}; {how}"
        return f"{good.sum()} of {good.size} converged; at most {how}"


def other_ways(solution: EquilibriumSolution) -> str:
    """Say which ways failed beside load steps from rest, in sentences."""
    ways = [
        (
            solution.approached,
            "The way from the nearest equilibrium led {:.3g} % there",
        ),
        (
            solution.along_path,
            "Along its path (`LoadPath`) it carries at most {:.3g} %",
        ),
    ]
    tried = [text.format(100.0 * share) for share, text in ways if np.isfinite(share)]
    return "".join(f" {text}." for text in tried)


def no_equilibrium(solution: EquilibriumSolution, names: tuple[str, ...]) -> str:
    """Say which lanes of a batch have no equilibrium, and why; empty if none."""
    bad = np.flatnonzero(~np.asarray(solution.converged)).tolist()

    def why(lane):
        one = solution if solution.steps.ndim == 0 else lane_of(solution, lane)
        count = f"{one.n_negative} negative eigenvalue{'s' * int(one.n_negative != 1)}"
        if one.n_negative < 0:  # so a limit point would not be noticed
            count = "negative eigenvalues unknown"
        return (
            f"configuration {names[lane]!r}: {RESULTS[one.result]} "
            f"({100 * one.load_reached:.3g} % of the load carried, {count}, "
            f"{one.steps} Newton steps, residual {one.residual:.1e} with rounding at "
            f"{one.rounding:.1e}, smallest det F {one.min_det_F:.3g}).{other_ways(one)}"
        )

    return "\n".join(["no equilibrium found.", *map(why, bad)]) if bad else ""


def check_converged(solution: EquilibriumSolution, names: tuple[str, ...]) -> None:
    """Check that all configurations of a batch have an equilibrium.

    Raises:
        RuntimeError: If one has none; the message says which, and why.
    """
    if text := no_equilibrium(solution, names):
        raise RuntimeError(text)
