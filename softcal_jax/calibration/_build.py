"""Stack a calibration into arrays."""

from collections.abc import Sequence

from softcal_jax._process import check_process
from softcal_jax.calibration._lanes import lane_of
from softcal_jax.calibration._noise import check_references, correlated_noise
from softcal_jax.calibration._notes import (
    warn_if_locking,
)
from softcal_jax.calibration._problem import CalibrationProblem
from softcal_jax.configurations import (
    Configuration,
    ConfigurationLanes,
    configuration_lanes,
)
from softcal_jax.equilibrium import Model, NewtonSettings
from softcal_jax.fields import (
    Entry,
    ParameterSpace,
    Uncertain,
    as_space,
    check_parameters,
    exactly_known,
)


def build_problem(
    model: Model,
    parameters: ParameterSpace | Entry | Sequence[Entry],
    configurations: Configuration | Sequence[Configuration],
    newton: NewtonSettings | None = None,
    *,
    uncertain: Uncertain | None = None,
) -> CalibrationProblem:
    """Stack a calibration into arrays, for `evaluate` and `multi_start`.

    Args:
        model: The body.
        parameters: What is calibrated.
        configurations: Posed robots; each with markers and measured positions.
        newton: Settings of the equilibrium.
        uncertain: How well everything is known that is not calibrated, of which the
            offsets of recordings belong to the noise; by default nothing is uncertain.

    Raises:
        ValueError: If a configuration has no measurement, a parameter no field, or
            `displacement_from` names no configuration with the same effectors.
    """
    posed, uncertain = as_sequence(configurations), uncertain or exactly_known()
    space, newton = as_space(parameters), newton or NewtonSettings()
    problem, lanes = build(model, space, posed, newton, uncertain=uncertain)
    check_references(posed, lanes.effectors)
    return problem


def build(
    model: Model,
    space: ParameterSpace,
    configurations: Sequence[Configuration],
    newton: NewtonSettings,
    *,
    uncertain: Uncertain,
) -> tuple[CalibrationProblem, ConfigurationLanes]:
    """Stack a calibration into arrays, and return its lanes with effector records."""
    check_process()
    for configuration in configurations:
        if not configuration.is_measured:
            raise ValueError(
                f"configuration {configuration.name!r} has no measured positions: give "
                "`markers` and `measured`, or `effectors` with measured values."
            )
    lanes = configuration_lanes(model.mesh, configurations, model.mechanism)
    check_parameters(model, space, lane_of(lanes.arrays, 0))
    warn_if_locking(model, space)
    noise = correlated_noise(
        configurations,
        model=model,
        space=space,
        arrays=lanes.arrays,
        records=lanes.effectors,
        uncertain=uncertain,
    )
    return CalibrationProblem(model, space, lanes.arrays, newton, noise), lanes


def as_sequence(
    configurations: Configuration | Sequence[Configuration],
) -> tuple[Configuration, ...]:
    """Return configurations as a tuple; a single one may be given by itself."""
    one = isinstance(configurations, Configuration)
    return (configurations,) if one else tuple(configurations)
