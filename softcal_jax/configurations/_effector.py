"""Effectors: their rows for the solver (paper Sec. II), arrays, and records of them.

Each is a sensor where it has a measured value; for control this value is its goal.
"""

import math
from abc import abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import count
from typing import Any, Literal, NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import ArrayLike

from softcal_jax._module import Module
from softcal_jax._typing import Bool, Float, HostArray, Int
from softcal_jax._units import readable_values
from softcal_jax.configurations._arrays import EffectorArrays, Observed, RecordingBase
from softcal_jax.configurations._mechanism import Mechanism
from softcal_jax.mesh import TetMesh

Quantity = Literal["point", "turn", "scalar", "force", "reaction", "observation"]
"""What a row of up to three effector coordinates is, for tables and results."""


class Unstated(float):
    """A default standard deviation: it weighs data, but does not state their noise."""


_UNTURNED = np.broadcast_to(np.eye(3), (3, 3))  # which cannot be written to


class EffectorRecord(Module):
    """Up to three coordinates of an effector; results fill in simulated values.

    A frame has two records, one of its point and one of its turn.

    Attributes:
        index: Index of their row in `EffectorArrays`, once they are stacked.
        measured: Measured values, or goals; NaN for a coordinate that was not measured.
            A turn is counted from the measured one.
        std: Their standard deviation; infinite for a coordinate that was not measured.
        reference: Of a turn, the orientation that it is counted from, as a matrix [-].
        at_rest: Of a point, its position on the undeformed robot [m]; otherwise NaN.
        simulated_before: Simulated values with the start parameters; NaN without
            an equilibrium, and where nothing was calibrated.
        simulated: Simulated values of the result; NaN without an equilibrium.
    """

    name: str
    quantity: Quantity
    unit: str
    index: int
    measured: Float[HostArray, " k"]
    std: Float[HostArray, " k"]
    reference: Float[HostArray, "3 3"]
    at_rest: Float[HostArray, " k"]
    simulated_before: Float[HostArray, " k"]
    simulated: Float[HostArray, " k"]

    @classmethod
    def of(
        cls,
        name: str,
        quantity: Quantity,
        unit: str,
        measured: Float[HostArray, " k"],
        std: Float[HostArray, " k"],
        reference: Float[HostArray, "3 3"] = _UNTURNED,
    ) -> "EffectorRecord":
        """Make a record of which nothing is known but what was measured."""
        none = np.full(len(std), np.nan)
        return cls(name, quantity, unit, 0, measured, std, reference, none, none, none)

    @property
    def n_values(self) -> int:
        """Number of coordinates."""
        return len(self.std)

    @property
    def is_turn(self) -> bool:
        return self.quantity == "turn"

    @property
    def seen(self) -> Bool[HostArray, " k"]:
        """Which coordinates were measured."""
        return np.isfinite(self.std)

    @property
    def residual(self) -> Float[HostArray, " k"]:
        """Simulated minus measured values; NaN where not measured."""
        return self.error(self.simulated)

    @property
    def in_std(self) -> Float[HostArray, " k"]:
        """The residual in units of the standard deviation; NaN where not measured."""
        return self.residual / self.std

    @property
    def worst(self) -> float:
        """The largest of these where measured; NaN without an equilibrium [-]."""
        return float(np.max(np.abs(self.in_std[self.seen]), initial=0.0))

    def error(self, values: Float[HostArray, " k"]) -> Float[HostArray, " k"]:
        """Subtract the measured from the given values; NaN where not measured."""
        return np.where(self.seen, values - self.measured, np.nan)

    def distance(self, values: Float[HostArray, " k"]) -> float:
        """Return the length of the error, along what was measured; NaN without any."""
        error = self.error(values)[self.seen]
        return float(np.linalg.norm(error)) if error.size else math.nan

    def among(self, rows: Float[ArrayLike, "n_rows 3"]) -> Float[HostArray, " k"]:
        """Pick its coordinates among those of all rows of a configuration."""
        return np.asarray(rows)[self.index, : self.n_values].copy()


class EffectorRow(NamedTuple):
    """Up to three coordinates of an effector, and where the solver finds them.

    A point is carried by nodes with weights [-], and `slopes` by which these change
    where it lies elsewhere [1/m], if it can; a turn has the index of its body. Other
    quantities have a function, like that of `Observation`.
    """

    record: EffectorRecord
    nodes: Int[HostArray, " n"] = np.zeros(0, np.int32)
    weights: Float[HostArray, " n"] = np.zeros(0)
    slopes: Float[HostArray, "n 3"] = np.zeros((0, 3))
    body: int = 0
    function: Callable[..., Any] | None = None

    @property
    def observed(self) -> Observed | None:
        """The function that identifies the row; None for points and turns."""
        if self.function is None:
            return None
        return Observed(self.record.name, self.record.n_values, self.function)


