"""What speaks against a calibration: checks of its residuals, notes and warnings."""

import math
import warnings
from collections.abc import Iterator, Sequence

import numpy as np
from scipy.special import chdtrc

from softcal_jax._module import Module
from softcal_jax._text import MOST_NAMED, SoftcalWarning, listed
from softcal_jax._typing import Array, Float, HostArray
from softcal_jax._units import readable, readable_values
from softcal_jax.calibration._configuration_result import ConfigurationResult, off_by
from softcal_jax.calibration._problem import CalibrationSettings, n_measured
from softcal_jax.calibration._step import CalibrationState
from softcal_jax.configurations import Configuration, EffectorArrays
from softcal_jax.contact import Contacts
from softcal_jax.equilibrium import Model
from softcal_jax.fields import ParameterSpace, kind_of, order_rows
from softcal_jax.inference import (
    UNLIKELY,
    LackOfFit,
    LinearModel,
    PosePrediction,
    RecordingEstimate,
    Uncertainty,
    agreement_sentences,
    chance,
    disagreeing,
    jitter_freedom,
    lack_of_fit,
    predicted_by_others,
)
from softcal_jax.unknowns import Problem

FEWEST = 3  # fewest configurations of which one is left out and predicted by the others

FAR = 0.25
"""Share of the motion by which a prediction may be off, where no std is stated [-]."""

SLIDES = 0.05
"""Share of the contact area that may slide without a word [-].

A rim of it always slides, since the pressure vanishes there: the outer 5 % of a Hertz
contact bear 1 % of its force.
"""

EQUAL = 1e-6  # difference of scaled parameters below which they count as equal [-]


class LeftOut(Module):
    """A configuration as the others predict it, linearised at the optimum.

    Attributes:
        name: Its name.
        rms: Root mean square distance of predicted from measured points; nan where the
            others do not determine a parameter it depends on, and without points [m].
        expected: The `rms` that noise, parameters and what is held fixed explain [m].
        motion: Root mean square motion of the points [m].
        probability: Chance of errors as large; nan where nothing is predicted, or no
            residuals are left to estimate the noise from [-].
        by_scatter: The same chance with the noise of the scatter within configurations;
            nan where the noise is stated, or there is no such scatter [-].
    """

    name: str
    rms: float
    expected: float
    motion: float
    probability: float
    by_scatter: float


class ResidualChecks(Module):
    """What the residuals of a fit say about its model.

    Attributes:
        names: The fitted configurations.
        lack_of_fit: Scatter between configurations against that within them; None where
            the noise is stated, which is tested by chi-squared, or nothing is left.
        left_out: Each configuration as the others predict it; empty for fewer than
            three.
        recordings: Parameters from single recordings, held out or not, if two or more
            determine them.
        level: Standard deviation that the residuals show, over the one that was stated;
            nan unless one was stated, and was estimated all the same [-].
        probability: Chance of a level as high; nan likewise [-].
    """

    names: tuple[str, ...]
    lack_of_fit: LackOfFit | None
    left_out: tuple[LeftOut, ...]
    recordings: tuple[RecordingEstimate, ...] = ()
    level: float = float("nan")
    probability: float = float("nan")

    @property
    def reasons(self) -> tuple[str, ...]:
        """Why the model cannot be right, one sentence each; empty without a reason."""
        reasons = []
        if self.probability < UNLIKELY:
            reasons.append(
                f"The residuals are {self.level:.3g} times the stated std (p = "
                f"{self.probability:.1g}): the model cannot match the data that well, "
                "or the measurements are noisier than stated."
            )
        test = self.lack_of_fit
        if test is not None and test.probability < UNLIKELY:
            worst = self.names[int(np.argmax(test.shares))]
            reasons.append(
                f"The markers of a pose share an error, the largest in {worst} (F = "
                f"{test.ratio:.3g} with {test.between} and {test.within} degrees of "
                f"freedom, p = {test.probability:.1g}): check its load and supports, "
                "or the law."
            )
        allowed = UNLIKELY / max(len(self.left_out), 1)
        far = lambda p: p.rms > FAR * p.motion and p.by_scatter < UNLIKELY
        wrong = [p for p in self.left_out if p.probability < allowed or far(p)]
        reasons += _contradictions(sorted(wrong, key=lambda p: p.probability))
        alone = []
        for one in sorted(disagreeing(self.recordings), key=lambda e: -abs(e.apart)):
            value, fit = (readable_values([v], one.unit) for v in (one.value, one.fit))
            alone.append(
                f"{one.recording} alone gives {one.parameter} = {value}, "
                f"{abs(one.apart):.1f} standard errors from the fit's {fit}"
            )
        return (*reasons, *([f"{'; '.join(alone[:MOST_NAMED])}."] if alone else []))

    @property
    def agreement(self) -> tuple[str, ...]:
        """What single recordings say about the parameters, one sentence each."""
        return tuple(agreement_sentences(self.recordings))


