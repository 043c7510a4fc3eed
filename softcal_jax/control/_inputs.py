"""What inputs do to effectors: derivatives (Eqs. 4, 5), values over a workspace."""

from collections.abc import Sequence
from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike

from softcal_jax._lanes import lane_of
from softcal_jax._module import Module
from softcal_jax._typing import Array, Bool, Float, HostArray, numpy_of
from softcal_jax.configurations import (
    Configuration,
    ConfigurationArrays,
    actuation_arrays,
    configuration_lanes,
)
from softcal_jax.equilibrium import (
    EquilibriumSolution,
    Model,
    NewtonSettings,
    Workers,
    actuator_forces,
    derivatives,
    effector_values,
    effectors_on_all_cores,
    equilibria,
    input_rows,
    linearise,
    outcome_words,
    residual,
    sensitivity,
)

_NO_STIFFNESS = 1e-11
"""Stiffness met by an input, relative to the largest, up to which it is rounding."""


class ActuatorReadings(Module):
    """Effectors e, as `effector_values`, lambda_a and delta_a of all actuators."""

    effectors: Float[Array, "n_rows 3"]
    forces: Float[Array, " n_a"]
    displacements: Float[Array, " n_a"]


class ActuatorCompliance(Module):
    """Derivatives of an equilibrium by the inputs, the imposed values of the actuators.

    An input is a force lambda_a or a displacement delta_a; all matrices have one column
    per input, in its unit. Everything is nan where there is no equilibrium.

    Attributes:
        state: Effectors, forces and displacements at the equilibrium.
        W_ea: Change of each effector coordinate per input; the three coordinates of
            an effector are consecutive rows.
        by_force: Change of the forces; a row of the identity where a force is imposed.
        by_displacement: Change of the displacements, likewise.
        W_aa: H_a K^-1 H_a^T, displacements per forces if all actuators were driven by
            force; positive definite where that state is stable. Zero for slack cables,
            pressures on open surfaces, and imposed displacements that nothing resists.
        slack: Cables that their imposed displacement leaves slack, so they do not act.
        displacement: Change of the displacement of all nodes, one row per input [m].
    """

    state: ActuatorReadings
    W_ea: Float[Array, "n_e n_a"]
    by_force: Float[Array, "n_a n_a"]
    by_displacement: Float[Array, "n_a n_a"]
    W_aa: Float[Array, "n_a n_a"]
    slack: Bool[Array, " n_a"]
    displacement: Float[Array, "n_a n_points 3"]


def actuator_readings(
    model: Model, configuration: ConfigurationArrays, solution: EquilibriumSolution
) -> ActuatorReadings:
    """Read effectors and actuators of a configuration at its equilibrium."""
    u, lambda_a = solution.displacement, solution.multipliers
    unbalanced = residual(model, configuration, u, lambda_a)
    return _state(model, configuration, u, lambda_a, unbalanced)


def _state(model: Model, configuration: ConfigurationArrays, u, lambda_a, unbalanced):
    return ActuatorReadings(
        effector_values(model, configuration, u, lambda_a, unbalanced),
        actuator_forces(model, configuration, u, lambda_a, unbalanced),
        model.displacements(u),
    )


def with_inputs(
    configuration: ConfigurationArrays, value: Float[Array, " n_a"]
) -> ConfigurationArrays:
    """Replace the inputs of a configuration, given in the units of the actuators."""
    return eqx.tree_at(lambda c: c.actuation.value, configuration, value)


@eqx.filter_jit
def actuator_compliance(
    model: Model, configuration: ConfigurationArrays, solution: EquilibriumSolution
) -> ActuatorCompliance:
    """Compute W_ea and W_aa of a configuration at its equilibrium; Eqs. (4), (5).

    One factorization serves all columns.
    """
    value = jnp.asarray(configuration.actuation.value)
    u = solution.displacement
    # lambda_a is estimated anew: the solution may be that of imposed forces.
    lin = linearise(model, configuration, u)
    lambda_a = lin.lambda_a
    state = _state(model, configuration, u, lambda_a, lin.unbalanced(u, lambda_a))
    ends = np.cumsum([leaf.size for leaf in jax.tree.leaves(state)])[:-1]

    def readings(*arguments):
        return jnp.concatenate([v.ravel() for v in jax.tree.leaves(_state(*arguments))])

    def by_inputs(function):
        of = lambda value: function(model, with_inputs(configuration, value))
        return derivatives(of, value)

    changes = sensitivity(lin, input_rows(lin, by_inputs, readings), readings)
    ok = changes.ok & solution.converged
    or_nan = lambda a: jnp.where(ok, a, jnp.nan)
    W_ea, forces, displacements = jnp.split(or_nan(changes.W_ep), ends)
    assert changes.displacement is not None
    actuators = model.mechanism.actuators
    by_displacement = jnp.asarray(configuration.actuation.by_displacement)
    stands_still = jnp.diag(displacements) == 0.0
    slack = by_displacement & jnp.asarray(actuators.unilateral) & stands_still
    acts = ~slack & jnp.asarray(actuators.has_displacement)
    acts &= is_resisted(forces, displacements, changes.displacement)
    return ActuatorCompliance(
        state=state,
        W_ea=W_ea,
        by_force=forces,
        by_displacement=displacements,
        W_aa=force_compliance(
            forces, displacements, acts, symmetric=not any(actuators.has_friction)
        ),
        slack=slack,
        displacement=or_nan(changes.displacement),
    )


