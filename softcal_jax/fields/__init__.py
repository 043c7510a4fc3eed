"""Parameters: control points, bounds, scaling S, place in the model (Sec. IV.A)."""

from softcal_jax.fields._control_points import (
    ControlPointParameters as ControlPointParameters,
    ControlPoints as ControlPoints,
)
from softcal_jax.fields._kinds import (
    KINDS as KINDS,
    OFFSET as OFFSET,
    Kind as Kind,
    Scope as Scope,
    Uncertain as Uncertain,
    exactly_known as exactly_known,
    grounded_bodies as grounded_bodies,
)
from softcal_jax.fields._order import Likeness as Likeness, Region as Region
from softcal_jax.fields._parameters import (
    AbstractEntry as AbstractEntry,
    AbstractFieldEntry as AbstractFieldEntry,
    FieldError as FieldError,
    Parameter as Parameter,
    constants_of as constants_of,
    find_field as find_field,
    kind_of as kind_of,
    region_tets as region_tets,
    set_field as set_field,
)
from softcal_jax.fields._setup import (
    FUNCTIONS as FUNCTIONS,
    SetupError as SetupError,
    SetupParameter as SetupParameter,
    __getattr__ as __getattr__,
    command as command,
)
from softcal_jax.fields._space import (
    Entry as Entry,
    Parameters as Parameters,
    ParameterSpace as ParameterSpace,
    Pin as Pin,
    as_space as as_space,
    check_names as check_names,
)
from softcal_jax.fields._start import (
    PRECISION as PRECISION,
    WEAK_UP_TO as WEAK_UP_TO,
    asked_errors as asked_errors,
    check_parameters as check_parameters,
    check_precision as check_precision,
    check_scopes as check_scopes,
    check_starts as check_starts,
    default_starts as default_starts,
    field_standard_errors as field_standard_errors,
    order_rows as order_rows,
    random_starts as random_starts,
)

globals().update(FUNCTIONS)  # `motor_zero` and the like, which rows of KINDS make
