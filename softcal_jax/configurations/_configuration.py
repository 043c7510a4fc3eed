"""One posed robot: how it is held and loaded, what was measured on it, and how far."""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import combinations
from typing import Any, Literal, NamedTuple

import equinox as eqx
import jax
import numpy as np

from softcal_jax._lanes import stacked
from softcal_jax._module import Module
from softcal_jax._text import (
    UNNAMED_LOADS,
    check_unique,
    listed,
    name_key,
    suggestion,
)
from softcal_jax._typing import Float, HostArray, Int, is_traced
from softcal_jax._units import readable_values
from softcal_jax.bodies import KINDS, BodyStateArrays, optional, three_numbers
from softcal_jax.configurations import _mechanism as mechanisms
from softcal_jax.configurations._arrays import (
    ConfigurationArrays,
    DeadLoads,
    EffectorArrays,
    Springs,
)
from softcal_jax.configurations._boundary import (
    AbstractLoad,
    NodalForces,
    PointForce,
    Support,
    check_apart,
    check_held,
    coupled_springs,
)
from softcal_jax.configurations._effector import (
    AbstractEffector,
    EffectorRecord,
    EffectorRow,
    Unstated,
    stack_effectors,
)
from softcal_jax.configurations._markers import Markers
from softcal_jax.configurations._mechanism import Mechanism
from softcal_jax.mesh import TetMesh

STANDARD_GRAVITY = 9.80665
"""Standard acceleration of gravity [m/s2]."""


NodesOrGroup = str | Int[HostArray, " n"]


def _as_supports(
    given: Support | NodesOrGroup | Iterable[Support | NodesOrGroup],
) -> tuple[Support, ...]:
    several = [given] if isinstance(given, str | Support | np.ndarray) else given
    return tuple(s if isinstance(s, Support) else Support(s) for s in several)


def _as_loads(loads: AbstractLoad | Iterable[AbstractLoad]) -> tuple[AbstractLoad, ...]:
    return (loads,) if isinstance(loads, AbstractLoad) else tuple(loads)


