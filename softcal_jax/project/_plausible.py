"""What the numbers of a project say of mistakes, before anything is solved."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import chain, islice
from typing import NamedTuple

import jax
import numpy as np
from scipy.spatial import KDTree

from softcal_jax._lanes import lane_of
from softcal_jax._names import listed
from softcal_jax._typing import Float, HostArray
from softcal_jax._units import readable, readable_values
from softcal_jax._warnings import SoftcalWarning
from softcal_jax.actuators import actuator_geometry
from softcal_jax.configurations import (
    STANDARD_GRAVITY,
    Configuration,
    ImposedForce,
    configuration_lanes,
    farthest,
    motions,
)
from softcal_jax.equilibrium import Model
from softcal_jax.export import field_units, tet_fields
from softcal_jax.mesh import volumes
from softcal_jax.project._problems import WrongKeyError

DENSITIES = 10.0, 23e3  # from a light foam to the heaviest metal [kg/m3]
GRAVITIES = 1.0, 30.0  # from the Moon's to Jupiter's [m/s2]

UNBEARABLE = 100.0
"""What acts over what the body resists, from which on no solver need try [-]."""


class ProjectWarning(SoftcalWarning):
    """A number of a project file that is probably a mistake."""


USUAL = 1e-3, 1.0
"""What deforms a soft body, over what this resists [-]."""

STRETCH = 2.0
"""Factor on the distance of a marker from what is held that no pose reaches [-]."""

SIGMAS, SHARE = 3.0, 0.01
"""Motion beyond noise: in standard deviations, and beside that of the robot's size."""

TAKEN = 0.05
"""Noise of readings from which places at rest were taken, in standard deviations."""

AGAINST = -0.3
"""Work of what acts on a body that rests, over force times motion: less is wrong."""

BACK = -0.5
"""Cosine of the angle from which on a cable turns back [-]."""


def check_bearable(model: Model, posed: Mapping[str, Configuration]) -> None:
    """Raise WrongKeyError if a load, weight or force of an actuator is absurd.

    The body resists about its largest modulus times its size squared; where far more
    than that acts, each equilibrium is sought in vain for minutes.
    """
    moduli, size = _moduli(model), model.mesh.size
    for key, c in posed.items():
        for what, value, unit in _acting(model, c):
            resisted = max(moduli, default=np.inf) * size ** _LENGTHS.get(unit, 0)
            if not value <= UNBEARABLE * resisted:
                raise WrongKeyError(
                    f"{key}.{what}",
                    f"{readable(value, unit)} is more than {UNBEARABLE:g} times what "
                    f"the body resists, about {readable(resisted, unit)} by a modulus "
                    f"of {readable(max(moduli), 'Pa')} and a size of "
                    f"{readable(size, 'm')}: check the units.",
                )


def _moduli(model: Model) -> list[float]:
    """Return the largest value of each modulus [Pa]."""
    units, fields = field_units(model), tet_fields(model, {})
    moduli = [float(np.abs(fields[k]).max()) for k in units if units[k] == "Pa"]
    return [modulus for modulus in moduli if modulus > 0.0]


_LENGTHS = {"N": 2, "N m": 3}
"""Power of a length in forces of actuators, over a pressure."""


def _acting(model: Model, c: Configuration) -> Iterator[tuple[str, float, str]]:
    """Yield keys, sizes and units of what acts on the body."""
    forces = [np.abs(load.nodal_forces(model.mesh)).sum() for load in c.loads]
    yield "loads", float(sum(forces)), "N"
    yield "gravity", model.mass * float(np.abs(c.gravity).max()), "N"
    actuators = model.mechanism.actuators
    for name, kind in zip(actuators.names, actuators.kinds, strict=True):
        imposed = c.actuation.get(name)
        if isinstance(imposed, ImposedForce):
            yield f"actuation.{name}", abs(imposed.value), kind.force_unit


def implausible(model: Model, posed: Mapping[str, Configuration]) -> Iterator[str]:
    """Yield a line on the first value of each kind that is hard to believe.

    `posed` holds configurations by their keys, like "configurations.weight".
    """
    density = np.atleast_1d(np.asarray(model.density))
    low, high = DENSITIES
    strange = density[(density != 0.0) & ((density < low) | (density > high))]
    if strange.size:
        yield (
            f"material.density: {strange[0]:g} kg/m^3 is hardly a robot's (water has "
            "1000, silicone 1070, steel 7850): check its unit."
        )
    yield from _turning_back(model)
    if not posed:
        return
    yield from islice(_gravity(posed), 1)
    yield from _stiffness(model, posed)
    seen = [pose for pose in _seen(model, posed) if pose.points]
    kinds = (_places, _at_rest, _held, _against)
    yield from islice(chain.from_iterable(kind(model, seen) for kind in kinds), 1)


def _gravity(posed: Mapping[str, Configuration]) -> Iterator[str]:
    low, high = GRAVITIES
    for key, c in posed.items():
        size = float(np.linalg.norm(c.gravity))
        if size and not low <= size <= high:
            yield (
                f"{key}.gravity: {readable_values(c.gravity, 'm/s^2')} is "
                f"{size / STANDARD_GRAVITY:.3g} times the Earth's: check its unit."
            )


