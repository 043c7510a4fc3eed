"""Parameters: control points, bounds, scaling S, place in the model (Sec. IV.A)."""

from softcal_jax.fields._control_points import ControlPoints, idw_weights
from softcal_jax.fields._model_fields import find_field, set_field
from softcal_jax.fields._parameters import Parameter
from softcal_jax.fields._setup import SetupParameter, motor_zero, mounting
from softcal_jax.fields._space import Entry, ParameterSpace, Pin, as_space, check_names
from softcal_jax.fields._spread import ControlPointParameters
from softcal_jax.fields._unnamed import unnamed
from softcal_jax.fields._validation import check_parameters

__all__ = [
    "ControlPointParameters",
    "ControlPoints",
    "Entry",
    "Parameter",
    "ParameterSpace",
    "Pin",
    "SetupParameter",
    "as_space",
    "check_names",
    "check_parameters",
    "find_field",
    "idw_weights",
    "motor_zero",
    "mounting",
    "set_field",
    "unnamed",
]
