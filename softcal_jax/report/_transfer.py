"""Do the values that one robot gave predict the poses of another?"""

from dataclasses import replace
from typing import Any

import jax.numpy as jnp
import numpy as np

from softcal_jax._module import Result
from softcal_jax._typing import Float, HostArray
from softcal_jax.calibration import CalibrationResult, ConfigurationResult
from softcal_jax.export import plain
from softcal_jax.inference import Difference, Estimate, difference
from softcal_jax.project import Project


class Transfer(Result):
    """Values of the material from a robot A, asked of a robot B.

    Attributes:
        difference: Of the values that both gave.
        poses: The configurations of B.
        motion: How far their points move [m].
        rms_own: How far they are off by the fit to B, rms [m].
        rms_of_a: The same with the values of A, and all others fitted to B [m].
        lost: Configurations of which no equilibrium was found with the values of A.
    """

    difference: Difference
    poses: tuple[str, ...]
    motion: Float[HostArray, " n_c"]
    rms_own: Float[HostArray, " n_c"]
    rms_of_a: Float[HostArray, " n_c"]
    lost: tuple[str, ...]

    def as_dict(self) -> dict[str, Any]:
        """Return all of it for JSON, in SI; None where a number is not known."""
        d = self.difference
        judged = ("probability", "agree", "verdict")
        return {**plain(self), **{key: getattr(d, key) for key in judged}}

    def _words(self) -> str:
        return self.difference.verdict


def transfer(a: Estimate, b: Project, result: CalibrationResult) -> Transfer:
    """Compare a calibration of robot A with that of robot B, and predict B with it.

    Args:
        a: What the calibration of A found.
        b: The project of B.
        result: Its calibration.

    Raises:
        ValueError: If no parameter of the material has a standard error in both.
    """
    apart = difference(a, result.estimate)
    with_a = _predicted(b, result, dict(zip(apart.names, apart.of_a, strict=True)))
    rms_of_b = {c.name: c.rms_after for c in result.configurations}
    return Transfer(
        difference=apart,
        poses=tuple(c.name for c in with_a),
        motion=np.array([c.motion for c in with_a]),
        rms_own=np.array([rms_of_b.get(c.name, np.nan) for c in with_a]),
        rms_of_a=np.array([c.rms_after for c in with_a]),
        lost=tuple(c.name for c in with_a if not c.converged),
    )


def _predicted(
    b: Project, result: CalibrationResult, of_a: dict[str, float]
) -> tuple[ConfigurationResult, ...]:
    """Solve B with values of A; its other parameters follow, to first order."""
    space, linear, z = result.space, result.linear, np.asarray(result.z)
    values = np.array(space.from_scaled(result.z))
    taken = np.isin(space.names, [*of_a])
    values[taken] = [of_a[name] for name in space.names if name in of_a]
    at_a = space.to_scaled(jnp.asarray(values))
    to_a = np.asarray(space.shorter(at_a - result.z))
    moved = replace(
        linear,
        r=linear.r + linear.W @ to_a,
        from_prior=linear.from_prior + linear.prior_weights * to_a,
        held=linear.held | taken,
    )
    others = jnp.asarray(z + np.nan_to_num(moved.step()))
    others = space.from_scaled(jnp.clip(others, space.lower(), space.upper()))
    values = np.where(taken, values, np.asarray(others))
    simulated, _ = b.simulate(dict(zip(space.names, values, strict=True)))
    return simulated.configurations
