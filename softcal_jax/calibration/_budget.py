"""The error budget: standard errors of the parameters by cause.

What is held fixed is a consider parameter c, with a standard deviation and no estimate
(Schmidt, Adv. Control Systems 3, 1966; Tapley, Schutz, Born, Statistical Orbit
Determination, 2004, ch. 6). The residuals of the fit are W dz + W_c dc + noise, so an
error dc moves the optimum by

    dz = -G W_c dc,   G = (W^T W / s^2 + P)^-1 W^T / s^2,

with the rows W_c of Eq. (9), and the covariance of the estimate is that of the noise
plus the sum of G W_c Sigma_c W_c^T G^T over the causes. Offsets of recordings and creep
belong to the noise, so W and s are in units of its covariance (see `CorrelatedNoise`);
they are causes too, by the same gain, and what the noise has left is its jitter.
"""

from collections.abc import Container, Iterable, Mapping, Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._module import Module
from softcal_jax._typing import Array, Float, HostArray
from softcal_jax._units import readable_unit
from softcal_jax.calibration._considered import Considered, considered
from softcal_jax.calibration._evaluation import Evaluation
from softcal_jax.calibration._lanes import lane_of
from softcal_jax.calibration._mesh_error import REMEDIES, MeshErrors, mesh_errors
from softcal_jax.calibration._noise import named_columns, whitened
from softcal_jax.calibration._problem import CalibrationProblem, without_names
from softcal_jax.calibration._uncertainty import Uncertainty, estimator
from softcal_jax.configurations import Configuration
from softcal_jax.equilibrium import (
    EquilibriumSolution,
    Program,
    Workers,
    effector_values,
    linearise,
    sensitivity,
)
from softcal_jax.fields import ParameterSpace, Uncertain
from softcal_jax.sensitivity import clamp_row, parameter_rows, stiffness_row

NOISE = "noise"
"""Name of what remains if everything that is held fixed is right: the jitter."""

MESH = "mesh"
"""Name of the error of the mesh, see `mesh_errors`."""

LESS_NOISE = ": measure more poses, or with less noise"
"""What helps where the noise is the largest of several causes."""

SMALL = 0.1
"""Share of the standard error below which a sentence leaves a cause out [-]."""


class Cause(Module):
    """One reason why the parameters may be wrong.

    Attributes:
        name: Its name, like "nu".
        errors: Names of its errors, like "recording_offset x in left".
        deviations: Change of the scaled parameters per standard deviation of each of
            its errors [-]; nan for parameters that have no standard error.
    """

    name: str
    errors: tuple[str, ...]
    deviations: Float[HostArray, "n_p n_errors"]

    @property
    def variance(self) -> Float[HostArray, " n_p"]:
        """Variance of the scaled parameters by this cause [-]."""
        return np.sum(self.deviations**2, axis=1)


class ErrorBudget(Module):
    """Standard errors of calibrated parameters, split by cause.

    Attributes:
        names: Names of the parameters.
        values: Their values, in SI.
        slopes: Their change per scaled unit, in SI.
        units: Their SI units.
        noise: Covariance of the scaled parameters by the jitter of coordinates, and
            what the priors leave [-].
        causes: What else may be wrong, the largest first.
        W_c: Change of the stacked errors per standard deviation of what is held fixed
            and may be wrong, in units of the noise, see `identifiability` [-].
        unknown: Causes that count, but whose size could not be estimated: "mesh" where
            `mesh_errors` cannot tell.
    """

    names: tuple[str, ...]
    values: Float[HostArray, " n_p"]
    slopes: Float[HostArray, " n_p"]
    units: tuple[str, ...]
    noise: Float[HostArray, "n_p n_p"]
    causes: tuple[Cause, ...]
    W_c: Float[HostArray, "n_e n_errors"]
    unknown: tuple[str, ...] = ()

    @property
    def covariance(self) -> Float[HostArray, "n_p n_p"]:
        """Covariance of the scaled parameters by all causes together [-]."""
        parts = [cause.deviations @ cause.deviations.T for cause in self.causes]
        return sum(parts, self.noise)

    @property
    def standard_errors(self) -> Float[HostArray, " n_p"]:
        """Standard errors by all causes together, in SI."""
        return self.slopes * np.sqrt(np.diag(self.covariance))

    def by_cause(self) -> dict[str, Float[HostArray, " n_p"]]:
        """Return standard errors by each cause alone in SI, that of the noise first."""
        variances = {NOISE: np.diag(self.noise)}
        variances |= {cause.name: cause.variance for cause in self.causes}
        return {name: self.slopes * np.sqrt(v) for name, v in variances.items()}

    def sentence(self, name: str) -> str:
        """Say how uncertain a parameter is and why, like "noise 4 %, nu 31 %".

        Args:
            name: Name of the parameter.
        """
        i = self.names.index(name)
        total = self.standard_errors[i]
        if not np.isfinite(total):
            return "no standard error"
        own = {cause: float(std[i]) for cause, std in self.by_cause().items()}
        shown = [c for c in own if c == NOISE or own[c] >= SMALL * total]
        shown.sort(key=lambda c: (c != NOISE, -own[c]))
        text = ", ".join(f"{cause} {self.readable(i, own[cause])}" for cause in shown)
        worst = max(own, key=lambda c: own[c])
        text += "".join(f", {cause} unknown" for cause in self.unknown)
        if worst == NOISE:
            return text + LESS_NOISE * (len(shown) > 1)
        (errors,) = [cause.errors for cause in self.causes if cause.name == worst]
        return f"{text}: {REMEDIES.get(errors[0], f'measure {worst} first')}"

    def readable(self, i: int, std: float) -> str:
        """Write an error in percent of the value; angles and offsets as they are.

        Args:
            i: Index of the parameter.
            std: The error, in SI.
        """
        value, unit = abs(float(self.values[i])), self.units[i]
        if unit in ("rad", "m") or value == 0.0:
            factor, shown = readable_unit([std], unit)
            return f"{factor * std:.2g} {shown}".rstrip()
        percent = 100.0 * std / value
        return f"{percent:.0f} %" if percent >= 100.0 else f"{percent:.2g} %"

    def __str__(self) -> str:
        """Write one line for each parameter."""
        return "\n".join(f"{name}: {self.sentence(name)}" for name in self.names)


