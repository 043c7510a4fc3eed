"""Material axes with two moduli: their steps as a tensor, and where contrast fades."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import jax.numpy as jnp

from softcal_jax._typing import Array, Float, HostArray, Int
from softcal_jax.fields._parameters import AbstractEntry
from softcal_jax.fields._spread import ControlPointParameters

_NEARLY_ISOTROPIC = 1e-7
"""Smallest d: at 0 the angle and the derivatives along c and s are undefined [-]."""


class AxisChart(NamedTuple):
    """Step coordinates of axes: the components of a tensor, regular at isotropy.

    {E_s, E_l, theta} (smaller and larger modulus, angle of the material axis) are polar
    coordinates of a symmetric tensor in the print plane: with m = (ln E_l + ln E_s) / 2
    and d = (ln E_l - ln E_s) / 2 >= 0, its logarithm has the components

        m,  c = d cos 2 theta,  s = d sin 2 theta.

    Polar coordinates have two traps for a Gauss-Newton step. The angle winds: 181
    degrees is the same axis as 1 degree, but far away. And at E_s = E_l the angle has
    no effect: a fit whose axis is a quarter turn wrong is driven there and stays.
    (m, c, s) avoid both, E_s <= E_l always holds, and a step across the origin turns
    the axis by 90 degrees, as it should. The parameters remain {E_s, E_l, theta}.

    Attributes:
        small: Columns of ln E_s in z, one per axis.
        large: Columns of ln E_l.
        angle: Columns of theta / S.
        S: Scale of the angles [rad].
    """

    small: Int[HostArray, " n_axes"]
    large: Int[HostArray, " n_axes"]
    angle: Int[HostArray, " n_axes"]
    S: Float[Array, " n_axes"]

    def to_tensor(self, z: Float[Array, " n_p"]) -> Float[Array, " n_p"]:
        """Replace (ln E_s, ln E_l, theta / S) by (m, c, s)."""
        m = 0.5 * (z[self.large] + z[self.small])
        d = 0.5 * (z[self.large] - z[self.small])
        twice = 2.0 * self.S * z[self.angle]
        z = z.at[self.small].set(m).at[self.large].set(d * jnp.cos(twice))
        return z.at[self.angle].set(d * jnp.sin(twice))

    def from_tensor(self, tensor: Float[Array, " n_p"]) -> Float[Array, " n_p"]:
        """Invert `to_tensor`, with angles between -90 and 90 degrees."""
        m, c, s = tensor[self.small], tensor[self.large], tensor[self.angle]
        d = jnp.sqrt(c**2 + s**2)
        theta = 0.5 * jnp.arctan2(s, c) / self.S
        z = tensor.at[self.small].set(m - d).at[self.large].set(m + d)
        return z.at[self.angle].set(theta)

    def clip(
        self,
        z: Float[Array, " n_p"],
        lower: Float[Array, " n_p"],
        upper: Float[Array, " n_p"],
    ) -> Float[Array, " n_p"]:
        """Clip the moduli to their bounds, keeping them slightly apart."""
        gap = 2.0 * _NEARLY_ISOTROPIC
        s, l = self.small, self.large
        top = jnp.clip(z[l], jnp.maximum(lower[l], lower[s] + gap), upper[l])
        low = jnp.minimum(jnp.clip(z[s], lower[s], upper[s]), top - gap)
        return z.at[s].set(low).at[l].set(top)


class FadingAxis(NamedTuple):
    """The three fields of an axis whose angle has a core."""

    small: ControlPointParameters
    large: ControlPointParameters
    angle: ControlPointParameters

    def apply(self, model: Any, values: Mapping[str, Float[Array, ""]]) -> Any:
        """Reduce the contrast of the moduli in the cores; their geometric mean stays.

        Args:
            model: The model, with the three fields as without a core.
            values: Values of all parameters by name, in SI units.
        """
        low = jnp.log(self.small.evaluate(model.mesh, values))
        high = jnp.log(self.large.evaluate(model.mesh, values))
        middle, half = 0.5 * (high + low), 0.5 * (high - low)
        half = half * self.angle.contrast(model.mesh, values)
        model = self.small.set_on(model, jnp.exp(middle - half))
        return self.large.set_on(model, jnp.exp(middle + half))


def fading_axes(
    entries: tuple[AbstractEntry, ...], axes: tuple[tuple[str, ...], ...]
) -> list[FadingAxis]:
    """Return the axes whose angle has a core.

    Raises:
        ValueError: If an angle with a core belongs to no axis, or if the moduli of its
            axis are not sampled where it is.
    """
    fields = [e for e in entries if isinstance(e, ControlPointParameters)]
    found = []
    for angle in fields:
        if angle.core == 0.0:
            continue
        its = [axis for axis in axes if axis[2] == angle.field]
        if not its:
            raise ValueError(
                f"{angle.field} has a core, in which the contrast of two moduli fades: "
                f'say which in axes, like ("E_l", "E_t", "{angle.field}"), or leave '
                "core out."
            )
        where = (angle.region, angle.sampling)
        beside = {e.field: e for e in fields if (e.region, e.sampling) == where}
        for field in its[0]:
            if field not in beside:
                raise ValueError(
                    f"{angle.field} has a core, and {field} is not sampled where it "
                    f"is: give both region={angle.region!r} and "
                    f"sampling={angle.sampling!r}, or leave core out."
                )
        found.append(FadingAxis(*(beside[field] for field in its[0])))
    return found
