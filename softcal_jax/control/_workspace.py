"""Effectors over many actuations, computed by one program."""

from collections.abc import Sequence
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike

from softcal_jax._module import Module
from softcal_jax._results import RESULTS
from softcal_jax._typing import Bool, Float, HostArray
from softcal_jax.configurations import (
    Configuration,
    actuation_arrays,
    configuration_lanes,
)
from softcal_jax.control._compliance import with_inputs
from softcal_jax.equilibrium import (
    EquilibriumSolution,
    Model,
    NewtonSettings,
    Workers,
    effectors_on_all_cores,
    equilibria,
)


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
    values = []
    for i, sample in enumerate(inputs):
        asked = {
            name: replace(configuration.actuation[name], value=float(value))
            for name, value in zip(names, sample, strict=True)
        }
        which = f"{configuration.name}, sample {i}"
        values.append(actuation_arrays(mechanism, asked, which).value)
    samples = [with_inputs(lanes.arrays[0], jnp.asarray(value)) for value in values]
    rest = jnp.zeros((len(samples), model.n_points, 3))
    with Workers(model, len(samples)) as workers:
        run = workers, model, samples, settings or NewtonSettings()
        solution = equilibria(*run, guess=rest)
        coordinates = effectors_on_all_cores(workers, model, samples, solution)
    effectors: dict[str, list] = {}
    for record in lanes.effectors[0]:
        row = np.asarray(coordinates)[:, record.index]
        effectors.setdefault(record.name, []).append(row)
    converged = np.asarray(solution.converged)
    failures = []
    for i in np.flatnonzero(~converged):
        result = jax.tree.map(lambda leaf, i=i: leaf[i], solution.result)
        pairs = zip(names, inputs[i], strict=True)
        asked = ", ".join(f"{name} = {value:g}" for name, value in pairs)
        failures.append(f"sample {i} ({asked}): {RESULTS[result]}")
    return Workspace(
        inputs=inputs,
        names=names,
        effectors={name: np.stack(rows, axis=1) for name, rows in effectors.items()},
        converged=converged,
        solution=solution,
        failures=tuple(failures),
    )
