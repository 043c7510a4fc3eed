"""Propose configurations to be measured next, rank them, and find the fewest."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import combinations, product

import numpy as np

from softcal_jax._module import Module, Result
from softcal_jax._text import listed
from softcal_jax._typing import Float, HostArray
from softcal_jax._units import readable_values
from softcal_jax.calibration import as_sequence
from softcal_jax.configurations import (
    STANDARD_GRAVITY,
    Configuration,
    ImposedForce,
    PointForce,
    Support,
    configuration_arrays,
)
from softcal_jax.equilibrium import EquilibriumProgress, Model, NewtonSettings
from softcal_jax.fields import (
    PRECISION,
    Parameters,
    Uncertain,
    as_space,
    asked_errors,
)
from softcal_jax.identifiability._identify import planned, scaled_values, survey
from softcal_jax.identifiability._result import IDENTIFIABLE_UP_TO, spread_of
from softcal_jax.inference import readable_error
from softcal_jax.mesh import box_faces, locate
from softcal_jax.unknowns import AnyArray

MOST_TOGETHER = 4  # most candidates that are combined to reach the target

READINGS = 2, 4, 10, 30, 100, 300, 1000
"""Readings of each pose in place of one, of which the fewest that suffice is named."""


class Gain(Module):
    """What candidates would add if they were measured as well.

    Attributes:
        name: Name of the candidate, or of several.
        errors: Expected standard errors of the parameters with it, over those that are
            asked for [-].
        parameter: Parameter whose error falls most, in these units; with an error that
            was infinite first.
        before: Its standard error without the candidate, in SI; infinite where nothing
            sees it.
        after: Its standard error with it, in SI.
        value: Value of the parameter, in SI.
        unit: Its SI unit.
    """

    name: str
    errors: Float[HostArray, " n_p"]
    parameter: str
    before: float
    after: float
    value: float
    unit: str

    @property
    def cost(self) -> tuple[int, float]:
        """Number of blind parameters, and the squared errors of the others [-]."""
        blind = np.isinf(self.errors)
        return int(blind.sum()), float(np.sum(self.errors[~blind] ** 2))

    @property
    def effect(self) -> str:
        """What becomes of that parameter: "expected error of E: 12 % -> 7 %"."""
        ends = [
            readable_error(e, self.value, self.unit) for e in (self.before, self.after)
        ]
        return f"expected error of {self.parameter}: {ends[0]} -> {ends[1]}"


class Ranking(Result):
    """Candidates, the most informative first.

    Attributes:
        gains: One entry per candidate that can be ranked.
        unranked: Why the others, by name, cannot be ranked.
        reached: Which fewest candidates reach the target, or what else would, in a
            sentence.
        helps: Whether the best one lowers the errors.
    """

    gains: tuple[Gain, ...]
    unranked: dict[str, str]
    reached: str
    helps: bool


def rank_configurations(
    model: Model,
    parameters: Parameters,
    configurations: Configuration | Sequence[Configuration],
    candidates: Configuration | Sequence[Configuration],
    *,
    at: Float[AnyArray, " n_p"] | None = None,
    noise: float | None = None,
    newton: NewtonSettings | None = None,
    uncertain: Uncertain | None = None,
    precision: float = PRECISION,
    progress: Callable[[EquilibriumProgress], None] = lambda _: None,
) -> Ranking:
    """Rank candidate configurations by what they would tell, before measuring.

    Candidates are ordered by the sum of the squared standard errors of the parameters
    that they leave, each in units of the one that is asked for (A-optimality; Chaloner
    and Verdinelli, Statistical Science 10, 1995), by all causes, and first by how many
    parameters stay blind. What suffices is sought among all pairs, and beyond that by
    adding one candidate after another.

    The `configurations` are measured already, and may be none; the `candidates` may be
    measured next, and need other names. Candidates without an equilibrium or markers
    are listed with the reason. Other arguments are those of `identify`.

    Raises:
        ValueError: If an input is wrong, there is no candidate, or a name repeats.
        RuntimeError: If an already measured configuration has no equilibrium.
    """
    known, tried = as_sequence(configurations), as_sequence(candidates)
    if not tried:
        raise ValueError("at least one candidate is needed, got none.")
    space, uncertain = as_space(parameters), uncertain or Uncertain()
    z, names = scaled_values(space, at), [c.name for c in tried]
    problem = planned(model, space, (*known, *tried), noise, newton, uncertain)
    seen = survey(problem, z, len(known), progress)
    asked = asked_errors(space, z, precision, model=model)
    in_si = space.slopes(z) * asked
    values = np.asarray(space.from_scaled(z))

    def with_these(*chosen: str, jitter: float = 1.0) -> Gain:
        left_out = [name for name in names if name not in chosen]
        linear = seen.linear.without(*left_out).with_jitter(jitter)
        errors = spread_of(linear.per(asked)).errors()
        before = errors if not chosen else nothing.errors
        fall = np.where(np.isinf(errors), 0.0, before) - np.where(
            np.isinf(errors), 0.0, errors
        )
        i = int(np.argmax(fall if chosen else errors))
        return Gain(
            name=listed(chosen),
            errors=errors,
            parameter=space.names[i],
            before=float(in_si[i] * before[i]),
            after=float(in_si[i] * errors[i]),
            value=float(values[i]),
            unit=space.parameters[i].unit,
        )

    nothing = with_these()
    reasons = dict(zip(names, seen.failures[len(known) :], strict=True))
    rows = set(seen.linear.pose.tolist())
    for k, name in enumerate(names, start=len(known)):
        if not reasons[name] and k not in rows:
            reasons[name] = "it has no markers to measure"
    usable = [name for name in names if not reasons[name]]
    gains = sorted(map(with_these, usable), key=lambda gain: gain.cost)
    return Ranking(
        gains=tuple(gains),
        unranked={name: reason for name, reason in reasons.items() if reason},
        reached=_reached(with_these, usable, f"{100.0 * precision:.3g} %"),
        helps=bool(gains) and gains[0].cost < nothing.cost,
    )


def _reached(with_these: Callable[..., Gain], names: Sequence[str], target: str) -> str:
    """Say which fewest candidates reach a target, or what else it would take."""
    reached = lambda gain: bool(np.max(gain.errors) <= IDENTIFIABLE_UP_TO)
    best, chosen = with_these(), ()
    for n in range(1, min(len(names), MOST_TOGETHER) + 1):
        if reached(best):
            break
        beside = [(*chosen, name) for name in names if name not in chosen]
        sets = beside if n > 2 else [*combinations(names, n)]
        each = [(with_these(*those), those) for those in sets]
        best, chosen = min(each, key=lambda one: (not reached(one[0]), one[0].cost))
    if reached(best):
        fewest = f"Fewest that reach {target}: {best.name}; {best.effect}."
        return fewest if chosen else f"The poses that are there reach {target}."
    beside = f"with {best.name} ({best.effect})" if chosen else "as it is"
    for n in READINGS:
        if reached(with_these(*chosen, jitter=n**-0.5)):
            return (
                f"No {MOST_TOGETHER} candidates reach {target}: {beside}, it takes {n} "
                f"readings of each pose, or {n**-0.5:.2g} times the noise."
            )
    return (
        f"Nothing in reach gives {target}: {beside}, know what is held fixed better, "
        "or calibrate fewer parameters."
    )


def proposals(
    model: Model, configurations: Sequence[Configuration]
) -> Iterator[Configuration]:
    """Yield candidates that need nothing but the robot, a weight and other commands.

    They change the first configuration in which something is measured: gravity along
    each axis; held by the other end; half of the body's weight at the marker that is
    farthest from what is held; half, and all, of the largest actuation of each
    actuator; and the same again. What the configurations have already is left out, and
    what the model refuses: an end that is a rigid body cannot be held.
    """
    for candidate in _proposed(model, configurations):
        with suppress(ValueError):
            configuration_arrays(model.mesh, [candidate], model.mechanism)
            yield candidate


def _proposed(
    model: Model, configurations: Sequence[Configuration]
) -> Iterator[Configuration]:
    base = next((c for c in configurations if c.markers or c.effectors), None)
    if base is None:
        return
    base = replace(base, after=None)  # from rest
    new = lambda name, **changes: replace(
        base, name=name, measured=None, recording=None, **changes
    )
    yield new(f"{base.name} again")
    size = float(np.linalg.norm(base.gravity)) or STANDARD_GRAVITY
    for sign, k in product((-1.0, 1.0), range(3)):
        gravity = tuple((sign * size * np.eye(3)[k]).tolist())
        if not any(np.allclose(c.gravity, gravity) for c in configurations):
            yield new(f"gravity along {'+-'[sign < 0]}{'xyz'[k]}", gravity=gravity)
    mesh, mechanism = model.mesh, model.mechanism
    arrays = configuration_arrays(mesh, [base], mechanism)
    held = mesh.points[np.asarray(arrays.fixed)[0, : mesh.n_nodes].all(axis=1)]
    if len(held):
        middle = held.mean(axis=0)
        away = lambda nodes: np.linalg.norm(mesh.points[nodes].mean(axis=0) - middle)
        end = max(box_faces(mesh).values(), key=away)
        yield new("the other end held", supports=(Support(end),))
        if base.markers is not None and model.mass > 0.0:
            places = base.markers.positions
            tip = int(np.argmax(np.linalg.norm(places - middle, axis=1)))
            near = locate(mesh, places[[tip]], max_distance=np.inf)
            at = near.weights[0] @ mesh.points[near.nodes[0]]
            weight = float(f"{0.5 * model.mass * STANDARD_GRAVITY:.1g}")
            down = np.array(base.gravity if np.any(base.gravity) else (0.0, 0.0, -1.0))
            force = tuple((weight * down / np.linalg.norm(down)).tolist())
            load = PointForce(tuple(at.tolist()), force)
            name = f"{readable_values([weight], 'N')} at {base.markers.names[tip]}"
            yield new(name, loads=(*base.loads, load))
    actuators = mechanism.actuators
    commands = [(n, v) for c in configurations for n, v in c.actuation.items()]
    for name, kind in zip(actuators.names, actuators.kinds, strict=True):
        of_it = [v for n, v in commands if n == name]
        if not any(v.value for v in of_it):
            continue
        largest = max(of_it, key=lambda v: abs(v.value))
        by_force = isinstance(largest, ImposedForce)
        unit = kind.force_unit if by_force else kind.displacement_unit
        known = [v.value for v in of_it if type(v) is type(largest)]
        for value in (0.5 * largest.value, largest.value):
            if value not in known:
                command = {name: replace(largest, value=value)}
                amount = readable_values([value], unit or "")
                yield new(f"{name} {amount}", actuation=command)
