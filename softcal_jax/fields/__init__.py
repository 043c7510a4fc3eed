"""Parameters: control points, bounds, scaling S, place in the model (Sec. IV.A)."""

from softcal_jax.fields._control_points import ControlPoints, idw_weights
from softcal_jax.fields._errors import FieldError, SetupError
from softcal_jax.fields._field_errors import field_standard_errors
from softcal_jax.fields._model_fields import find_field, set_field
from softcal_jax.fields._parameters import (
    AbstractEntry,
    AbstractFieldEntry,
    Parameter,
)
from softcal_jax.fields._precision import PRECISION, asked_errors, check_precision
from softcal_jax.fields._setup import (
    QUANTITIES,
    Poses,
    Role,
    Scope,
    SetupParameter,
    grounded_bodies,
)
from softcal_jax.fields._setup_parameters import (
    OFFSET,
    Uncertain,
    actuator_factor,
    clamp_stiffness,
    exactly_known,
    friction,
    gravity_tilt,
    load_factor,
    motor_zero,
    mounting,
    recording_offset,
)
from softcal_jax.fields._space import (
    Entry,
    ParameterSpace,
    Pin,
    as_space,
    check_names,
    unnamed,
)
from softcal_jax.fields._spread import ControlPointParameters
from softcal_jax.fields._validation import check_parameters, check_scopes

__all__ = [
    "OFFSET",
    "PRECISION",
    "QUANTITIES",
    "AbstractEntry",
    "AbstractFieldEntry",
    "ControlPointParameters",
    "ControlPoints",
    "Entry",
    "FieldError",
    "Parameter",
    "ParameterSpace",
    "Pin",
    "Poses",
    "Role",
    "Scope",
    "SetupError",
    "SetupParameter",
    "Uncertain",
    "actuator_factor",
    "as_space",
    "asked_errors",
    "check_names",
    "check_parameters",
    "check_precision",
    "check_scopes",
    "clamp_stiffness",
    "exactly_known",
    "field_standard_errors",
    "find_field",
    "friction",
    "gravity_tilt",
    "grounded_bodies",
    "idw_weights",
    "load_factor",
    "motor_zero",
    "mounting",
    "recording_offset",
    "set_field",
    "unnamed",
]
