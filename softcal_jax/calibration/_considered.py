"""The errors of a calibration that are considered, and which lanes share each."""

from collections.abc import Hashable, Iterator, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np

from softcal_jax._typing import Bool, HostArray
from softcal_jax.calibration._held_faces import grounded, held_nodes, outward_motion
from softcal_jax.calibration._noise import not_calibrated
from softcal_jax.calibration._present import with_forces, with_gravity, with_loads
from softcal_jax.calibration._problem import CalibrationProblem
from softcal_jax.configurations import Configuration
from softcal_jax.equilibrium import Model
from softcal_jax.fields import (
    QUANTITIES,
    AbstractError,
    FieldError,
    SetupError,
    Uncertain,
)
from softcal_jax.materials import is_point_values

INCOMPRESSIBLE = 0.5
"""Largest Poisson's ratio [-]."""


class Considered(NamedTuple):
    """An error that is considered.

    Attributes:
        cause: What it is called in the budget.
        name: Its own name.
        entry: What it sets; None for the depth of clamps.
        shared: For each configuration, a key that those with the same error have in
            common; None where it is calibrated, or cannot occur.
        motions: For clamps, motion of the reference points in each configuration, see
            `clamp_row` [m]; empty for other errors.
    """

    cause: str
    name: str
    entry: AbstractError | None
    shared: tuple[Hashable, ...]
    motions: tuple[HostArray, ...] = ()

    @property
    def happens(self) -> bool:
        """Whether any configuration has it."""
        return any(key is not None for key in self.shared)

    def groups(
        self, first: int | None = None
    ) -> Iterator[tuple[str, Bool[HostArray, " n_c"]]]:
        """List its independent errors: their names, and which configurations share.

        Only in the `first` so many configurations, by default in all.
        """
        shared = self.shared[:first]
        keys = [key for key in dict.fromkeys(shared) if key is not None]
        for n, key in enumerate(keys, start=1):
            own = key if isinstance(key, str) else f"group {n}" * (len(keys) > 1)
            name = f"{self.name} in {own}" if own else self.name
            yield name, np.array([other == key for other in shared])


def considered(
    uncertain: Uncertain,
    problem: CalibrationProblem,
    configurations: Sequence[Configuration],
) -> tuple[Considered, ...]:
    """List the errors that a calibration may have and does not calibrate.

    Those that cannot occur in any configuration are among them, shared by none: which
    errors are computed is part of a compiled program, and so one serves all poses.

    Args:
        uncertain: Their standard deviations.
        problem: The calibration.
        configurations: Its configurations.
    """
    posed = _Posed(problem, configurations)
    found = [
        own._replace(shared=_uncalibrated(own, posed))
        for kind in (_fields, _loads, _supports, _mechanism, _clamps)
        for own in kind(uncertain, posed)
    ]
    return tuple(found)


class _Posed:
    """A calibration as the lists below ask for it."""

    def __init__(self, problem: CalibrationProblem, configurations):
        self.model, self.space = problem.model, problem.space
        self.arrays = jax.tree.map(np.asarray, problem.configurations)
        self.configurations = tuple(configurations)
        self.everywhere: tuple[Hashable, ...] = ("",) * len(self.configurations)

    def where(self, keys: Sequence[Hashable], there: Any) -> tuple[Hashable, ...]:
        """Return keys where a flag of the configuration is set, None elsewhere."""
        return tuple(k if t else None for k, t in zip(keys, there, strict=True))


def _fields(uncertain: Uncertain, posed: _Posed) -> Iterator[Considered]:
    """List errors of Poisson's ratios, and of the density where there is gravity."""
    model = posed.model
    for field, value in _ratios(model):
        name = field.rpartition(".")[2]
        share = _not_calibrated(posed, name)
        room = 0.5 * (INCOMPRESSIBLE - float(np.max(value)))
        entry = FieldError(name, min(uncertain.nu, room), field, jax.device_put(share))
        open_ = [bool(np.any(share))] * len(posed.configurations)
        yield _same(name, entry, posed.where(posed.everywhere, open_))
    share = _not_calibrated(posed, "density")
    heavy = bool(np.any(share * np.asarray(model.density) > 0.0))
    entry = FieldError(
        "density", uncertain.density, "density", jax.device_put(share), relative=True
    )
    falls = heavy & np.any(posed.arrays.gravity, axis=1)
    yield _same("density", entry, posed.where(posed.everywhere, falls))


