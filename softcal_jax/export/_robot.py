"""Rigid bodies, actuators, reactions and effectors as dictionaries."""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax.configurations import (
    Configuration,
    configuration_arrays,
    effector_rows,
    measured_at_rest,
    row_numbers,
)
from softcal_jax.equilibrium import (
    EquilibriumSolution,
    Model,
    RobotState,
    effector_positions,
    effector_values,
)
from softcal_jax.export._plain import fields_of

WIDTH = {"point": 3, "turn": 3, "reaction": 3, "scalar": 1, "force": 1}
"""Coordinates of a row of effectors; the rest of three is padding."""


def robot_dict(state: RobotState | None) -> dict[str, Any] | None:
    """Rigid bodies, actuators and reactions: positions in mm, the rest in SI.

    Keys: `rigid_bodies` (`name`, `state`, `position_mm`, `translation_mm`,
    `rotation_vector`), `actuators` (`name`, `kind`, `imposed`, `force`, `force_unit`,
    `displacement`, `displacement_unit`), `reactions` (`name`, `force`: of the ground on
    the robot).

    Args:
        state: What they do; None if there are none.
    """
    if state is None:
        return None
    return {
        "rigid_bodies": [
            {
                "name": body.name,
                "state": body.state,
                "position_mm": 1e3 * body.position,
                "translation_mm": 1e3 * body.translation,
                "rotation_vector": body.rotation_vector,
            }
            for body in state.bodies
        ],
        "actuators": [fields_of(actuator) for actuator in state.actuators],
        "reactions": [fields_of(reaction) for reaction in state.reactions],
    }


def simulated_effectors(
    model: Model,
    configurations: Sequence[Configuration],
    solution: EquilibriumSolution,
) -> list[tuple[list[dict[str, Any]], list[dict[str, Any]]]]:
    """Simulated points and other effectors of each configuration.

    Args:
        model: The body.
        configurations: What was simulated.
        solution: Their equilibria, one lane per configuration.

    Returns:
        For each, points (`name`, `at_rest_mm`, `simulated_mm`), markers first, and the
        others (`name`, `unit`, `is_turn`, `simulated`; turns from rest). Without an
        equilibrium the simulated values are None.
    """
    mesh, mechanism = model.mesh, model.mechanism
    if not any(c.markers or c.effectors for c in configurations):
        return [([], []) for _ in configurations]
    # As if measured at rest: turns are counted from there.
    posed = [
        measured_at_rest(c, mesh, mechanism) if c.markers or c.effectors else c
        for c in configurations
    ]
    arrays = configuration_arrays(mesh, posed, mechanism)
    rows = [effector_rows(mesh, c, mechanism) for c in posed]
    found = []
    for i, (named, numbers) in enumerate(zip(rows, row_numbers(rows), strict=True)):
        lane = jax.tree.map(lambda leaf, i=i: leaf[i], arrays)
        one = jax.tree.map(lambda leaf, i=i: leaf[i], solution)
        ok = bool(one.converged)
        rest = effector_positions(
            model, lane.effectors, jnp.zeros_like(one.displacement)
        )
        values = np.asarray(_values(model, lane, one)) if ok else None
        points, others = [], []
        for (name, row), n in zip(named, numbers, strict=True):
            value = None if values is None else values[n][: WIDTH[row.quantity]]
            if row.quantity == "point":
                simulated = None if value is None else 1e3 * value
                at_rest = 1e3 * np.asarray(rest[n])
                points.append(
                    {"name": name, "at_rest_mm": at_rest, "simulated_mm": simulated}
                )
            else:
                others.append(
                    {
                        "name": name,
                        "unit": row.unit,
                        "is_turn": row.quantity == "turn",
                        "simulated": value,
                    }
                )
        found.append((points, others))
    return found


_effector_values = eqx.filter_jit(effector_values)


def _values(model: Model, lane, one: EquilibriumSolution):
    if not lane.effectors.has_forces:  # cheap enough to need no compiling
        return effector_positions(model, lane.effectors, one.displacement)
    return _effector_values(model, lane, one.displacement, one.multipliers)