ByCause = dict[str, dict[str, Float[HostArray, "n_c n_e"]]]
"""For each cause its errors by name: change of the effectors of each configuration."""


def error_budget(
    problem: CalibrationProblem,
    configurations: Sequence[Configuration],
    uncertain: Uncertain,
    own: ByCause,
    *,
    z: Float[Array, " n_p"],
    at: Evaluation,
    spread: Uncertainty,
) -> ErrorBudget:
    """Split the uncertainty of a fit by cause.

    Args:
        problem: The calibration.
        configurations: The fitted configurations.
        uncertain: What is uncertain.
        own: What it does to them, see `considered_errors`.
        z: Where the fit ended, scaled [-].
        at: Evaluation there.
        spread: Uncertainty by the noise.
    """
    space = problem.space
    gain = estimator(np.asarray(at.W_ep), spread, np.asarray(space.prior_weights()))
    in_units = lambda those: _stacked(problem, those.values())
    W_c = {name: in_units(errors) for name, errors in own.items()}
    correlated: Mapping[str, Mapping[str, HostArray]] = {}
    if problem.noise is not None:
        correlated = named_columns(
            configurations, problem.noise, problem.configurations.effectors
        )
    of_noise = {name: in_units(errors) for name, errors in correlated.items()}
    names = {name: tuple(errors) for name, errors in {**own, **correlated}.items()}
    causes = [Cause(n, names[n], -gain @ W) for n, W in (W_c | of_noise).items()]
    whole = np.nan_to_num(sum(cause.variance for cause in causes))
    size = lambda cause: np.nansum(cause.variance / np.where(whole > 0.0, whole, 1.0))
    return ErrorBudget(
        names=tuple(space.names),
        values=np.asarray(space.from_scaled(z)),
        slopes=space.slopes(z),
        units=tuple(q.unit for q in space.parameters),
        noise=_by_jitter(problem, spread, gain),
        causes=tuple(sorted(causes, key=size, reverse=True)),
        W_c=np.concatenate([np.zeros((gain.shape[1], 0)), *W_c.values()], axis=1),
        unknown=unknown_causes(uncertain, own),
    )


def unknown_causes(uncertain: Uncertain, found: Container[str]) -> tuple[str, ...]:
    """Return causes that count, but that `ConsideredErrors.by_cause` does not list."""
    return (MESH,) if uncertain.mesh > 0.0 and MESH not in found else ()


def _stacked(
    problem: CalibrationProblem, errors: Iterable[Float[HostArray, "..."]]
) -> Float[HostArray, "n_e n_errors"]:
    """Stack changes of the effectors as columns, in units of the noise [-]."""
    columns = np.stack([np.ravel(error) for error in errors], axis=1)
    return problem.on_host_in_noise_units(columns)


def _by_jitter(
    problem: CalibrationProblem,
    spread: Uncertainty,
    gain: Float[HostArray, "n_p n_e"],
) -> Float[HostArray, "n_p n_p"]:
    """Compute the covariance by independent errors, and by the priors [-].

    In the units of the noise independent errors are no longer independent: they are
    s (I + A A^T)^-1/2 times numbers that are.
    """
    own = whitened(problem.noise_columns(), gain.T).T
    known = np.flatnonzero(np.isfinite(np.diag(spread.covariance)))
    covariance = np.full(spread.covariance.shape, np.nan)
    C, own = spread.covariance[np.ix_(known, known)], spread.noise_scale * own[known]
    by_prior = C * np.asarray(problem.space.prior_weights())[known]
    covariance[np.ix_(known, known)] = own @ own.T + by_prior @ by_prior.T
    return covariance