def _rounded(value: float, unit: str) -> str:
    return readable_values([value], unit, digits=3)


def _turning_back(model: Model) -> Iterator[str]:
    """Name each cable that turns back, although its guides have a shorter order."""
    actuators = model.mechanism.actuators
    geometry = actuator_geometry(actuators, model.mechanism.points)
    for a, name in enumerate(actuators.names):
        path = geometry.segments[geometry.segment_owner == a]
        along = path[:, 1] - path[:, 0]
        along /= np.linalg.norm(along, axis=1, keepdims=True)
        joined = np.all(path[1:, 0] == path[:-1, 1], axis=1)
        cosine = np.sum(along[1:] * along[:-1], axis=1)
        back = np.flatnonzero(joined & (cosine < BACK))
        if not back.size:
            continue
        guides = np.concatenate([path[:1, 0], path[:, 1]])
        axis = np.linalg.svd(guides - guides.mean(axis=0))[2][0]
        order = np.argsort(guides @ (np.sign(axis @ (guides[-1] - guides[0])) * axis))
        lengths = [
            float(np.linalg.norm(np.diff(g, axis=0), axis=1).sum())
            for g in (guides, guides[order])
        ]
        if lengths[1] < lengths[0]:
            turn = np.degrees(np.arccos(cosine[back[0]]))
            yield (
                f"actuators.{name}.guides: at guide {back[0] + 2} of {len(guides)} the "
                f"cable turns back by {turn:.0f} deg. In the order "
                f"{', '.join(map(str, order + 1))} it is {_rounded(lengths[1], 'm')} "
                f"long, and not {_rounded(lengths[0], 'm')}: are they in order?"
            )


def _stiffness(model: Model, posed: Mapping[str, Configuration]) -> Iterator[str]:
    """Name loads and actuators that are far too large or too small for the body.

    Against what its section resists, and what bends a beam of its length and volume.
    """
    moduli, length = _moduli(model), float(np.ptp(model.mesh.points, axis=0).max())
    thick = float(np.sqrt(volumes(model.mesh).sum() / length))
    largest: dict[str, tuple[float, str, str]] = {}
    for key, c in posed.items():
        for what, value, unit in _acting(model, c):
            if what != "gravity" and unit in ("Pa", "N"):
                largest[what] = max(
                    (value, unit, key), largest.get(what, (0.0, "", ""))
                )
    for what, (value, unit, key) in largest.items() if moduli else ():
        stretched, bent = max(moduli), min(moduli)
        if unit == "N":
            stretched, bent = stretched * thick**2, bent * thick**3 / (6.0 * length)
        if value > USUAL[1] * stretched or 0.0 < value < USUAL[0] * bent:
            resisted = stretched if value > USUAL[1] * stretched else bent
            yield (
                f"{key}.{what}: {_rounded(value, unit)} is {value / resisted:.2g} "
                f"times what the body resists, about {_rounded(resisted, unit)} by a "
                f"modulus of {_rounded(max(moduli), 'Pa')}; usual are {USUAL[0]:g} to "
                f"{USUAL[1]:g} times. Check the units."
            )


class _Point(NamedTuple):
    """A point that was measured: its motion, its noise and its place at rest [m].

    `on_held` says whether it stands where the body is held.
    """

    motion: Float[HostArray, "3"]
    noise: float
    at_rest: Float[HostArray, "3"]
    on_held: bool

    @property
    def size(self) -> float:
        """How far it moved [m]."""
        return float(np.linalg.norm(self.motion))


class _Seen(NamedTuple):
    """A configuration, its key in the file, and the points that were measured in it.

    They moved since `before`, or since rest without one; `held` are the places of nodes
    that cannot move [m].
    """

    key: str
    c: Configuration
    before: Configuration | None
    points: dict[str, _Point]
    held: Float[HostArray, "n_held 3"]

    @property
    def farthest(self) -> str:
        """Name of the point that moved most."""
        return max(self.points, key=lambda name: self.points[name].size)


def _seen(model: Model, posed: Mapping[str, Configuration]) -> Iterator[_Seen]:
    """Collect the points that were measured.

    A reference may have a frame of its own, so only differences from it are checked.
    """
    lanes = configuration_lanes(model.mesh, [*posed.values()], model.mechanism)
    named = {c.name: k for k, c in enumerate(posed.values())}
    before = [named.get(c.displacement_from or "") for c in posed.values()]
    moved = [motions(records) for records in lanes.effectors]
    for k, (key, c) in enumerate(posed.items()):
        lane, earlier = jax.device_get(lane_of(lanes.arrays, k)), before[k]
        held = lane.fixed.all(axis=1) & ~lane.imposed.any(axis=1)
        since = moved[k] if earlier is None else moved[earlier]
        points = {}
        for r in lanes.effectors[k]:
            if r.quantity != "point" or k in before or r.name not in since:
                continue
            u = (0.0 if earlier is None else since[r.name]) - r.error(r.at_rest)
            weights = lane.effectors.weights[r.index]
            on_held = held[lane.effectors.nodes[r.index][weights != 0.0]].all()
            noise = float(np.linalg.norm(r.std[r.seen]))
            points[r.name] = _Point(np.nan_to_num(u), noise, r.at_rest, bool(on_held))
        since = None if earlier is None else [*posed.values()][earlier]
        yield _Seen(key, c, since, points, model.mechanism.points[held])