class Configuration(Module):
    """A static pose of the robot.

    Attributes:
        name: Name in results, tables and pictures.
        supports: How the body is held: one or several; the name of a group, or an array
            of node indices, clamps it.
        gravity: Acceleration of gravity, in the frame of the mesh [m/s2].
        loads: Dead loads, one or several.
        markers: Points that are measured or followed; may be left out.
        measured: Measured marker positions in the frame of the mesh [m].
        effectors: What else is measured or followed: frames of rigid bodies, lengths,
            volumes, angles, forces. Each has its own measured value.
        bodies: States of rigid bodies, by name: a `Pose` where they are held, "held",
            "hinged", or a `BodyState`; bodies not named are free.
        actuation: What is imposed on actuators, by name: `ImposedForce` or
            `ImposedDisplacement`. Others have no force; other motors stay at zero.
        recording: Name of the recording that its measured values are from, by default
            one of its own. Its configurations share errors, like that of its frame.
        relative_std: Standard deviation of a share of the measured motion of its
            points, common to all of them: creep, or hysteresis [-]. "estimated" finds
            one share for all configurations that say so.
        displacement_from: Name of a configuration, fitted as well, from which the
            displacement of points and the motion of frames count instead of their
            positions and orientations: the robot at rest under gravity, say. Where a
            marker is glued then does not matter, nor how a sensor is mounted if that
            is known to some degrees. Lengths, angles and forces count as they are.
        after: Name of a configuration from whose equilibrium this one begins, like
            "pressed" for one that is pressed, then pushed. Friction remembers it, and
            what that came after; obstacles start where they did there. By default it
            begins at rest.
    """

    name: str
    supports: tuple[Support, ...] = eqx.field(converter=_as_supports, default=())
    gravity: tuple[float, float, float] = (0.0, 0.0, -STANDARD_GRAVITY)
    loads: tuple[AbstractLoad, ...] = eqx.field(converter=_as_loads, default=())
    markers: Markers | None = None
    measured: Float[HostArray, "n_markers 3"] | None = eqx.field(
        converter=optional, default=None
    )
    effectors: tuple[AbstractEffector, ...] = eqx.field(converter=tuple, default=())
    bodies: mechanisms.BodyStates = eqx.field(default_factory=dict)
    actuation: mechanisms.Actuation = eqx.field(default_factory=dict)
    recording: str | None = None
    relative_std: float | Literal["estimated"] = 0.0
    displacement_from: str | None = None
    after: str | None = None

    @property
    def is_measured(self) -> bool:
        """Whether a marker or an effector has a measured value."""
        return bool(self._measured())

    def _measured(self) -> list[Any]:
        """List the effectors with measured values, and the markers if they have any."""
        seen = [e for e in self.effectors if getattr(e, "measured", None) is not None]
        return seen if self.measured is None else [*seen, self.markers]

    @property
    def states_noise(self) -> bool:
        """Whether the standard deviation of all that is measured was stated."""
        keys = "std", "std_angle"
        errors = [getattr(e, key, 0.0) for e in self._measured() for key in keys]
        return not any(isinstance(error, Unstated) for error in errors)

    def __check_init__(self):
        what = f"gravity of configuration {self.name!r}"
        three_numbers(what, "m/s2", self.gravity, "lane.gravity")
        share = self.relative_std
        if share != "estimated" and not (np.isfinite(share) and share >= 0.0):
            raise ValueError(
                f"relative_std of configuration {self.name!r} must be a share of the "
                f'motion, zero or more, or "estimated"; got {share}.'
            )
        if self.measured is not None:
            if self.markers is None:
                raise ValueError(f"{self.name!r} has measured positions, no markers.")
            self.markers.check_measured(self.measured, self.name)

    def rows(self, mesh: TetMesh, mechanism: Mechanism) -> list[EffectorRow]:
        """List coordinates of its effectors: markers first, then the others.

        Raises:
            ValueError: If two have one name, or one does not fit the model.
        """
        rows: list[EffectorRow] = []
        try:
            if self.markers is not None:
                rows += self.markers.rows(mesh, self.measured)
            for effector in self.effectors:
                if effector.name in [row.record.name for row in rows]:
                    raise ValueError(
                        f"effector {effector.name!r} has the name of another one."
                    )
                rows += effector.rows(mesh, mechanism)
        except ValueError as error:
            raise ValueError(f"configuration {self.name!r}: {error}") from error
        return rows

    def measured_as(
        self, values: Float[HostArray, "n 3"], mesh: TetMesh, mechanism: Mechanism
    ) -> "Configuration":
        """Replace the measured values of all effectors; turns count from rest."""
        used = 0 if self.markers is None else len(self.markers.names)
        measured, effectors = None if self.markers is None else values[:used], []
        for effector in self.effectors:
            n = len(effector.rows(mesh, mechanism))
            effectors.append(effector.measured_as(values[used : used + n], mechanism))
            used += n
        return replace(self, measured=measured, effectors=tuple(effectors))

    def measured_at_rest(self, mesh: TetMesh, mechanism: Mechanism) -> "Configuration":
        """Give all effectors placeholder values, so that all count.

        Raises:
            ValueError: If it has neither markers nor other effectors.
        """
        if self.markers is None and not self.effectors:
            raise ValueError(
                f"configuration {self.name!r} has no markers or effectors."
            )
        rest = np.zeros((len(self.rows(mesh, mechanism)), 3))
        if self.markers is not None:
            rest[: len(self.markers.names)] = self.markers.positions
        return self.measured_as(rest, mesh, mechanism)


class ConfigurationLanes(NamedTuple):
    """Arrays with one lane per configuration, and records of the effectors of each."""

    arrays: ConfigurationArrays
    effectors: tuple[tuple[EffectorRecord, ...], ...]


def configuration_arrays(
    mesh: TetMesh,
    configurations: Sequence[Configuration],
    mechanism: Mechanism | None = None,
) -> ConfigurationArrays:
    """Return only the arrays of `configuration_lanes`."""
    return configuration_lanes(mesh, configurations, mechanism).arrays


def configuration_lanes(
    mesh: TetMesh,
    configurations: Sequence[Configuration],
    mechanism: Mechanism | None = None,
) -> ConfigurationLanes:
    """Stack configurations of one mesh, and describe their effectors.

    Args:
        mesh: The mesh that all of them share.
        configurations: At least one; they may differ in everything but the mesh.
        mechanism: Rigid bodies and actuators of the model; none by default.

    Raises:
        ValueError: If there is none, names repeat, one is not held, what it names is
            unknown, a body has held nodes, or a marker stands too far from the mesh.
    """
    if not configurations:
        raise ValueError("at least one configuration is needed, got none.")
    if any(map(is_traced, jax.tree.leaves(mesh))):
        raise ValueError(
            f"configuration {configurations[0].name!r} cannot be put on a mesh that is "
            "traced: make lanes(model, poses) outside of jit and autodiff, and solve "
            "those. What the mesh carries follows its points."
        )
    mechanism = mechanisms.build_mechanism(mesh) if mechanism is None else mechanism
    mechanism.check_on(mesh)
    names = [c.name for c in configurations]
    check_unique("configuration", names)
    n_stages = _n_stages(configurations) * any(mechanism.contacts.sticks)
    _check_present(mechanism, configurations)
    supports = [support for c in configurations for support in c.supports]
    elastic = dict.fromkeys(s.name for s in supports if s.stiffness is not None)
    # Those of all supports in every lane, so that lanes have one shape.
    springs = coupled_springs(mesh, (*elastic,), np.zeros_like(mechanism.points))
    named = dict.fromkeys(load.name for c in configurations for load in c.loads)
    loads = (*named,) or (UNNAMED_LOADS,)
    rows = [c.rows(mesh, mechanism) for c in configurations]
    effectors, records = zip(*stack_effectors(rows, mechanism.points), strict=True)
    lanes = [
        _lane(mesh, mechanism, c, of_c, springs=springs, loads=loads, stages=n_stages)
        for c, of_c in zip(configurations, effectors, strict=True)
    ]
    return ConfigurationLanes(stacked(lanes), records)