def _ratios(model: Model) -> Iterator[tuple[str, HostArray]]:
    """List the Poisson's ratios of the law: path and values."""
    leaves = jax.tree_util.tree_leaves_with_path(model.law, is_leaf=is_point_values)
    for path, leaf in leaves:
        field = "law" + jax.tree_util.keystr(path)
        if (field.rpartition(".")[2] + "_").startswith("nu_"):
            yield field, np.asarray(leaf.values if is_point_values(leaf) else leaf)


def _not_calibrated(posed: _Posed, field: str) -> HostArray:
    """Return 1 for each tet in which no parameter sets a field, 0 for the others."""
    share = np.ones(posed.model.n_tets)
    for entry in posed.space.entries:
        if any(name.rpartition(".")[2] == field for name in entry.fields):
            group = entry.tet_group
            share[slice(None) if group is None else posed.model.mesh.tets_of(group)] = 0
    return share


def _loads(uncertain: Uncertain, posed: _Posed) -> Iterator[Considered]:
    """List errors of gravity, dead loads and imposed forces."""
    arrays = posed.arrays
    gravities = [tuple(g) for g in arrays.gravity]
    keys = posed.where(gravities, with_gravity(arrays))
    for axis in QUANTITIES["gravity_tilt"].components:
        yield _of_setup("gravity_tilt", uncertain, axis=axis, keys=keys)
    for name, there in zip(arrays.loads.names, with_loads(arrays).T, strict=True):
        keys = posed.where(posed.everywhere, there)
        yield _of_setup("load_factor", uncertain, name, keys=keys)
    for name, there in zip(arrays.actuation.names, with_forces(arrays).T, strict=True):
        keys = posed.where(posed.everywhere, there)
        yield _of_setup("actuator_factor", uncertain, name, keys=keys)


def _supports(uncertain: Uncertain, posed: _Posed) -> Iterator[Considered]:
    """List errors of elastic supports."""
    springs = posed.arrays.springs
    for name, stiffness in zip(springs.names, springs.stiffness.T, strict=True):
        keys = posed.where(posed.everywhere, stiffness > 0.0)
        yield _of_setup("clamp_stiffness", uncertain, name, keys=keys)


def _clamps(uncertain: Uncertain, posed: _Posed) -> Iterator[Considered]:
    """List the error of the depth of clamps."""
    held = held_nodes(posed.model, posed.arrays)
    keys = [nodes.tobytes() for nodes in held]
    of_key = {
        key: uncertain.clamp * outward_motion(posed.model.mesh, nodes)
        for key, nodes in zip(keys, held, strict=True)
    }
    motions = tuple(of_key[key] for key in keys)
    shared = posed.where(keys, [bool(np.any(motion)) for motion in motions])
    yield Considered("clamp", "clamp", None, shared, motions)


def _mechanism(uncertain: Uncertain, posed: _Posed) -> Iterator[Considered]:
    """List errors of motors driven by their angle, and of mounted bodies."""
    mechanism, arrays = posed.model.mechanism, posed.arrays
    actuators, bodies = mechanism.actuators, mechanism.bodies
    by_angle = arrays.actuation.by_displacement.T
    for name, body, there in zip(
        actuators.names, actuators.motor_body, by_angle, strict=True
    ):
        if body >= 0:
            keys = posed.where(posed.everywhere, there)
            yield _of_setup("motor_zero", uncertain, name, keys=keys)
    held = grounded(posed.model, arrays).T
    for name, there in zip(bodies.names, held, strict=True):
        keys = posed.where(posed.everywhere, there)
        for axis in QUANTITIES["mounting"].components:
            yield _of_setup("mounting", uncertain, name, axis=axis, keys=keys)


def _same(cause: str, entry: AbstractError, shared: tuple[Hashable, ...]) -> Considered:
    """Return an error, with keys of the configurations where it is not zero."""
    none = (None,) * len(shared)
    return Considered(cause, entry.name, entry, shared if entry.std > 0.0 else none)


def _of_setup(
    kind: str,
    uncertain: Uncertain,
    of: str = "",
    *,
    axis: str = "",
    keys: tuple[Hashable, ...],
) -> Considered:
    """Return an error of the setup; its name says whose it is."""
    cause = QUANTITIES[kind].uncertain
    name = " ".join(word for word in (kind, of, axis) if word)
    entry = SetupError(name, getattr(uncertain, cause), kind, of, axis)
    return _same(cause, entry, keys)


def _uncalibrated(own: Considered, posed: _Posed) -> tuple[Hashable, ...]:
    """Return the keys of an error, None where a parameter of the fit is the same."""
    entry = own.entry
    if not isinstance(entry, SetupError):
        return own.shared
    free = not_calibrated(
        posed.space, posed.configurations, entry.kind, of=entry.of, axis=entry.axis
    )
    return posed.where(own.shared, free)
