"""What the numbers of a project say of mistakes, before anything is solved."""

from collections.abc import Iterator, Mapping
from itertools import chain, islice
from typing import NamedTuple

import jax
import numpy as np
from scipy.spatial import KDTree

from softcal_jax._text import SoftcalWarning, listed
from softcal_jax._typing import Bool, Float, HostArray
from softcal_jax._units import readable, readable_values
from softcal_jax.actuators import actuator_geometry
from softcal_jax.configurations import (
    STANDARD_GRAVITY,
    Configuration,
    EffectorRecord,
    ImposedForce,
    configuration_lanes,
    farthest,
    motions,
)
from softcal_jax.equilibrium import Model
from softcal_jax.fields import constants_of
from softcal_jax.mesh import volumes
from softcal_jax.project._table import WrongKeyError

DENSITIES = 10.0, 23e3  # from a light foam to the heaviest metal [kg/m3]
GRAVITIES = 1.0, 30.0  # from the Moon's to Jupiter's [m/s2]

UNBEARABLE = 100.0
"""What acts over what the body resists, from which on no solver need try [-]."""


class ProjectWarning(SoftcalWarning):
    """A number of a project file that is probably a mistake."""


USUAL = 1e-3, 1.0  # what deforms a soft body, over what this resists [-]
STRETCH = 2.0  # factor on a distance from what is held that no pose reaches [-]
SIGMAS, SHARE = 3.0, 0.01  # motion beyond noise, in its size and the robot's [-]
TAKEN = 0.05  # noise of readings from which places at rest were taken, likewise [-]
AGAINST = -0.3  # work of what acts, over force times motion, that is wrong [-]
BACK = -0.5  # cosine of the angle from which on a cable turns back [-]


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
    of_unit = [leaf for _, leaf, of in constants_of(model) if of.get("unit") == "Pa"]
    moduli = [float(np.abs(leaf).max()) for leaf in of_unit]
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
    low, high = GRAVITIES
    for key, c in posed.items():
        size = float(np.linalg.norm(c.gravity))
        if size and not low <= size <= high:
            yield (
                f"{key}.gravity: {readable_values(c.gravity, 'm/s^2')} is "
                f"{size / STANDARD_GRAVITY:.3g} times the Earth's: check its unit."
            )
            break
    yield from _stiffness(model, posed)
    misread = (_misread(model, seen) for seen in _seen(model, posed))
    yield from islice(chain.from_iterable(misread), 1)


def _rounded(value: float, unit: str) -> str:
    return readable_values([value], unit, digits=3)


def _turning_back(model: Model) -> Iterator[str]:
    """Name each cable that turns back, although its guides have a shorter order."""
    actuators = model.mechanism.actuators
    geometry = actuator_geometry(actuators, model.mechanism.points)
    for a, name in enumerate(actuators.names):
        path = np.asarray(geometry.segments)[geometry.segment_owner == a]
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


class _Seen(NamedTuple):
    """A configuration, by its key in the file, and the points that were measured in it.

    They moved by `u` since the configuration `before`, or since rest without one, with
    the size of their `noise`; `on_held` flags those where the body is held, and `held`
    are the nodes that cannot move [m].
    """

    key: str
    c: Configuration
    before: Configuration | None
    points: list[EffectorRecord]
    u: Float[HostArray, "n 3"]
    noise: Float[HostArray, " n"]
    on_held: Bool[HostArray, " n"]
    held: Float[HostArray, "n_held 3"]

    def moved(self, i: int) -> str:
        """Write which point moved, and how far."""
        size = float(np.linalg.norm(self.u[i]))
        return f"{self.points[i].name!r} by {_rounded(size, 'm')}"


def _seen(model: Model, posed: Mapping[str, Configuration]) -> Iterator[_Seen]:
    """Collect the points that were measured.

    A reference may have a frame of its own, so only differences from it are checked.
    """
    lanes = configuration_lanes(model.mesh, [*posed.values()], model.mechanism)
    of, carried = lanes.arrays, lanes.arrays.effectors
    several = jax.device_get((of.fixed, of.imposed, carried.nodes, carried.weights))
    by_name = {c.name: c for c in posed.values()}
    moved = {}
    for c, records in zip(posed.values(), lanes.effectors, strict=True):
        moved[c.name] = {n: np.nan_to_num(-u) for n, u in motions(records).items()}
    references = {c.displacement_from for c in posed.values()}
    for k, (key, c) in enumerate(posed.items()):
        fixed, imposed, nodes, weights = (array[k] for array in several)
        held = fixed.all(axis=1) & ~imposed.any(axis=1)
        since = moved.get(c.displacement_from or "", dict.fromkeys(moved[c.name], 0.0))
        points = [r for r in lanes.effectors[k] if r.quantity == "point"]
        points = [r for r in points if r.name in moved[c.name] and r.name in since]
        rows = np.array([r.index for r in points], int)
        free = (weights[rows] != 0.0) & ~held[nodes[rows]]
        if points and c.name not in references:
            yield _Seen(
                key=key,
                c=c,
                before=by_name.get(c.displacement_from or ""),
                points=points,
                u=np.array([moved[c.name][r.name] - since[r.name] for r in points]),
                noise=np.array([np.linalg.norm(r.std[r.seen]) for r in points]),
                on_held=~free.any(axis=1),
                held=model.mechanism.points[held],
            )