def _contradictions(poses: Sequence[LeftOut]) -> Iterator[str]:
    """Say how far off the others predict configurations, the unlikeliest first."""
    far = [(p.name, p.rms, p.motion) for p in poses if math.isfinite(p.rms)]
    if far:
        known = max(p.expected for p in poses if math.isfinite(p.rms))
        yield (
            f"Predicted from the other poses, {off_by(far)}; known errors explain "
            f"{'at most ' * (len(far) > 1)}{readable(known, 'about')}."
        )
    for known in (False, True):
        blind = [p for p in poses if not math.isfinite(p.rms)]
        blind = [p for p in blind if math.isfinite(p.motion) == known]
        if blind:
            one, names = len(blind) == 1, listed([p.name for p in blind], MOST_NAMED)
            why = f"which {'has' if one else 'have'} no markers"
            if known:
                why = "whose markers depend on parameters that "
                why += f"{'it' if one else 'each'} alone determines"
            yield (
                f"The other poses contradict {names}, {why}, so no distance can be "
                f"predicted (p = {min(p.probability for p in blind):.1g})."
            )


def residual_checks(
    linear: LinearModel,
    configurations: Sequence[Configuration],
    *,
    effectors: EffectorArrays,
    spread: Uncertainty,
    fits: Sequence[ConfigurationResult],
) -> ResidualChecks:
    """Check a fit by its residuals, without what was held out."""
    weight, estimated = np.asarray(effectors.inverse_std), spread.noise == "estimated"
    names, test = tuple(c.name for c in configurations), None
    if estimated and spread.has_noise:
        shared, pose = _shared_errors(weight, effectors.nodes.shape[-2], fits)
        test = lack_of_fit(linear, shared[weight.ravel() > 0.0], pose)
    left_out: tuple[LeftOut, ...] = ()
    used = np.unique(linear.pose)
    if len(used) >= FEWEST and (spread.has_noise or not estimated):
        of = spread.degrees_of_freedom if estimated else None
        by_scatter = [float("nan")] * len(used)
        if test is not None:
            others = predicted_by_others(linear.with_jitter(test.jitter))
            by_scatter = [
                chance(other.chi_squared, other.degrees_of_freedom, of=test.within)
                for other in others
            ]
        of_used = [fits[c] for c in used], predicted_by_others(linear), weight[used]
        each = zip(*of_used, by_scatter, strict=True)
        left_out = tuple(_left_out(*one, of=of) for one in each)
    level = probability = float("nan")
    if estimated and spread.has_noise and all(c.states_noise for c in configurations):
        level = spread.noise_scale
        dof = jitter_freedom(linear.with_jitter(1.0))
        probability = float(chdtrc(dof, dof * level**2))
    return ResidualChecks(names, test, left_out, level=level, probability=probability)


def _shared_errors(
    weight: Float[HostArray, "n_c n_rows 3"],
    n_points: int,
    fits: Sequence[ConfigurationResult],
) -> tuple[HostArray, HostArray]:
    """Return columns of errors that coordinates may share, and their configurations.

    For a configuration, they are the offsets of its points along the axes, and its
    simulated motion: the measured one holds the errors that are tested.
    """
    columns = np.zeros((len(fits), 4, *weight.shape))
    for c, fit in enumerate(fits):
        columns[c, [0, 1, 2], c, :n_points, [0, 1, 2]] = weight[c, :n_points].T
        for e in fit.points:
            moved = np.where(e.seen, e.simulated - e.at_rest, 0.0)
            columns[c, 3, c, e.index] = weight[c, e.index] * moved
    return columns.reshape(-1, weight.size).T, np.repeat(np.arange(len(fits)), 4)