class ConsideredErrors(NamedTuple):
    """What is held fixed and may be wrong, and what it does to configurations.

    Attributes:
        found: The errors, and which configurations share each.
        columns: Change of the effectors per standard deviation of each, as if each
            configuration had it.
        mesh: That by the mesh; None if this is right.
    """

    found: tuple[Considered, ...]
    columns: Float[HostArray, "n_errors n_c n_e"]
    mesh: MeshErrors | None

    def by_cause(self, first: int | None = None) -> ByCause:
        """Return W_c of the `first` so many configurations, by default of all.

        These are the changes in the units of the effectors, zero in configurations that
        do not have the error. The error of the mesh is not among them where it is not
        known.
        """
        own: ByCause = {}
        for error, column in zip(self.found, self.columns, strict=True):
            for name, those in error.groups(first):
                shared = np.where(those[:, None], column[:first], 0.0)
                own.setdefault(error.cause, {})[name] = shared
        if self.mesh is not None and np.all(self.mesh.known[:first]):
            own[MESH] = {self.mesh.name: self.mesh.changes[:first]}
        return own


def considered_errors(
    workers: Workers,
    problem: CalibrationProblem,
    configurations: Sequence[Configuration],
    uncertain: Uncertain,
    *,
    z: Float[Array, " n_p"],
    equilibrium: EquilibriumSolution,
) -> ConsideredErrors:
    """Compute W_c: change of the effectors per standard deviation of each error.

    Args:
        workers: Run the configurations.
        problem: The calibration.
        configurations: Its configurations.
        uncertain: What is uncertain.
        z: Scaled parameters [-].
        equilibrium: The equilibria, one lane per configuration.
    """
    found, of_mesh = considered(uncertain, problem, configurations), uncertain.mesh > 0
    problem = without_names(problem)
    if not of_mesh and not any(own.happens for own in found):
        found = ()
    columns = _all_columns(
        workers, problem, found, z, equilibrium.displacement, of_stiffness=of_mesh
    )
    if not of_mesh:
        return ConsideredErrors(found, columns, None)
    mesh = mesh_errors(
        problem,
        configurations,
        z,
        forces=equilibrium.multipliers,
        of_stiffness=columns[-1],
    )
    mesh = mesh._replace(changes=uncertain.mesh * mesh.changes)
    return ConsideredErrors(found, columns[:-1], mesh)


def _all_columns(
    workers: Workers,
    problem: CalibrationProblem,
    found: Sequence[Considered],
    z,
    displacement,
    *,
    of_stiffness: bool,
) -> Float[HostArray, "n_rows n_c n_e"]:
    """Compute W_c as if each configuration had each error, see `_columns`."""
    n_c, n_rows = len(displacement), len(found) + of_stiffness
    n_e = problem.configurations.effectors.measured.size // n_c
    if n_e * n_rows == 0:
        return np.zeros((n_rows, n_c, n_e))
    entries = tuple(own.entry for own in found if own.entry is not None)
    errors = ParameterSpace(entries) if entries else None
    motions = [own.motions for own in found if own.entry is None]
    lanes = [
        (
            tuple(jax.device_put(own[c]) for own in motions),
            z,
            lane_of(problem.configurations, c),
            lane_of(displacement, c),
        )
        for c in range(n_c)
    ]
    program = Program(_columns, problem.model, problem.space, errors, of_stiffness)
    of_lanes = workers.map(program, lanes)
    return np.stack([np.asarray(own).T for own in of_lanes], axis=1)


@eqx.filter_jit
def _columns(
    model,
    space: ParameterSpace,
    errors: ParameterSpace | None,
    of_stiffness: bool,
    motions: tuple[Float[Array, "n_nodes 3"], ...],
    z,
    c,
    u,
) -> Float[Array, "n_e n_rows"]:
    """Compute W_c of one configuration, in the units of its effectors; Eq. (9).

    The last column is that of the stiffness where it is asked for, see `mesh_errors`.
    """
    lin = linearise(*space.apply(model, c, z), u)
    rows = [] if errors is None else [parameter_rows(lin, errors, errors.start())]
    rows += [clamp_row(lin, motion) for motion in motions]
    rows += [stiffness_row(lin)] if of_stiffness else []
    stacked = jax.tree.map(lambda *own: jnp.concatenate(own), *rows)
    fewer = len(stacked.force) > c.effectors.measured.size
    found = sensitivity(lin, stacked, effector_values, adjoint=fewer)
    return jnp.where(found.ok, found.W_ep, jnp.nan)