def _misread(model: Model, seen: _Seen) -> Iterator[str]:
    """Name motions that no robot makes, as it is held and loaded.

    Strain changes the distance of a point to the nearest held node, but does not
    multiply it.
    """
    sizes, surely = np.linalg.norm(seen.u, axis=1), SIGMAS * seen.noise
    surely += SHARE * model.mesh.size
    most, least = int(np.argmax(sizes)), int(np.argmin(sizes))
    motion = {r.name: u for r, u in zip(seen.points, seen.u, strict=True)}
    if (far := farthest(motion, model.mesh.size)) is not None:
        yield f"{seen.key}.measured: {far}"
    acts = [what for what, size, _ in _acting(model, seen.c) if size]
    moved = any(np.any(support.displacement) for support in seen.c.supports)
    others = moved or seen.c.actuation or seen.c.bodies or seen.before is not None
    if not (acts or others) and sizes[most] > surely[most]:
        yield (
            f"{seen.key}: nothing acts, but markers moved, {seen.moved(most)}. State "
            "gravity and loads, or correct the places of the markers or the frame."
        )
    # The place of a frame is that of its body, and not read.
    names = [] if seen.c.markers is None else seen.c.markers.names
    read = np.array([record.name in names or not names for record in seen.points])
    still = seen.before is None and np.all((sizes < TAKEN * seen.noise)[read])
    if acts and still and read.sum() > 1:
        yield (
            f"{seen.key}: every marker was measured at its place at rest, although "
            f"{listed(acts)} acts. Places that were read in this pose are not those at "
            "rest: take them from the drawing, or use displacement_from."
        )
    if len(seen.held):
        places = np.array([r.at_rest for r in seen.points])
        apart, node = KDTree(seen.held).query(places)
        now = np.linalg.norm(places + seen.u - seen.held[node], axis=1)
        beyond = np.where(seen.on_held, sizes, now - STRETCH * apart) - surely
        worst = int(np.argmax(beyond))
        if beyond[worst] > 0.0:
            where = "where" if seen.on_held[worst] else "next to where"
            groups = listed([support.name for support in seen.c.supports])
            yield (
                f"{seen.key}.supports: {where} {groups} holds, a marker moved: "
                f"{seen.moved(worst)}; {seen.moved(least)} is least. Is another part "
                "held?"
            )
    if sizes[most] > surely[most] and _work(model, seen) < AGAINST:
        yield (
            f"{seen.key}: markers moved against gravity and loads, "
            f"{seen.moved(most)}. Is gravity or a load reversed, or an axis of the "
            "recording?"
        )


def _work(model: Model, seen: _Seen) -> float:
    """Return the work of weight and loads over force times motion [-].

    It is positive for a body that yields to them; 1 where something else acts, as a
    motor does. Each node, and each rigid body, moves about as the nearest point that
    was measured or is held.
    """
    mesh, mechanism = model.mesh, model.mechanism
    poses = [seen.c] if seen.before is None else [seen.c, seen.before]
    others = any(c.actuation or c.bodies for c in poses) or mechanism.contacts.touched
    if others or np.any(np.asarray(mechanism.actuators.motor_body) >= 0):
        return 1.0
    mass, bodies = np.zeros(mesh.n_nodes), mechanism.bodies
    of_tets = np.asarray(model.density) * volumes(mesh) / 4.0
    np.add.at(mass, mesh.tets[:, :4], np.broadcast_to(of_tets, mesh.n_tets)[:, None])
    mass = np.append(mass, bodies.mass)[:, None]
    force = np.zeros((len(mass), 3))
    for sign, c in zip((1.0, -1.0), poses, strict=False):
        force += sign * mass * np.array(c.gravity)
        loads = sum(load.nodal_forces(mesh) for load in c.loads)
        force[: mesh.n_nodes] += sign * loads
    places = np.concatenate([[r.at_rest for r in seen.points], seen.held])
    u = np.concatenate([seen.u, np.zeros_like(seen.held)])
    carriers = np.concatenate([mesh.points, np.reshape(bodies.origin, (-1, 3))])
    u = u[KDTree(places).query(carriers)[1]]
    sizes = np.linalg.norm(force, axis=1) * np.linalg.norm(u, axis=1)
    return float(np.sum(force * u) / max(np.sum(sizes), 1e-300))