def _places(model: Model, seen: Sequence[_Seen]) -> Iterator[str]:
    """Name a point that moved by more than any robot does."""
    for pose in seen:
        motion = {name: p.motion for name, p in pose.points.items()}
        if (far := farthest(motion, model.mesh.size)) is not None:
            yield f"{pose.key}.measured: {far}"


def _at_rest(model: Model, seen: Sequence[_Seen]) -> Iterator[str]:
    """Name a pose in which nothing acts and points moved, or the other way round."""
    for pose in (pose for pose in seen if pose.before is None):
        far, points = pose.points[pose.farthest], pose.points
        acts = [what for what, size, _ in _acting(model, pose.c) if size]
        moved = any(np.any(support.displacement) for support in pose.c.supports)
        if not (acts or moved or pose.c.actuation or pose.c.bodies):
            if far.size > SIGMAS * far.noise + SHARE * model.mesh.size:
                yield (
                    f"{pose.key}: nothing acts, and {pose.farthest!r} is "
                    f"{_rounded(far.size, 'm')} from its place at rest. State gravity "
                    "and loads, or correct the markers' places or the frame."
                )
        elif acts and len(points) > 1 and far.size < TAKEN * far.noise:
            yield (
                f"{pose.key}: every marker was measured at its place at rest, although "
                f"{listed(acts)} acts. Places that were read in this pose are not "
                "those at rest: take them from the drawing, or use displacement_from."
            )


def _held(model: Model, seen: Sequence[_Seen]) -> Iterator[str]:
    """Name a point that moved with what is held, or far away from it.

    Strain changes its distance to the nearest held node, but does not multiply it.
    """
    for pose in (pose for pose in seen if len(pose.held)):
        tree, away = KDTree(pose.held), {}
        for name, p in pose.points.items():
            apart, node = tree.query(p.at_rest)
            now = np.linalg.norm(p.at_rest + p.motion - pose.held[node])
            beyond = p.size if p.on_held else now - STRETCH * apart
            away[name] = beyond - SIGMAS * p.noise - SHARE * model.mesh.size
        name = max(away, key=away.__getitem__)
        if away[name] > 0.0:
            least = min(pose.points, key=lambda name: pose.points[name].size)
            ends = [_rounded(pose.points[n].size, "m") for n in (name, least)]
            where = "held" if pose.points[name].on_held else "next to what is held"
            groups = listed([support.name for support in pose.c.supports])
            yield (
                f"{pose.key}.supports: {name!r} is {where} ({groups}), and moved by "
                f"{ends[0]}; {least!r} moved least, by {ends[1]}. Is another part held?"
            )


def _against(model: Model, seen: Sequence[_Seen]) -> Iterator[str]:
    """Name poses in which the body moved against what acts on it.

    Weight and loads do work on a body that yields to them. Each node moves about as the
    nearest point that was measured or is held.
    """
    mesh, mechanism = model.mesh, model.mechanism
    if mechanism.bodies.names or mechanism.contacts.names:
        return  # levers turn motions around
    mass = np.zeros(mesh.n_nodes)
    of_tets = np.asarray(model.density) * volumes(mesh) / 4.0
    np.add.at(mass, mesh.tets[:, :4], np.broadcast_to(of_tets, mesh.n_tets)[:, None])
    weight = lambda c: mass[:, None] * np.array(c.gravity)
    force = lambda c: sum((ld.nodal_forces(mesh) for ld in c.loads), weight(c))
    for pose in (pose for pose in seen if not pose.c.actuation):
        if pose.before is not None and pose.before.actuation:
            continue
        acts = force(pose.c) - (0.0 if pose.before is None else force(pose.before))
        points = [*pose.points.values()]
        motion = np.concatenate([[p.motion for p in points], np.zeros_like(pose.held)])
        places = np.concatenate([[p.at_rest for p in points], pose.held])
        nearest = KDTree(places).query(mesh.points)[1]
        work = np.sum(acts * motion[nearest], axis=1)
        sizes = np.linalg.norm(acts, axis=1) * np.linalg.norm(motion[nearest], axis=1)
        far = pose.points[pose.farthest]
        beyond = far.size > SIGMAS * far.noise + SHARE * mesh.size
        if beyond and work.sum() < AGAINST * sizes.sum():
            yield (
                f"{pose.key}: markers moved against gravity and loads, most of all "
                f"{pose.farthest!r}, by {_rounded(far.size, 'm')}. Is gravity or a "
                "load reversed, or an axis of the recording?"
            )