def _lane(
    mesh: TetMesh,
    mechanism: Mechanism,
    c: Configuration,
    effectors: EffectorArrays,
    *,
    springs: Springs,
    loads: tuple[str, ...],
    stages: int,
) -> ConfigurationArrays:
    # Nodes of the bodies' frames come after those of the mesh.
    n_nodes, n_points = mesh.n_nodes, len(mechanism.points)
    fixed, sprung = np.zeros((2, n_points, 3), bool)
    imposed, rest = np.zeros((2, n_points, 3))
    for support in c.supports:
        rigid = support.stiffness is None
        support.apply(mesh, *((fixed, imposed) if rigid else (sprung, rest)))
    held = (fixed | sprung)[:n_nodes]
    check_apart(mesh, mechanism, held, c.name)
    bodies = mechanisms.body_state_arrays(mechanism, c.bodies, c.name)
    actuation = mechanisms.actuation_arrays(mechanism, c.actuation, c.name)
    force = np.zeros((len(loads), n_points, 3))
    no_errors = np.ones(len(loads)), np.zeros((len(loads), 3))
    by_node = NodalForces | PointForce
    shared_out = [load.name for load in c.loads if not isinstance(load, by_node)]
    for load in c.loads:
        force[loads.index(load.name), :n_nodes] += load.nodal_forces(mesh)
    kind = np.asarray(bodies.kind).copy()
    motors = mechanism.actuators.motors
    for name, k in motors.items():
        by_angle = actuation.by_displacement[mechanism.actuators.names.index(name)]
        kind[k] = KINDS.index("held" if by_angle else "hinged")
    balanced = bool(np.any(c.gravity) or c.loads or {*c.actuation} - {*motors})
    check_held(mesh, mechanism, held, kind, name=c.name, balanced=balanced)
    if c.after is None:  # else it starts where that one does
        _check_outside(mechanism, bodies, c.name)
    return ConfigurationArrays(
        key=np.array([name_key(c.name), name_key(c.recording or c.name)], np.int64),
        after=np.array(name_key(c.after) if c.after else 0, np.int64),
        fixed=fixed,
        imposed=imposed,
        springs=_stiffened(springs, mesh, c, rest),
        loads=DeadLoads(force, *no_errors, np.isin(loads, shared_out), loads),
        gravity=np.asarray(c.gravity, float),
        tilt=np.zeros(2),
        bodies=bodies,
        actuation=actuation,
        effectors=effectors,
        stages=np.full((stages, n_points, 3), np.nan if c.after else 0.0),
        # Until it follows another, what it remembers is nan.
        is_stage=np.arange(stages) == (stages - 1 if c.after else -1),
    )


def _n_stages(configurations: Sequence[Configuration]) -> int:
    """Return how many equilibria lie before any of the configurations.

    Raises:
        ValueError: If one comes after an unknown one, or after itself.
    """
    after, most = {c.name: c.after for c in configurations}, 0
    for name in after:
        passed, earlier = [name], after[name]
        while earlier is not None:
            if earlier not in after:
                raise ValueError(
                    f"configuration {passed[-1]!r} comes after {earlier!r}, which is "
                    "not among those that are given: give both. What takes one "
                    "configuration alone begins at rest: leave `after` out."
                    f"{suggestion(earlier, [*after])}"
                )
            if earlier in passed:
                raise ValueError(
                    f"configuration {earlier!r} comes after itself: "
                    f"{' after '.join(map(repr, [*passed, earlier]))}."
                )
            passed.append(earlier)
            earlier = after[earlier]
        most = max(most, len(passed) - 1)
    return most