def is_resisted(by_force, by_displacement, displacement):
    """Return which inputs meet a stiffness: energy per squared motion [N/m]."""
    xp = numpy_of(by_force)
    energy = xp.abs(xp.sum(by_force * by_displacement, axis=0))
    motion = xp.abs(displacement).max(axis=(1, 2), initial=0.0)
    stiffness = energy / xp.where(motion > 0.0, motion, 1.0) ** 2
    # True where the stiffness is nan, so that results stay nan.
    return ~(stiffness <= _NO_STIFFNESS * stiffness.max(initial=0.0))


def force_compliance(by_force, by_displacement, acts, *, symmetric: bool):
    """Solve delta = W_aa lambda for W_aa, given both changes per input.

    Solving covers motors too, whose bodies are held and therefore no unknowns.
    """
    xp, both = numpy_of(by_force), acts[:, None] & acts[None]
    by_force = xp.where(both, by_force, xp.eye(acts.size, dtype=by_force.dtype))
    by_displacement = xp.where(both, by_displacement, 0.0)
    W = xp.linalg.solve(by_force.T, by_displacement.T).T
    return 0.5 * (W + W.T) if symmetric else W


class Workspace(Module):
    """Effectors over a set of actuations.

    Attributes:
        inputs: Imposed values, in the units of the actuators.
        names: Names of the commanded actuators, the columns of `inputs`.
        effectors: Coordinates of each effector by name: positions [m], rotation vectors
            [rad], forces [N]; a scalar is the first coordinate; a frame has two rows.
            nan where there is no equilibrium.
        converged: Which samples have an equilibrium.
        solution: The equilibria.
        failures: The samples without an equilibrium, and why.
    """

    inputs: Float[HostArray, "n_samples n_inputs"]
    names: tuple[str, ...]
    effectors: dict[str, Float[HostArray, "n_samples n_rows 3"]]
    converged: Bool[HostArray, " n_samples"]
    solution: EquilibriumSolution
    failures: tuple[str, ...]


def sample_workspace(
    model: Model,
    configuration: Configuration,
    inputs: Float[ArrayLike, "..."] | Sequence,
    *,
    settings: NewtonSettings | None = None,
) -> Workspace:
    """Compute the effectors for many actuations, each solved from rest, on all cores.

    Args:
        model: The model.
        configuration: Its `actuation` says which actuators are commanded, by force or
            by displacement; its effectors are recorded.
        inputs: One actuation per row, in the order and units of `actuation`.
        settings: Settings of the equilibria.

    Raises:
        ValueError: If nothing is commanded, there are no effectors, or the inputs are
            not one finite number per commanded actuator and sample.
    """
    names = tuple(configuration.actuation)
    inputs = np.asarray(inputs, float)
    what = f"configuration {configuration.name!r}"
    if not names:
        raise ValueError(f"{what} commands no actuator: name some in `actuation`.")
    if inputs.ndim != 2 or inputs.shape[1] != len(names):
        raise ValueError(
            f"inputs need one column for each of {', '.join(names)}, shape (n_samples, "
            f"{len(names)}), got {inputs.shape}."
        )
    mechanism = model.mechanism
    lanes = configuration_lanes(model.mesh, [configuration], mechanism)
    if not lanes.effectors[0]:
        raise ValueError(f"{what} has no effectors and no markers to follow.")
    samples = []
    for i, sample in enumerate(inputs):
        asked = {
            name: replace(configuration.actuation[name], value=float(value))
            for name, value in zip(names, sample, strict=True)
        }
        which = f"{configuration.name}, sample {i}"
        value = jnp.asarray(actuation_arrays(mechanism, asked, which).value)
        samples.append(with_inputs(lanes.arrays[0], value))
    rest = jnp.zeros((len(samples), model.n_points, 3))
    newton = settings or NewtonSettings()
    with Workers(model, len(samples)) as workers:
        solution = equilibria(workers, model, samples, newton, guess=rest)
        coordinates = effectors_on_all_cores(workers, model, samples, solution)
    effectors: dict[str, list] = {}
    for record in lanes.effectors[0]:
        row = np.asarray(coordinates)[:, record.index]
        effectors.setdefault(record.name, []).append(row)
    converged = np.asarray(solution.converged)
    failures = []
    for i in np.flatnonzero(~converged).tolist():
        pairs = zip(names, inputs[i], strict=True)
        asked = ", ".join(f"{name} = {value:g}" for name, value in pairs)
        failures.append(f"sample {i} ({asked}): {outcome_words(lane_of(solution, i))}")
    return Workspace(
        inputs=inputs,
        names=names,
        effectors={name: np.stack(rows, axis=1) for name, rows in effectors.items()},
        converged=converged,
        solution=solution,
        failures=tuple(failures),
    )