def effector_row(
    name: str,
    quantity: Quantity,
    unit: str,
    value: float | Float[ArrayLike, "..."] | None,
    std: float | Float[ArrayLike, "..."],
    *,
    n_values: int = 3,
    what: str = "std",
    reference: Float[HostArray, "3 3"] = _UNTURNED,
    **carriers: Any,
) -> EffectorRow:
    """Make a row with a measured value, if there is one; `what` is the key of `std`.

    Raises:
        ValueError: If the value is not as many finite numbers, or `std` not positive.
    """
    stds = np.asarray(std, float)
    bad = stds[~(np.isfinite(stds) & (stds > 0.0))]
    if bad.size:
        raise ValueError(
            f"{what} of effector {name!r} must be positive and finite [{unit}], got "
            f"{bad[0]:g}."
        )
    shape = () if n_values == 1 else (n_values,)
    if value is None:
        value, stds = np.nan, np.inf
    elif np.shape(value) != shape or not np.all(np.isfinite(value)):
        words = {2: "two finite numbers", 3: "three finite numbers"}
        raise ValueError(
            f"effector {name!r} has the value {value}, expected "
            f"{words.get(n_values, 'a finite number')} [{unit}]; leave out what was "
            "not measured."
        )
    measured, stds = np.full(n_values, value, float), np.full(n_values, stds, float)
    record = EffectorRecord.of(name, quantity, unit, measured, stds, reference)
    return EffectorRow(record, **carriers)


Readings = Float[HostArray, "k 3"]
"""Measured values of an effector, one row of coordinates each."""


class AbstractEffector(Module):
    """Something that is measured on the robot, or brought to a goal."""

    name: eqx.AbstractVar[str]

    @abstractmethod
    def rows(self, mesh: TetMesh, mechanism: Mechanism) -> tuple[EffectorRow, ...]:
        """Return its coordinates on a mesh at rest.

        Raises:
            ValueError: If it does not fit the model, or its value is not finite.
        """

    @property
    def n_values(self) -> int:
        """Number of values in a row."""
        return 3

    def measured_as(self, values: Readings, mechanism: Mechanism) -> "AbstractEffector":
        """Return the effector with other measured values, one per row and from rest."""
        value = values[0, : self.n_values]
        measured = value if value.size > 1 else float(value[0])
        return replace(self, measured=measured)  # pyright: ignore

    def _row(
        self, quantity: Quantity, unit: str, **carriers: Any
    ) -> tuple[EffectorRow, ...]:
        """Make the row of an effector that has only one, with its measured value."""
        one: Any = self
        of_each = one.name, quantity, unit, one.measured, one.std
        return (effector_row(*of_each, n_values=self.n_values, **carriers),)


class AbstractScalar(AbstractEffector):
    """An effector of one coordinate: a length, a volume, an angle, a force."""

    @property
    def n_values(self) -> int:
        return 1


def rms_distance(
    records: Iterable[EffectorRecord],
    values: Callable[[EffectorRecord], Float[HostArray, " k"]],
) -> float:
    """Return the root mean square distance of values from what was measured.

    Over the effectors of which a coordinate was measured, each along those coordinates
    that were; NaN without any.
    """
    squares = [e.distance(values(e)) ** 2 for e in records if e.seen.any()]
    return float(np.sqrt(np.mean(squares))) if squares else math.nan


def check_numbers(
    poses: Sequence[str],
    records: Sequence[Sequence[EffectorRecord]],
    values: Float[ArrayLike, "n_c n_rows 3"],
    W_ep: Float[ArrayLike, "n_c n_e n_p"],
) -> None:
    """Raise ValueError if a reading or its derivative is no number somewhere."""
    values = np.asarray(values)
    W_ep = np.asarray(W_ep).reshape(*values.shape, np.shape(W_ep)[-1])
    for name, of_pose, *lane in zip(poses, records, values, W_ep, strict=False):
        for e in of_pose:
            bad = [not np.isfinite(rows[e.index, : len(e.std)]).all() for rows in lane]
            if any(bad):
                what = "value" if bad[0] else "derivative"
                raise ValueError(
                    f"effector {e.name!r} has a {what} that is no number in "
                    f"configuration {name!r}: its function must be smooth there."
                )


