"""Which poses go beyond others: in what acts together, or how strongly."""

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from softcal_jax._names import UNNAMED_LOADS, listed
from softcal_jax.configurations._configuration import Configuration

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
