"""What else might be measured on a robot, as changes of the poses that it has."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import product

import numpy as np

from softcal_jax._units import readable_values
from softcal_jax.configurations import (
    STANDARD_GRAVITY,
    Configuration,
    ImposedForce,
    PointForce,
    Support,
    configuration_arrays,
)
from softcal_jax.equilibrium import Model
from softcal_jax.mesh import box_faces, locate


def proposals(
    model: Model, configurations: Sequence[Configuration]
) -> Iterator[Configuration]:
    """Yield candidates that need nothing but the robot, a weight and other commands.

    They change the first configuration in which something is measured: gravity along
    each axis; held by the other end; half of the body's weight at the marker that is
    farthest from what is held; half, and all, of the largest actuation of each
    actuator; and the same again. What the configurations have already is left out.
    """
    base = next((c for c in configurations if c.markers or c.effectors), None)
    if base is None:
        return
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
