"""Sensitivity of the effectors to a field in each single tet, for all tets at once."""

from collections.abc import Sequence

import equinox as eqx
import numpy as np

from softcal_jax._lanes import stacked
from softcal_jax._typing import Array, Bool, Float, HostArray
from softcal_jax.calibration import as_sequence
from softcal_jax.configurations import (
    Configuration,
    ConfigurationArrays,
    configuration_lanes,
    measured_at_rest,
)
from softcal_jax.equilibrium import (
    Model,
    NewtonSettings,
    Program,
    Workers,
    adjoint_rows,
    check_converged,
    effector_values,
    equilibria,
    linearise,
)
from softcal_jax.fields import find_field
from softcal_jax.sensitivity import adjoint_of_tets

_SEES_FORCES = ("force", "reaction", "observation")


@eqx.filter_jit
def _rows(
    model: Model,
    fields: tuple[str, ...],
    configuration: ConfigurationArrays,
    u: Float[Array, "n_points 3"],
    lambda_a: Float[Array, " n_a"],
) -> tuple[Float[Array, "n_fields n_e n_tets"], Bool[Array, ""]]:
    """Return the rows of a configuration, and whether they are sound."""
    lin = linearise(model, configuration, u, lambda_a)
    adjoint = adjoint_rows(lin, effector_values)
    return adjoint_of_tets(lin, fields, adjoint.state), adjoint.ok


def tet_sensitivities(
    model: Model,
    configurations: Configuration | Sequence[Configuration],
    fields: str | Sequence[str],
    *,
    newton: NewtonSettings | None = None,
) -> dict[str, Float[HostArray, "n_e n_tets"]]:
    """Compute the change of every measured coordinate per change of a field in a tet.

    This is Eq. (9) for the finest layout possible, one control point per tet, in
    adjoint form: each configuration is solved for the rows W_e = K^-T H_e^T, and one
    pass over the tets gives the forces of their fields.

    Fields are of the law, or "density", and are differentiated at their values in the
    model; `measured` of the configurations is ignored. Rows of each field are for the
    measured coordinates, in the order configuration, marker, axis; in units of the
    noise per SI unit of the field.

    Raises:
        ValueError: If a field does not exist, a configuration has no effectors, or one
            of them is a force.
        RuntimeError: If a configuration has no equilibrium, or a singular one.
    """
    posed = as_sequence(configurations)
    names = (fields,) if isinstance(fields, str) else tuple(fields)
    for field in names:
        find_field(model, field)
    mesh, mechanism = model.mesh, model.mechanism
    measured = [measured_at_rest(c, mesh, mechanism) for c in posed]
    arrays, records = configuration_lanes(mesh, measured, mechanism)
    if any(e.quantity in _SEES_FORCES for of_pose in records for e in of_pose):
        raise ValueError(
            "tet_sensitivities takes effectors that follow from positions: leave out "
            "ActuatorForce, SupportReaction and Observation."
        )
    with Workers(model, len(posed)) as workers:
        solution = equilibria(workers, model, arrays, newton or NewtonSettings())
        check_converged(solution, tuple(c.name for c in posed))
        states = solution.displacement, solution.multipliers
        lanes = zip(arrays, *states, strict=True)
        by_lane, sound = stacked(workers.map(Program(_rows, model, names), lanes))
    for c, ok in zip(posed, np.asarray(sound), strict=True):
        if not ok:
            raise RuntimeError(
                f"configuration {c.name!r}: its tangent is singular at the equilibrium."
            )
    weight = np.asarray(arrays.effectors.inverse_std).ravel()
    seen = weight > 0.0
    rows = np.moveaxis(np.asarray(by_lane), 1, 0)
    rows = rows.reshape(len(names), len(weight), mesh.n_tets)[:, seen]
    return dict(zip(names, weight[seen, None] * rows, strict=True))
