"""A field of the law with one unknown per control point (paper Sec. IV.A)."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any, Literal, get_args

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike

from softcal_jax._names import check_known, unknown_name
from softcal_jax._typing import Array, Float
from softcal_jax._units import readable_values
from softcal_jax.fields._control_points import ControlPoints
from softcal_jax.fields._model_fields import region_tets, set_field
from softcal_jax.fields._parameters import (
    AbstractFieldEntry,
    Names,
    Parameter,
    Values,
    once,
)
from softcal_jax.mesh import TetMesh

Pair = tuple[str, str]
Interpolation = Literal["linear", "log", "director"]

_LOST = 1e-20
"""Square of rho below which there is no direction [-]."""


def _numbers(value: Float[ArrayLike, "..."] | Sequence[float]) -> Float[Array, "..."]:
    return jnp.asarray(value, float)


def _known(fixed: Mapping[str, Float[ArrayLike, ""]] | None) -> dict[str, Array]:
    return {name: _numbers(value) for name, value in (fixed or {}).items()}


def _pairs(tied: Names | Iterable[Pair] | None) -> tuple[Pair, ...]:
    return tuple(dict(tied or ()).items())


class ControlPointParameters(AbstractFieldEntry):
    """One unknown per control point, spread over the body as a field of the law.

    p(X) = sum_j w_j(X) p_j with the inverse-distance weights w_j, paper Sec. IV.A.
    Options of each unknown, like `scale`, are those of `AbstractFieldEntry`.

    `interpolation` is how values are mixed: "linear" as in the paper; "log" mixes
    logarithms, for moduli that differ by orders of magnitude. "director" is for the
    angle of an axis: the mixed direction is that of sum_j w_j (cos 2 theta_j,
    sin 2 theta_j), so +90 and -90 degrees are the same axis; with "linear", the axis
    between 85 and -85 degrees would turn through 0. Use "director" unless to reproduce
    the paper. Bounds that span 180 degrees then do not bind.

    Where mixed directions nearly cancel, the length rho of that sum is small, and the
    direction turns by a right angle from one tet to the next. Such a defect moves with
    the parameters, and each tet it passes puts a kink into the cost. With a `core` the
    contrast of the moduli fades there: see `contrast`, and `ParameterSpace.axes`.

    Attributes:
        field: Field of the law, like "E_t", "E_l" or "theta"; or "density".
        control_points: Where the values are.
        start: Values before calibration, one for all control points or one for each,
            in SI units.
        lower: Smallest values allowed, likewise.
        upper: Largest values allowed, likewise.
        interpolation: How values are mixed.
        fixed: Known values, by control point.
        tied: Names of other parameters whose value is used, by control point, like
            {"upper 1": "E_t of lower 1"}.
        core: rho below which the contrast fades, like 0.1; with 0 it never does [-].
        periodic: Whether each value is an angle that may leave its bounds.

    Raises:
        ValueError: If a value has the wrong shape, an option or the name of a control
            point is unknown, a director spans more than 180 degrees, or there is a core
            without a director or out of [0, 1).
    """

    field: str = eqx.field(static=True)
    control_points: ControlPoints
    start: Float[Array, " n_cp"] = eqx.field(converter=_numbers)
    lower: Float[Array, " n_cp"] = eqx.field(converter=_numbers)
    upper: Float[Array, " n_cp"] = eqx.field(converter=_numbers)
    interpolation: Interpolation = eqx.field(static=True, default="linear")
    fixed: dict[str, Float[Array, ""]] = eqx.field(default=None, converter=_known)
    tied: tuple[Pair, ...] = eqx.field(static=True, default=None, converter=_pairs)
    core: float = eqx.field(static=True, default=0.0, converter=float)
    periodic: tuple[bool, ...] = eqx.field(static=True, init=False)

    def __post_init__(self):
        n_cp = len(self.control_points.names)
        for name in ("start", "lower", "upper"):
            value = jnp.asarray(getattr(self, name), float)
            if value.shape not in ((), (n_cp,)):
                raise ValueError(
                    f"{name} of {self.field} must be one for all control points or one "
                    f"for each ({n_cp}), got shape {value.shape}."
                )
            setattr(self, name, jnp.broadcast_to(value, (n_cp,)))
        half_turns = np.isclose(self.upper - self.lower, np.pi)
        director = self.interpolation == "director"
        self.periodic = tuple(bool(director and half_turn) for half_turn in half_turns)

    def __check_init__(self):
        known, tied = self.control_points.names, dict(self.tied)
        for name in (*self.fixed, *tied):
            if name not in known:
                what = "fixed" if name in self.fixed else "tied"
                error = unknown_name("control point", name, known)
                raise ValueError(f"{what} of {self.field}: {error}")
        both = sorted(set(self.fixed) & set(tied))
        if both:
            raise ValueError(
                f"control point {both[0]!r} of {self.field} is both fixed and tied."
            )
        check_known("interpolation", get_args(Interpolation), self.interpolation)
        if not 0.0 <= self.core < 1.0:
            raise ValueError(
                f"core of {self.field} must lie in [0, 1), got {self.core:g}: it is a "
                "share of the length that directions have which all agree."
            )
        if self.interpolation == "director":
            span = float(np.max(self.upper - self.lower))
            if span > np.pi * (1 + 1e-9):
                raise ValueError(
                    f"the bounds of {self.field} span {np.rad2deg(span):.0f} degrees: "
                    "an axis is the same again after 180, so give at most that, like "
                    "-90 to 90."
                )
        elif self.core > 0.0:
            raise ValueError(
                f"core of {self.field} is for an angle that is mixed as a director: "
                f'take interpolation="director", got {self.interpolation!r}, or leave '
                "core out."
            )

    def parameter_name(self, control_point: str) -> str:
        """Return the name of the unknown at a control point, maybe of another field."""
        return dict(self.tied).get(control_point, f"{self.field} of {control_point}")

    @once
    def parameters(self) -> tuple[Parameter, ...]:  # pyright: ignore[reportIncompatibleMethodOverride]
        """The unknowns at control points neither fixed nor tied, in their order."""
        keys = ("scale", "S", "region", "unit", "max_step", "prior_std")
        options: dict[str, Any] = {key: getattr(self, key) for key in keys}
        values = zip(self.start, self.lower, self.upper, self.periodic, strict=True)
        return tuple(
            Parameter(
                self.parameter_name(name),
                self.field,
                *limits,
                periodic=half_turn,
                **options,
            )
            for name, (*limits, half_turn) in zip(
                self.control_points.names, values, strict=True
            )
            if name not in self.fixed and name not in dict(self.tied)
        )

    @property
    def fields(self) -> tuple[str, ...]:
        return (self.field,)

    @property
    def label(self) -> str:
        return f"{self.field} of {', '.join(self.control_points.names)}"

    def _weights(self, mesh: TetMesh) -> Float[Array, "n_tets n_cp"]:
        """Return the weights of the control points at the centroids of the tets [-]."""
        # As `TetMesh.centroids`, but of a traced mesh as well.
        centroids = mesh.points[mesh.tets[:, :4]].mean(axis=1)
        if self.region is not None:
            centroids = centroids[mesh.tets_of(self.region)]
        return self.control_points.weights(centroids)

    def _at_points(self, values: Values) -> Float[Array, " n_cp"]:
        """Return the values at the control points, known ones included."""
        names = self.control_points.names
        known = {
            n: values[self.parameter_name(n)] for n in names if n not in self.fixed
        }
        return jnp.stack([(known | self.fixed)[name] for name in names])

    def evaluate(self, mesh: TetMesh, values: Values) -> Float[Array, " n_tets"]:
        """Evaluate the field, from the values of all parameters by name.

        There is one value per tet of the region, that at its centroid, in SI units.
        """
        weights, at_points = self._weights(mesh), self._at_points(values)
        if self.interpolation == "log":
            return jnp.exp(weights @ jnp.log(at_points))
        if self.interpolation == "linear":
            return weights @ at_points
        c, s = _direction(weights, at_points)
        # Half way between perpendicular axes there is neither a mean direction nor its
        # derivative: such a point gets the constant angle 0.
        lost = c**2 + s**2 < _LOST
        c, s = jnp.where(lost, 1.0, c), jnp.where(lost, 0.0, s)
        return 0.5 * jnp.arctan2(s, c)

    def contrast(self, mesh: TetMesh, values: Values) -> Float[Array, " n_tets"]:
        """Compute the share of ln(E_l / E_s) that remains after fading [-].

        rho sqrt(1 + core^2) / sqrt(rho^2 + core^2): 1 where all directions agree, and
        0 where there is none. The tensor of the axis is then a smooth function of the
        parameters. Arguments and shape are those of `evaluate`.
        """
        c, s = _direction(self._weights(mesh), self._at_points(values))
        square = c**2 + s**2
        rho = jnp.sqrt(jnp.maximum(square, _LOST))
        return rho * jnp.sqrt((1.0 + self.core**2) / (square + self.core**2))

    def apply(self, model: Any, configuration: Any, values: Values) -> tuple[Any, Any]:
        return self.set_on(model, self.evaluate(model.mesh, values)), configuration

    def set_on(self, model: Any, field: Float[Array, " n_tets"]) -> Any:
        """Set values of this field, as from `evaluate`, in a model."""
        return set_field(model, self.field, field, self.region)

    def check(self, model: Any) -> None:
        """Raise ValueError unless every control point lies near the body and acts."""
        points, mesh = self.control_points, model.mesh
        tets = mesh.tets[region_tets(mesh, self.region)]
        nodes = mesh.points[np.unique(tets)][:, points.columns]
        diagonal = float(np.linalg.norm(np.ptp(nodes, axis=0)))
        reach = 0.1 * diagonal if points.max_distance is None else points.max_distance
        # Distances are to nodes, of which none is near inside a coarse tet.
        edges = mesh.points[mesh.tets[:, :4]][:, :, points.columns]
        coarse = float(np.max(np.linalg.norm(np.ptp(edges, axis=1), axis=1)))
        positions = np.asarray(points.positions)[:, points.columns]
        for name, x in zip(points.names, positions, strict=True):
            distance = float(np.min(np.linalg.norm(nodes - x, axis=1)))
            if distance > max(reach, 0.5 * coarse):
                where = "the body" if self.region is None else repr(self.region)
                far, near = (
                    readable_values([d], "m", digits=3) for d in (distance, reach)
                )
                raise ValueError(
                    f"control point {name!r} of {self.field} lies {far} from {where}, "
                    f"more than max_distance, {near}. Check its unit and frame, or "
                    "raise max_distance."
                )
        strongest = np.asarray(self._weights(mesh)).max(axis=0)
        why = f"nearest is {points.nearest}. Raise `nearest`"
        if points.nearest is None:
            why = f"power {points.power:g}. Lower `power`"
        for name, weight in zip(points.names, strongest, strict=True):
            if weight == 0.0 and name not in self.fixed:
                raise ValueError(
                    f"control point {name!r} of {self.field} acts on no tet: all are "
                    f"nearer to others, with {why}, or move it."
                )

    def renamed(self, points: Names, names: Names) -> "ControlPointParameters":
        """Return the same field with other names, and without its unit."""
        old = self.control_points
        return replace(
            self,
            control_points=replace(old, names=[points[name] for name in old.names]),
            unit="",
            fixed={points[name]: value for name, value in self.fixed.items()},
            tied={points[name]: names[other] for name, other in self.tied},
        )


def _direction(weights, angles):
    """Mix directions: cosine and sine of twice the angle, times the length rho."""
    return weights @ jnp.cos(2.0 * angles), weights @ jnp.sin(2.0 * angles)
