"""Refuse a calibration whose data cannot tell what it calibrates."""

from collections.abc import Sequence

import jax
import numpy as np

from softcal_jax._typing import Bool, HostArray
from softcal_jax.calibration._evaluation import Evaluation
from softcal_jax.calibration._held_faces import held_nodes
from softcal_jax.calibration._problem import CalibrationProblem
from softcal_jax.fields import AbstractFieldEntry, Poses, SetupParameter

ROUNDING = 1e-12
"""Change of a coordinate by a unit of lambda_p, over its size, that is rounding [-]."""


def check_effects(problem: CalibrationProblem) -> None:
    """Raise unless something is measured, and it may depend on each parameter.

    What only an equilibrium shows is left to `check_sensitive`.

    Args:
        problem: The calibration.

    Raises:
        ValueError: If no coordinate is measured, all markers are on what is held, or no
            configuration depends on a parameter.
    """
    arrays = jax.tree.map(np.asarray, problem.configurations)
    effectors = arrays.effectors
    counts = np.any(effectors.inverse_std > 0.0, axis=2)
    if not np.any(counts):
        raise ValueError(
            "no coordinate is measured: every marker has `axes` that leave all of them "
            "out, or no value. Measure at least one coordinate."
        )
    held = held_nodes(problem.model, problem.configurations)
    if all(problem.space.sets_fields) and _all_on_held(effectors, counts, held):
        raise ValueError(
            "nothing to learn: all markers are on parts that are held (supports, "
            "clamps, rigid bodies that are held or on a motor), so no parameter moves "
            "them. Put markers where the body moves."
        )
    for entry in problem.space.entries:
        missing = _missing(problem, entry, arrays, held)
        if missing:
            names = ", ".join(repr(q.name) for q in entry.parameters)
            raise ValueError(
                f"nothing to learn of {names}: {missing}. Leave it out, or add a "
                "configuration that depends on it."
            )


def _all_on_held(effectors, counts: Bool[HostArray, "n_c n_rows"], held) -> bool:
    """Return whether each measured row is a point on nodes that are held."""
    n_points = effectors.nodes.shape[1]
    if np.any(counts[:, n_points:]):
        return False
    lanes = np.arange(len(held))[:, None, None]
    mesh_nodes = np.minimum(effectors.nodes, held.shape[1] - 1)
    free = ~held[lanes, mesh_nodes] | (effectors.nodes >= held.shape[1])
    return not np.any(np.any(free & (effectors.weights != 0.0), axis=2) & counts)


def _missing(problem: CalibrationProblem, entry, arrays, held) -> str:
    """Say why no configuration depends on an entry; empty if one may."""
    if isinstance(entry, AbstractFieldEntry):
        mesh = problem.model.mesh
        tets = (
            mesh.tets if entry.region is None else mesh.tets[mesh.tets_of(entry.region)]
        )
        if held[:, tets].all():
            where = "the body" if entry.region is None else repr(entry.region)
            return f"all tets of {where} are held in every pose"
        if entry.fields == ("density",) and not np.any(arrays.gravity):
            return "no configuration has gravity"
    if isinstance(entry, SetupParameter) and entry.quantity.absent:
        recordings = ("",) * len(arrays.gravity)
        poses = Poses(problem.model, arrays, recordings)
        if not any(key is not None for key in entry.quantity.occurs(poses)[entry.of]):
            return entry.quantity.absent.format(of=entry.of)
    return ""


def check_sensitive(problem: CalibrationProblem, first: Evaluation) -> None:
    """Raise unless a measured coordinate depends on some parameter at the start.

    One parameter without effect beside others that have one is no error: the angle of
    an axis has none where the moduli are equal.

    Args:
        problem: The calibration.
        first: Its evaluation at the start.

    Raises:
        ValueError: If none does; the text names the parameters.
    """
    weight = np.asarray(problem.configurations.effectors.inverse_std)
    effectors = np.abs(np.asarray(first.effectors))
    size = np.max(weight * effectors, initial=0.0)
    W = np.asarray(first.rows.W)[: weight.size]
    if not np.all(np.isfinite(W)) or np.max(np.abs(W)) > ROUNDING * size:
        return
    names = ", ".join(map(repr, problem.space.names))
    raise ValueError(
        f"nothing to learn of {names}: no measured coordinate moves with it at the "
        "start equilibrium. Check that a load, gravity or an actuator deforms the body "
        "where it is measured, or start from another value."
    )


def check_cost(
    problem: CalibrationProblem, first: Evaluation, names: Sequence[str]
) -> None:
    """Raise unless the squares of the errors at the start can be summed.

    Args:
        problem: The calibration.
        first: Its evaluation at the start.
        names: Names of the configurations.

    Raises:
        ValueError: If a standard deviation is so small that the cost overflows; the
            text names it.
    """
    error = np.asarray(first.rows.error)
    with np.errstate(over="ignore", invalid="ignore"):
        if np.isfinite(error @ error):
            return
    weight = np.asarray(problem.configurations.effectors.inverse_std)
    c = int(np.argmax(np.max(weight, axis=(1, 2))))
    raise ValueError(
        "the cost at the start is not finite, since an error is too large beside its "
        f"standard deviation: the smallest is {1.0 / np.max(weight):.3g} in SI units, "
        f"in configuration {names[c]!r}. Check the `std` of effectors and priors, and "
        "their units."
    )
