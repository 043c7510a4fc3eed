"""The largest stretch and stress of a design, and limits on them."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._module import Module
from softcal_jax._typing import Array, Float, HostArray
from softcal_jax._units import readable
from softcal_jax.calibration import CalibrationResult, ConfigurationResult
from softcal_jax.configurations import EffectorRecord, Observation
from softcal_jax.equilibrium import Model, traced_tet_states

SHARPNESS = 50.0
"""How sharp the smooth maximum is: values as close to the largest one as the distance
of the limit from rest, over this, count as well [-]."""

SQUARINGS = 10  # of a matrix, for its exponential

SOFT = 1e-2
"""Width over which the excess over a limit sets in, over its distance from rest [-]."""

KEPT = 3e-2
"""Excess that counts as much as a tolerance of a goal, in the same unit [-]."""

TIGHTER = 5.0
"""Factor by which that is reduced where a limit is not kept [-]."""

MOST_TIGHTENED = 2  # how often it is


def _of_stretch(model: Model, u: Float[Array, "n_points 3"]) -> Float[Array, "n 3 3"]:
    """Compute F^T F at all quadrature points: squares of principal stretches [-]."""
    F = traced_tet_states(model, u).F.reshape(-1, 3, 3)
    return jnp.einsum("nki,nkj->nij", F, F)


def _of_stress(model: Model, u: Float[Array, "n_points 3"]) -> Float[Array, "n 1 1"]:
    """Compute squares of the von Mises stress of each tet, 3/2 s : s [Pa2]."""
    cauchy = traced_tet_states(model, u).cauchy
    sigma = 0.5 * (cauchy + jnp.swapaxes(cauchy, 1, 2))
    pressure = jnp.trace(sigma, axis1=1, axis2=2) / 3.0
    s = sigma - pressure[:, None, None] * jnp.eye(3)[None]
    return 1.5 * jnp.sum(s * s, axis=(1, 2))[:, None, None]


class _Kind(NamedTuple):
    """What can be limited: its squares, its unit, and its value at rest."""

    squares: Callable[[Model, Any], Float[Array, "n k k"]]
    unit: str
    at_rest: float

    def largest(self, model: Model, u: Float[Array, "n_points 3"]) -> Array:
        """Compute the root of the largest eigenvalue of the squares."""
        return jnp.sqrt(jnp.max(jnp.linalg.eigvalsh(self.squares(model, u))))

    def smooth(
        self, model: Model, u: Float[Array, "n_points 3"], limit: float
    ) -> Array:
        """Compute the same as a smooth maximum, a little above it near its limit.

        For squares C it is the root of c + ln(sum tr exp(b (C - c))) / b, with
        exp(-x) = (1 + x / m)^-m. It does not depend on c, up to 1 / m: the square of
        the limit, or the largest eigenvalue above it, which keeps the numbers small.
        """
        C, m = self.squares(model, u), 2.0**SQUARINGS
        largest = jax.lax.stop_gradient(jnp.max(jnp.linalg.eigvalsh(C)))
        c = jnp.maximum(largest, limit**2)
        b = SHARPNESS / (limit**2 - self.at_rest**2)
        unit = jnp.eye(C.shape[-1])[None]
        power = jnp.linalg.inv(unit + (c * unit - C) * b / m)
        for _ in range(SQUARINGS):
            power = jnp.einsum("nij,njk->nik", power, power)
        total = jnp.sum(jnp.trace(power, axis1=1, axis2=2))
        return jnp.sqrt(c + jnp.log(total) / b)


_KINDS = {
    "largest stretch": _Kind(_of_stretch, "-", 1.0),
    "largest stress": _Kind(_of_stress, "Pa", 0.0),
}


class _Excess(NamedTuple):
    """How far a smooth maximum lies above its limit, over its distance from rest [-].

    It sets in softly.
    """

    name: str
    limit: float

    def __call__(self, model: Model, configuration: Any, state: Any) -> Array:
        kind = _KINDS[self.name]
        value = kind.smooth(model, state.displacement, self.limit) - kind.at_rest
        above = value / (self.limit - kind.at_rest) - 1.0
        return SOFT * jax.nn.softplus(above / SOFT)


class PeakLimits(Module):
    """Limits of what is largest anywhere in the body, in every goal.

    Attributes:
        stretch: Of the largest principal stretch at a quadrature point [-].
        stress: Of the von Mises stress of a tet, by its mean Cauchy stress [Pa].

    Raises:
        ValueError: If a stretch is not above 1, or a stress not positive.
    """

    stretch: float = np.inf
    stress: float = np.inf

    def __check_init__(self):
        for name, value in self._every.items():
            if not value > _KINDS[name].at_rest:
                raise ValueError(
                    f"the limit of the {name} must be above {_KINDS[name].at_rest:g}, "
                    f"its value at rest; got {value:g}."
                )

    @property
    def given(self) -> dict[str, float]:
        """The limits that there are, by the name of what they limit."""
        return {n: value for n, value in self._every.items() if np.isfinite(value)}

    @property
    def _every(self) -> dict[str, float]:
        return {f"largest {name}": value for name, value in vars(self).items()}

    def readings(self, kept: float = KEPT) -> tuple[Observation, ...]:
        """Return how far the limits are exceeded, as readings that are to be zero."""
        excess = [_Excess(name, limit) for name, limit in self.given.items()]
        return tuple(
            Observation(e.name, e, "-", measured=0.0, std=kept) for e in excess
        )


class Peak(Module):
    """What is largest in the body at a goal, and its limit.

    Attributes:
        name: "largest stretch" or "largest stress".
        configuration: The configuration of the goal.
        value: The largest value, exactly, in `unit`.
        limit: Its limit.
        unit: "-" or "Pa".
    """

    name: str
    configuration: str
    value: float
    limit: float
    unit: str

    @property
    def kept(self) -> bool:
        """Whether it is within its limit."""
        return self.value <= self.limit

    def __str__(self) -> str:
        """Write it with its limit."""
        unit = "" if self.unit == "-" else self.unit
        show = lambda value: readable(float(f"{value:.4g}"), unit).strip()
        return (
            f"{self.name} in {self.configuration!r}: {show(self.value)}, "
            f"{'within' if self.kept else 'ABOVE'} its limit of {show(self.limit)}"
        )


def peaks(result: CalibrationResult, limits: PeakLimits) -> tuple[Peak, ...]:
    """Compute what is largest in the body at each goal, where it has a limit."""
    found = []
    for pose in result.configurations:
        u, read = jnp.asarray(pose.displacement), [e.name for e in pose.effectors]
        for name, limit in limits.given.items():
            if name not in read:  # a print, of which none is kept
                continue
            value = float(_KINDS[name].largest(result.model, u))
            found.append(Peak(name, pose.name, value, limit, _KINDS[name].unit))
    return tuple(found)


def aimed(pose: ConfigurationResult) -> list[EffectorRecord]:
    """Return the effectors that have a goal; readings of limits have none."""
    return [e for e in pose.effectors if e.seen.any() and e.name not in _KINDS]


def limits_reached(result: CalibrationResult) -> dict[str, Float[HostArray, " n_p"]]:
    """Return the slopes of limits that are reached, by what they limit."""
    slopes = {}
    for pose in result.configurations:
        for effector in pose.effectors:
            if effector.name in _KINDS and effector.simulated[0] > 0.1 * SOFT:
                assert pose.W_ep is not None
                name = f"the {effector.name} in {pose.name!r}"
                slopes[name] = pose.W_ep[effector.index, 0]
    return slopes