def _left_out(
    fit: ConfigurationResult,
    prediction: PosePrediction,
    weight: Float[HostArray, "n_rows 3"],
    by_scatter: float,
    *,
    of: int | None,
) -> LeftOut:
    """Describe a prediction in metres."""
    seen = weight > 0.0
    rms = []
    for values in (prediction.error, prediction.std):
        rows = np.zeros(weight.shape)
        rows[seen] = values / weight[seen]
        squares = [np.sum(rows[e.index] ** 2) for e in fit.points if e.seen.any()]
        rms.append(float(np.sqrt(np.mean(squares))) if squares else float("nan"))
    squares, dof = prediction.chi_squared, prediction.degrees_of_freedom
    probability = chance(squares, dof, of=of, jitter_is_of_all=True)
    off, expected = rms
    return LeftOut(fit.name, off, expected, fit.motion, probability, by_scatter)


class CalibrationWarning(SoftcalWarning):
    """Something about a calibration that its user should know."""


def result_notes(
    problem: Problem,
    fits: Sequence[ConfigurationResult],
    z: Float[Array, " n_p"],
    spread: Uncertainty,
) -> list[str]:
    """Collect the notes on fits, parameters, their standard errors and the mesh."""
    notes = _rounding_notes(fits)
    notes += order_notes(problem.space, z)
    notes += uncertainty_notes(problem, spread)
    if problem.model.mesh.order == 1:
        notes.append(
            "Linear tets lock in bending: the calibrated moduli are effective numbers "
            "of this mesh, not properties of the material. Use quadratic tets "
            "(to_quadratic) to compare with data sheets."
        )
    return notes


def fit_notes(state: CalibrationState, settings: CalibrationSettings) -> list[str]:
    """Say why a fit did not converge, if it did not."""
    size = float(np.max(np.abs(state.lambda_p)))
    if state.stalled:
        return [
            f"Not converged: every step was refused, down to a size of {size:.0e}. "
            "Beyond this point a configuration has no equilibrium, or the equilibria "
            "are too inaccurate (newton rtol) to show an improvement."
        ]
    if state.converged:
        return []
    return [
        f"Not converged: after {int(state.step)} steps lambda_p is still {size:.1e} "
        f"(tol {settings.tol:g}). Raise max_steps or look at the history."
    ]


def _rounding_notes(fits: Sequence[ConfigurationResult]) -> list[str]:
    """Name configurations that are in balance up to rounding only."""
    return [
        f"{fit.name}: rounding, estimated at {fit.rounding:.1e}, stopped Newton above "
        f"its rtol, at a relative residual of {fit.residual:.1e}: a region is stiffer "
        "than the others by orders of magnitude, or the loads are tiny compared with "
        "the stiffness. Check units and moduli."
        for fit in fits
        # Without any load, rounding is all there is.
        if fit.at_rounding and fit.rounding < 1.0
    ]


def order_notes(space: ParameterSpace, z: Float[Array, " n_p"]) -> list[str]:
    """Name pairs of moduli that ended equal, at the limit of their prescribed order."""
    pairs, chart, held = space.order_names(), space.chart, []
    at = np.asarray(z)
    if pairs:
        A, b = map(np.asarray, order_rows(space.numbered))
        held = list(A @ at - b >= -EQUAL)
    if chart is not None:
        for small, large in zip(chart.small, chart.large, strict=True):
            pairs.append((space.names[small], space.names[large]))
            held.append(bool(at[large] - at[small] <= EQUAL))
    return [
        f"{small} and {large} ended equal, at the limit of their order: the body is "
        "isotropic there, and the angle of its axis has no effect. Without `axes` the "
        "fit may be stuck there with the axis off by 90 degrees: calibrate from "
        "several starts."
        for (small, large), equal in zip(pairs, held, strict=True)
        if equal
    ]