def _check_present(
    mechanism: Mechanism, configurations: Sequence[Configuration]
) -> None:
    """Raise where an obstacle comes in after a pose that others follow."""
    named = {c.name: c for c in configurations}
    names = zip(mechanism.contacts.names, mechanism.contacts.sticks, strict=True)

    def absent(c: Configuration, body: str) -> bool:
        state = c.bodies.get(body)
        return "absent" in (state, getattr(state, "kind", ""))

    for body in [name for name, sticks in names if sticks]:
        for c in configurations:
            if c.after and absent(named[c.after], body) and not absent(c, body):
                raise ValueError(
                    f"configuration {c.name!r} comes after {c.after!r}, in which the "
                    f"obstacle {body!r} is absent: friction cannot tell where it was. "
                    "Let it stand beside the body there."
                )


def _check_outside(
    mechanism: Mechanism, bodies: BodyStateArrays, configuration: str
) -> None:
    """Raise where the body at rest lies in what has not moved yet, or in itself."""
    contacts = mechanism.contacts
    if not contacts.can_touch:
        return
    depths = contacts.depths_at_start(mechanism.standing(bodies, mounted=False))
    for name, depth in zip(contacts.touched, np.asarray(depths), strict=True):
        if depth > contacts.scale:
            deep = readable_values([float(depth)], "m", digits=3)
            if name not in contacts.names:
                raise ValueError(
                    f"configuration {configuration!r}: at rest surfaces lie {deep} in "
                    f"each other ({name}). Mesh them apart, or do not let them touch."
                )
            raise ValueError(
                f"configuration {configuration!r}: before the load the body lies "
                f"{deep} inside the obstacle {name!r}. Let it start "
                "beside the body: give the state of the obstacle another `start`, or "
                "its body another origin."
            )


def _stiffened(
    springs: Springs, mesh: TetMesh, c: Configuration, rest: HostArray
) -> Springs:
    """Give the springs of the whole batch the stiffness that a configuration states."""
    area, stiffness = np.zeros_like(springs.area), np.zeros_like(springs.stiffness)
    for support in [s for s in c.supports if s.stiffness is not None]:
        s = springs.names.index(support.name)
        if stiffness[s] > 0.0:
            raise ValueError(
                f"configuration {c.name!r}: the group {support.name!r} has two "
                "supports with a stiffness; give one for all of its axes."
            )
        area[s, : mesh.n_nodes] = support.areas(mesh)
        stiffness[s] = support.stiffness
    return replace(springs, area=area, stiffness=stiffness, rest=rest)


MORE = 1.05
"""Factor on the largest fitted load or actuation from which on it is exceeded [-]."""


def beyond(fitted: Sequence[Configuration], pose: Configuration) -> str:
    """Say how a pose goes beyond those that were fitted; "" where it does not.

    What acts are loads and actuators, by their names. A pose combines what was only
    fitted apart if two of them act in no fitted pose together.
    """
    known, here, parts = [_acting(c) for c in fitted], _acting(pose), []
    for name, (kind, value) in here.items():
        among = [of[name] for of in known if name in of]
        sizes = [v * np.sign(value) for of_kind, v in among if of_kind == kind]
        most = max(sizes, default=0.0)
        if not among:
            parts.append(f"{name} acts in no fitted pose")
        elif sizes and most <= 0.0:
            parts.append(f"{name} acts the other way round than in all fitted poses")
        elif sizes and abs(value) > MORE * most:
            parts.append(f"{name} is {abs(value) / most:.3g} times the largest fitted")
    apart = [
        f"{a} with {b}"
        for a, b in combinations(here, 2)
        if all(any(n in of for of in known) for n in (a, b))
        and not any(a in of and b in of for of in known)
    ]
    if apart:
        parts.append(f"it combines {listed(apart)}, only fitted apart")
    return "; ".join(parts)


def _acting(c: Configuration) -> dict[str, tuple[str, float]]:
    """Return kind and size of each load and command that acts, by what it is called."""
    acting: dict[str, tuple[str, float]] = {}
    for load in c.loads:
        where = getattr(load, "where", getattr(load, "edge", None))
        on = f"a load on {where}" if isinstance(where, str) else "a load"
        name = on if load.name == UNNAMED_LOADS else load.name
        vector = getattr(load, "force", getattr(load, "traction", 0.0))
        size = float(np.linalg.norm(vector)) + acting.get(name, ("", 0.0))[1]
        acting[name] = type(load).__name__, size
    for name, imposed in c.actuation.items():
        acting[name] = type(imposed).__name__, float(imposed.value)
    return {name: of for name, of in acting.items() if of[1]}
