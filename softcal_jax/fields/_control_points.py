"""Control points and inverse-distance weighting (paper Sec. IV.A)."""

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike

from softcal_jax._module import Module
from softcal_jax._names import parse_axes
from softcal_jax._typing import Array, Float, HostArray

Places = (
    Float[ArrayLike, "n_cp 3"]
    | Sequence[Sequence[float] | HostArray]
    | Mapping[str, Sequence[float] | HostArray]
)


def _as_array(positions: Places) -> Float[Array, "n_cp 3"]:
    # Checked and stacked before, in `__post_init__`.
    return jnp.asarray(positions)


class ControlPoints(Module):
    """Places where the fields of a law have values of their own.

    Attributes:
        positions: Positions in the frame of the mesh at rest [m], or a mapping of
            names to them.
        names: One name per control point; "CP 1", "CP 2", ... by default.
        power: Exponent of the inverse-distance weighting [-]; the paper settles on 2.
        nearest: How many of the nearest control points act on a tet; all by default.
            The field jumps where this set changes.
        axes: Coordinate axes that count for the distance. With "xz" the field does not
            depend on y, so that two equal sheets can share one.
        max_distance: Largest distance of a control point from the mesh [m]; by default
            a tenth of the diagonal of its region.

    Raises:
        ValueError: If a position is not three finite numbers, two coincide, names
            repeat, or an option is out of its range.
    """

    positions: Float[Array, "n_cp 3"] = eqx.field(converter=_as_array)
    names: tuple[str, ...] = eqx.field(static=True, default=(), converter=tuple)
    power: float = eqx.field(static=True, default=2.0, converter=float)
    nearest: int | None = eqx.field(static=True, default=None)
    axes: str = eqx.field(static=True, default="xyz")
    max_distance: float | None = eqx.field(static=True, default=None)

    def __post_init__(self):
        given: Any = self.positions
        if isinstance(given, Mapping):
            self.names = self.names or tuple(given)
            for name, x in given.items():
                if np.shape(x) != (3,):
                    raise ValueError(
                        f"control point {name!r} needs three numbers [m], got {x}."
                    )
            given = list(given.values())
        x = np.asarray(given, float)
        if x.ndim != 2 or x.shape[1] != 3 or not len(x):
            raise ValueError(
                "control points need positions of shape (number, 3) [m], at least one; "
                f"got shape {x.shape}."
            )
        self.names = self.names or tuple(f"CP {i + 1}" for i in range(len(x)))
        self.positions = jnp.asarray(x)

    def __check_init__(self):
        x = np.asarray(self.positions)
        if len(self.names) != len(x) or len(set(self.names)) != len(x):
            raise ValueError(
                f"{len(x)} control points need as many different names, got "
                f"{', '.join(self.names)}."
            )
        if not (np.isfinite(self.power) and self.power > 0.0):
            raise ValueError(
                f"power must be positive and finite, got {self.power:g}: with 0 every "
                "control point would count the same everywhere; the paper takes 2."
            )
        if self.nearest is not None and not 1 <= self.nearest <= len(x):
            raise ValueError(
                "nearest must lie between 1 and the number of control points, "
                f"{len(x)}, got {self.nearest}."
            )
        if self.max_distance is not None and not self.max_distance >= 0.0:
            raise ValueError(
                f"max_distance must not be negative [m], got {self.max_distance:g}."
            )
        bad = np.flatnonzero(~np.isfinite(x).all(axis=1))
        if bad.size:
            raise ValueError(
                f"control point {self.names[bad[0]]!r} lies at {x[bad[0]]}: expected "
                "three finite numbers [m]."
            )
        x = x[:, self.columns]  # `columns` checks the axes
        size = max(float(np.abs(x).max()), np.finfo(float).tiny)
        gaps = np.linalg.norm(x[:, None] - x[None], axis=2)
        for i, j in np.argwhere(np.triu(gaps <= 1e-9 * size, k=1)):
            raise ValueError(
                f"control points {self.names[i]!r} and {self.names[j]!r} coincide "
                f"along {self.axes}: the data could never tell their values apart. "
                "Remove one, or move it."
            )

    @property
    def columns(self) -> list[int]:
        """Columns of a position that count for the distance."""
        return parse_axes(self.axes)

    def weights(
        self, points: Float[ArrayLike, "n_points 3"]
    ) -> Float[Array, "n_points n_cp"]:
        """Compute weights that spread values at control points over other points [-].

        Inverse-distance weighting, paper Sec. IV.A (Shepard 1968): w_ij is proportional
        to d_ij^-power, with d_ij the distance from point i [m] to control point j. Rows
        sum to one; a point on a control point takes that control point alone.
        """
        x, c = (jnp.asarray(p, float) for p in (points, self.positions))
        return _weights(x, c, self.power, tuple(self.columns), self.nearest)


@partial(jax.jit, static_argnums=(3, 4))
def _weights(x, c, power, columns: tuple[int, ...], nearest: int | None):
    """Compute `ControlPoints.weights` in one program."""
    x, c = x[:, columns], c[:, columns]
    squares = jnp.sum((x[:, None] - c[None]) ** 2, axis=2)
    # On a control point: the limit, with a derivative of zero instead of 0 / 0.
    squares = jnp.maximum(squares, jnp.finfo(squares.dtype).tiny)
    # Logarithms avoid overflow of the power.
    nearness = -0.5 * power * jnp.log(squares)
    if nearest is not None and nearest < len(c):
        reach = jnp.sort(squares, axis=1)[:, nearest - 1 : nearest]
        nearness = jnp.where(squares <= reach, nearness, -jnp.inf)
    return jax.nn.softmax(nearness, axis=1)