def uncertainty_notes(problem: Problem, spread: Uncertainty) -> list[str]:
    """Say which standard errors are missing, and what the others rest on."""
    dof = spread.degrees_of_freedom
    names, std = np.array(problem.space.names), np.sqrt(np.diag(spread.covariance))
    notes = [
        f"{name} ended on a bound and has no standard error. Widen the bound; if that "
        "does not help, the model cannot match the data."
        for name in names[spread.at_bound]
    ]
    undetermined = np.isnan(std) & ~spread.at_bound
    if np.any(undetermined):
        blind, why = ", ".join(names[undetermined]), "the data cannot tell them apart"
        if dof <= 0:
            why = (
                f"there are {dof} more measured coordinates than parameters, too few "
                'to estimate the noise; noise = "stated" takes the stated std'
            )
        notes.append(f"No standard error for {blind}: {why}. Add measurements.")
    elif spread.noise == "estimated":
        notes.append(
            f"Standard errors use the noise estimated from the residuals ({dof} "
            "degrees of freedom), which includes the model error."
        )
    return notes


def warn_if_locking(model: Model, space: ParameterSpace) -> None:
    """Warn if a Poisson's ratio may be calibrated into the range where tets lock."""
    if model.mesh.order == 1 or model.formulation == "mean-dilatation":
        return
    for is_field, parameter in zip(space.sets_fields, space.parameters, strict=True):
        if not is_field:
            continue
        name, locks = parameter.field, kind_of(model, parameter.field).locks
        if float(parameter.upper) >= locks:
            warnings.warn(
                f"parameter {parameter.name!r} may reach {name} = {parameter.upper:g}, "
                'where the formulation "displacement" locks: build the model with '
                f'formulation="mean-dilatation", or lower the bound below {locks:g}.',
                CalibrationWarning,
                stacklevel=5,
            )


def warn_if_too_few_data(problem: Problem) -> None:
    """Warn if there are fewer measured coordinates than parameters."""
    measured = n_measured(problem)
    # A prior counts as a measurement of its parameter.
    wanted = int(np.sum(np.asarray(problem.space.prior_weights()) == 0.0))
    if wanted > measured:
        without = " without a prior" if problem.space.has_prior else ""
        warnings.warn(
            f"{wanted} parameters{without} but only {measured} measured coordinates: "
            f"at least {wanted - measured} more needed (a marker gives 3 in each "
            "configuration). The fit is not unique.",
            CalibrationWarning,
            stacklevel=4,
        )


def contact_doubts(
    contacts: Contacts, fits: Sequence[ConfigurationResult]
) -> Iterator[str]:
    """Name the poses where much slides on its way, or the cushion gives way."""
    scale, E = float(contacts.scale), readable(float(contacts.stiffness), "Pa")
    for name in contacts.touched:
        felt = [
            (contact, f'"{fit.name}"')
            for fit in fits
            for contact in (() if fit.robot is None else fit.robot.contacts)
            if contact.name == name
        ]
        slides = sorted(
            (float(c.sliding), pose) for c, pose in felt if c.sliding > SLIDES
        )
        deep = sorted((float(c.depth), pose) for c, pose in felt if c.depth > scale)
        if slides:
            yield (
                f"{_poses(slides)}{100.0 * slides[-1][0]:.0f} % of what touches "
                f'"{name}" slides, as if it had moved straight there: what turned back '
                "on its way is held by other forces."
            )
        if deep:
            what = f'"{name}"' if name in contacts.names else f'itself ("{name}")'
            yield (
                f"{_poses(deep)}{readable(deep[-1][0], 'm')} of the body lie inside "
                f"{what}, deeper than the scale of contact, {readable(scale, 'm')}: "
                f"the pressure is more than half of {E}, the modulus at the start, "
                "which contact has. Start with a larger modulus, or press less."
            )


def _poses(sizes: Sequence[tuple[float, str]]) -> str:
    """Begin a sentence on poses with ascending sizes, of which the last is named."""
    names = listed([pose for _, pose in sizes[::-1]], MOST_NAMED)
    return f"{names}: {'up to ' * (len(sizes) > 1)}"
