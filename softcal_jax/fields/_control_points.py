"""Control points, and fields with one unknown at each (paper Sec. IV.A)."""

from collections.abc import Iterable, Mapping
from dataclasses import replace
from functools import partial
from typing import Any, Literal, get_args

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike

from softcal_jax._lanes import unstacked
from softcal_jax._module import Module, key
from softcal_jax._text import check_known, parse_axes
from softcal_jax._typing import Array, Float, HostArray, is_traced, numpy_of
from softcal_jax._units import readable_values
from softcal_jax.fields._parameters import (
    AbstractFieldEntry,
    Names,
    Parameter,
    Values,
    as_values,
    once,
    region_tets,
    set_field,
)
from softcal_jax.mesh import TetMesh


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
            repeat or are given twice, or an option is out of its range.
    """

    positions: Float[Array, "n_cp 3"] = eqx.field(
        converter=as_values,
        metadata=key(
            words='names and positions, { "CP 1" = "(0, 7.5, 7.5) mm" }, or a list of '
            "positions"
        ),
    )
    names: tuple[str, ...] = eqx.field(static=True, default=(), converter=tuple)
    power: float = eqx.field(
        static=True, default=2.0, converter=float, metadata=key("")
    )
    nearest: int | None = eqx.field(static=True, default=None)
    axes: str = eqx.field(static=True, default="xyz")
    max_distance: float | None = eqx.field(
        static=True, default=None, metadata=key("m", size="not negative")
    )

    def __post_init__(self):
        given: Any = self.positions
        if isinstance(given, Mapping):
            if self.names:
                raise ValueError("`positions` names its points: leave `names` out.")
        else:
            every = enumerate(np.asarray(given, float), start=1)
            given = {f"CP {i}": x for i, x in every}
        if not given:
            raise ValueError("at least one control point is needed, got none.")
        for name, x in given.items():
            if np.shape(x) != (3,) or not np.all(np.isfinite(x)):
                raise ValueError(
                    f"control point {name!r} needs three finite numbers [m], got {x}."
                )
        self.names = self.names or tuple(given)
        self.positions = jax.device_put(np.array([*given.values()], float))

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
            raise ValueError(f"nearest must be from 1 to {len(x)}, got {self.nearest}.")
        if self.max_distance is not None and not self.max_distance >= 0.0:
            raise ValueError(
                f"max_distance must not be negative [m], got {self.max_distance:g}."
            )
        x = x[:, self.columns]  # `columns` checks the axes
        size = max(float(np.abs(x).max()), np.finfo(float).tiny)
        gaps = np.linalg.norm(x[:, None] - x[None], axis=2)
        for i, j in np.argwhere(np.triu(gaps <= 1e-9 * size, k=1)):
            raise ValueError(
                f"control points {self.names[i]!r} and {self.names[j]!r} coincide "
                f"along {self.axes}: no data tell them apart. Remove one, or move it."
            )

    @property
    def columns(self) -> list[int]:
        """Columns of a position that count for the distance."""
        return parse_axes(self.axes)

    def weights(self, points: Float[ArrayLike, "n 3"]) -> Float[Array, "n n_cp"]:
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


Pair = tuple[str, str]
Interpolation = Literal["linear", "log", "director"]

_LOST = 1e-20  # square of rho below which there is no direction [-]


def _known(fixed: Mapping[str, Float[ArrayLike, ""]] | None) -> dict[str, Array]:
    return {name: as_values(value) for name, value in (fixed or {}).items()}


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
    start: Float[Array, " n_cp"] = eqx.field(converter=as_values)
    lower: Float[Array, " n_cp"] = eqx.field(converter=as_values)
    upper: Float[Array, " n_cp"] = eqx.field(converter=as_values)
    interpolation: Interpolation = eqx.field(static=True, default="linear")
    fixed: dict[str, Float[Array, ""]] = eqx.field(default=None, converter=_known)
    tied: tuple[Pair, ...] = eqx.field(static=True, default=None, converter=_pairs)
    core: float = eqx.field(static=True, default=0.0, converter=float)
    periodic: tuple[bool, ...] = eqx.field(static=True, init=False)

    def __post_init__(self):
        n_cp = len(self.control_points.names)
        for name in ("start", "lower", "upper"):
            value: Any = getattr(self, name)
            xp = numpy_of(value)
            value = xp.asarray(value, float)
            if value.shape not in ((), (n_cp,)):
                raise ValueError(
                    f"{name} of {self.field} must be one for all control points or one "
                    f"for each ({n_cp}), got shape {value.shape}."
                )
            setattr(self, name, jax.device_put(xp.broadcast_to(value, (n_cp,))))
        half_turns = np.isclose(self._span, np.pi)
        director = self.interpolation == "director"
        self.periodic = tuple(bool(director and half_turn) for half_turn in half_turns)

    def __check_init__(self):
        known, tied = self.control_points.names, dict(self.tied)
        check_known(f"control point in fixed of {self.field}:", known, *self.fixed)
        check_known(f"control point in tied of {self.field}:", known, *tied)
        both = sorted(set(self.fixed) & set(tied))
        if both:
            raise ValueError(f"{both[0]!r} of {self.field} is both fixed and tied.")
        check_known("interpolation", get_args(Interpolation), self.interpolation)
        if not 0.0 <= self.core < 1.0:
            raise ValueError(f"core of {self.field} is {self.core:g}, not in [0, 1).")
        if self.interpolation == "director":
            span = float(np.max(self._span))
            if span > np.pi * (1 + 1e-9):
                raise ValueError(
                    f"the bounds of {self.field} span {np.rad2deg(span):.0f} degrees: "
                    "an axis is the same again after 180, as from -90 to 90."
                )
        elif self.core > 0.0:
            raise ValueError(
                f'core of {self.field} needs interpolation="director", got '
                f"{self.interpolation!r}; or leave core out."
            )

    @property
    def _span(self) -> Float[HostArray, " n_cp"]:
        return np.asarray(self.upper) - np.asarray(self.lower)

    def parameter_name(self, control_point: str) -> str:
        """Return the name of the unknown at a control point, maybe of another field."""
        return dict(self.tied).get(control_point, f"{self.field} of {control_point}")

    @once
    def parameters(self) -> tuple[Parameter, ...]:  # pyright: ignore[reportIncompatibleMethodOverride]
        """The unknowns at control points neither fixed nor tied, in their order."""
        keys = ("scale", "S", "region", "unit", "max_step", "prior_std")
        options: dict[str, Any] = {key: getattr(self, key) for key in keys}
        names, known = self.control_points.names, {*self.fixed, *dict(self.tied)}
        limits = self.start, self.lower, self.upper
        each = (list(v) if is_traced(v) else unstacked(v) for v in limits)
        values = zip(*each, self.periodic, strict=True)
        unknowns = []
        for point, (*limits, periodic) in zip(names, values, strict=True):
            if point not in known:
                name = self.parameter_name(point)
                options["periodic"] = periodic
                unknowns.append(Parameter(name, self.field, *limits, **options))
        return tuple(unknowns)

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

    def neighbours(self, mesh: TetMesh) -> list[tuple[str, str]]:
        """List pairs of control points that are the nearest two of some tet."""
        points = self.control_points
        names, columns = points.names, points.columns
        if len(names) == 1:
            return []
        where = np.asarray(points.positions)[:, columns]
        centroids = np.asarray(mesh.centroids)[region_tets(mesh, self.region)]
        away = np.linalg.norm(centroids[:, None, columns] - where, axis=2)
        nearest = np.sort(np.argsort(away, axis=1)[:, :2], axis=1)
        return [(names[i], names[j]) for i, j in np.unique(nearest, axis=0)]

    def _at_points(self, values: Values) -> list[Array]:
        """Return the values at the control points, known ones included."""
        of = lambda n: values[self.parameter_name(n)]
        names, fixed = self.control_points.names, self.fixed
        return [fixed[n] if n in fixed else of(n) for n in names]

    def evaluate(self, mesh: TetMesh, values: Values) -> Float[Array, " n_tets"]:
        """Evaluate the field, from the values of all parameters by name.

        There is one value per tet of the region, that at its centroid, in SI units.
        """
        return _mixed(self.interpolation, self._weights(mesh), self._at_points(values))

    def contrast(self, mesh: TetMesh, values: Values) -> Float[Array, " n_tets"]:
        """Compute the share of ln(E_l / E_s) that remains after fading [-].

        rho sqrt(1 + core^2) / sqrt(rho^2 + core^2): 1 where all directions agree, and
        0 where there is none. The tensor of the axis is then a smooth function of the
        parameters. Arguments and shape are those of `evaluate`.
        """
        c, s = _direction(self._weights(mesh), jnp.stack(self._at_points(values)))
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
                show = lambda distance: readable_values([distance], "m", digits=3)
                raise ValueError(
                    f"control point {name!r} of {self.field} is {show(distance)} from "
                    f"{where}: check its frame, or raise max_distance, {show(reach)}."
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


@partial(jax.jit, static_argnums=0)
def _mixed(interpolation: Interpolation, weights, values: list[Array]):
    """Compute `ControlPointParameters.evaluate` in one program."""
    at_points = jnp.stack(values)
    if interpolation == "log":
        return jnp.exp(weights @ jnp.log(at_points))
    if interpolation == "linear":
        return weights @ at_points
    c, s = _direction(weights, at_points)
    # Half way between perpendicular axes there is neither a mean direction nor its
    # derivative: such a point gets the constant angle 0.
    lost = c**2 + s**2 < _LOST
    c, s = jnp.where(lost, 1.0, c), jnp.where(lost, 0.0, s)
    return 0.5 * jnp.arctan2(s, c)


def _direction(weights, angles):
    """Mix directions: cosine and sine of twice the angle, times the length rho."""
    return weights @ jnp.cos(2.0 * angles), weights @ jnp.sin(2.0 * angles)