EffectorLane = tuple[EffectorArrays, tuple[EffectorRecord, ...]]


def stack_effectors(
    lanes: Sequence[Sequence[EffectorRow]], points: Float[HostArray, "n_points 3"]
) -> list[EffectorLane]:
    """Put rows of each configuration into arrays, and describe each of them.

    The `points` are all nodes at rest [m].
    """
    number = lambda lane, kind: sum(row.record.quantity == kind for row in lane)
    ends = [0]
    for quantity in ("point", "turn"):
        ends.append(ends[-1] + max(number(lane, quantity) for lane in lanes))
    rows = [row for lane in lanes for row in lane]
    # A function has the same row in all lanes, as it is part of their program.
    observed = tuple(dict.fromkeys(o for o in (r.observed for r in rows) if o))
    widest = max((row.nodes.size for row in rows), default=0)
    movable = tuple(dict.fromkeys(r.record.name for r in rows if r.slopes.size))
    stack = partial(_stack, points, ends, widest, movable, observed)
    return [stack(lane) for lane in lanes]


def _stack(
    points: HostArray,
    ends: Sequence[int],
    widest: int,
    movable: tuple[str, ...],
    observed: tuple[Observed, ...],
    lane: Sequence[EffectorRow],
) -> EffectorLane:
    """Fill in rows of points, turns and observations, which begin at the `ends`."""
    following = {"point": count(ends[0]), "turn": count(ends[1])}
    total, records = ends[2] + len(observed), []
    nodes, weights = np.zeros((total, widest), np.int32), np.zeros((total, widest))
    slopes, which = np.zeros((total, widest, 3)), np.zeros(total, np.int32)
    body, reference = np.zeros(total, np.int32), np.tile(np.eye(3), (total, 1, 1))
    measured, inverse_std = np.zeros((2, total, 3))
    for row in lane:
        record, n = row.record, row.record.n_values
        if row.observed is None:
            i = next(following[record.quantity])
        else:
            i = ends[2] + observed.index(row.observed)
        nodes[i, : row.nodes.size] = row.nodes
        weights[i, : row.weights.size] = row.weights
        if row.slopes.size:
            slopes[i, : len(row.slopes)] = row.slopes
            which[i] = movable.index(record.name)
        body[i], reference[i] = row.body, record.reference
        measured[i, :n] = np.nan_to_num(record.measured)
        inverse_std[i, :n] = 1.0 / record.std
        if record.quantity == "point":
            record = replace(record, at_rest=row.weights @ points[row.nodes])
        known = np.where(record.seen, record.measured, np.nan)
        records.append(replace(record, index=i, measured=known))
    of_points, turns = slice(ends[1]), slice(*ends[1:])
    arrays = EffectorArrays(
        nodes=nodes[of_points],
        weights=weights[of_points],
        slopes=slopes[of_points],
        which=which[of_points],
        offset=np.zeros((len(movable), 3)),
        turn_body=body[turns],
        turn_reference=reference[turns],
        measured=measured,
        inverse_std=inverse_std,
        base=RecordingBase(np.zeros(3), np.zeros(3)),
        is_observed=np.isin(np.arange(ends[2], total), [r.index for r in records]),
        movable=movable,
        observed=observed,
    )
    return arrays, tuple(records)


FAR = 3.0
"""Distance, in sizes of the robot, beyond which a point is probably a mistake [-]."""


def motions(records: Iterable[EffectorRecord]) -> dict[str, Float[HostArray, " k"]]:
    """Return how far each point was measured from its place at rest, by name [m]."""
    points = [r for r in records if r.quantity == "point" and r.seen.any()]
    return {r.name: r.error(r.at_rest) for r in points}


def farthest(moved: Mapping[str, Float[HostArray, " k"]], size: float) -> str | None:
    """Describe the point that moved implausibly far, for the size of the robot [m]."""
    distances = {name: math.hypot(*u[np.isfinite(u)]) for name, u in moved.items()}
    name = max(distances, key=distances.__getitem__, default="")
    if not moved or distances[name] <= FAR * size:
        return None
    return (
        f"{name!r} is {readable_values([distances[name]], 'm')} from its place at "
        f"rest, {distances[name] / size:.3g} times the size of the robot "
        f"({readable_values([size], 'm')}): check the unit of length and the frame."
    )
