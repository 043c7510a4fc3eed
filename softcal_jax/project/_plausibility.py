"""Numbers of a project that are guesses, or probably a slip of a unit.

None of the latter is an error: the method does not mind a robot of lead on Jupiter.
"""

import os
import re
from collections.abc import Iterator, Mapping
from itertools import islice
from pathlib import Path
from typing import NamedTuple

import numpy as np

from softcal_jax._units import readable, readable_values
from softcal_jax._warnings import SoftcalWarning
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
from softcal_jax.project._problems import WrongKeyError

DENSITIES = 10.0, 23e3
"""From a light foam to the heaviest metal [kg/m3]."""

GRAVITIES = 1.0, 30.0
"""From the Moon's to Jupiter's [m/s2]."""

WEIGHTS = 200.0
"""Dead load over the weight of the robot that would crush a soft one flat [-]."""


UNBEARABLE = 100.0
"""What acts over what the body resists, from which on no solver need try [-]."""


class ProjectWarning(SoftcalWarning):
    """A number of a project file that is probably a mistake."""


def check_bearable(model: Model, posed: Mapping[str, Configuration]) -> None:
    """Raise WrongKeyError if a load, weight or force of an actuator is absurd.

    The body resists about its largest modulus times its size squared; where far more
    than that acts, each equilibrium is sought in vain for minutes.
    """
    units, fields = field_units(model), tet_fields(model, {})
    moduli = [np.abs(fields[name]).max() for name in units if units[name] == "Pa"]
    modulus, size = max(moduli, default=0.0), model.mesh.size
    if modulus == 0.0:
        return
    for key, c in posed.items():
        for what, value, unit in _acting(model, c):
            resisted = modulus * size ** _LENGTHS.get(unit, 0)
            if not value <= UNBEARABLE * resisted:
                raise WrongKeyError(
                    f"{key}.{what}",
                    f"{readable(value, unit)} is more than {UNBEARABLE:g} times what "
                    f"the body resists, about {readable(resisted, unit)} by a modulus "
                    f"of {readable(modulus, 'Pa')} and a size of "
                    f"{readable(size, 'm')}: check the units.",
                )


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
    if posed:
        for doubts in (_gravity(posed), _loads(model, posed), _places(model, posed)):
            yield from islice(doubts, 1)


def _gravity(posed: Mapping[str, Configuration]) -> Iterator[str]:
    low, high = GRAVITIES
    for key, c in posed.items():
        size = float(np.linalg.norm(c.gravity))
        if size and not low <= size <= high:
            yield (
                f"{key}.gravity: {readable_values(c.gravity, 'm/s^2')} is "
                f"{size / STANDARD_GRAVITY:.3g} times that of the Earth: check its "
                "unit."
            )


def _loads(model: Model, posed: Mapping[str, Configuration]) -> Iterator[str]:
    weight = model.mass * STANDARD_GRAVITY
    for key, c in posed.items():
        forces = [load.nodal_forces(model.mesh).sum(axis=0) for load in c.loads]
        load = float(sum(np.linalg.norm(force) for force in forces))
        if weight and load > WEIGHTS * weight:
            yield (
                f"{key}.loads: {readable_values([load], 'N')} are {load / weight:.3g} "
                f"times the weight of the robot ({readable_values([weight], 'N')}): "
                "check the units of force, size and density."
            )


def _places(model: Model, posed: Mapping[str, Configuration]) -> Iterator[str]:
    """Check where points were measured, or how far from the reference pose.

    A reference may have a frame of its own, so only differences from it are checked.
    """
    lanes = configuration_lanes(model.mesh, [*posed.values()], model.mechanism)
    moved = dict(zip(posed, map(motions, lanes.effectors), strict=True))
    named = {c.name: moved[key] for key, c in posed.items()}
    references = {c.displacement_from for c in posed.values()}
    for key, c in posed.items():
        motion = {} if c.name in references else moved[key]
        if c.displacement_from is not None:
            before = named.get(c.displacement_from, {})
            motion = {n: motion[n] - before[n] for n in motion if n in before}
        far = farthest(motion, model.mesh.size)
        if far is not None:
            yield f"{key}.measured: {far}"


CHANGE = "# CHANGE: "
"""How the remark on a guess begins, at the end of its line or on the line before."""

_GUESS = re.compile(rf"(?P<text>.*?)\s*{CHANGE}(?P<remark>.+)")


class Guess(NamedTuple):
    """A line of a project file, from 1, and the remark on what is to be confirmed."""

    line: int
    text: str
    remark: str


def guesses_left(path: str | os.PathLike[str]) -> tuple[Guess, ...]:
    """List the lines of a project file that still have the remark of a guess."""
    lines = Path(path).read_text(encoding="utf-8").splitlines()
    return tuple(
        Guess(n, match["text"].strip(), match["remark"].strip())
        for n, line in enumerate(lines, start=1)
        if (match := _GUESS.match(line))
    )
