"""Whether parameters fit the model they are to calibrate."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from softcal_jax.fields._parameters import Parameter, ParameterSpace, find_field


def check_parameters(model: Any, space: ParameterSpace) -> None:
    """Raise unless every parameter sets something of its own, within sound bounds.

    Args:
        model: Anything with `law`, `density` and `mesh`, on the host.
        space: The parameters.

    Raises:
        ValueError: If a field or region does not exist, two parameters set the same
            tets, a parameter without region would flatten constants that differ over
            the body, or a bound is outside the range of the material.
    """
    owner: dict[str, dict[int, str]] = {}
    for parameter in space.parameters:
        where = find_field(model, parameter.field)
        values = np.asarray(where(model))
        if parameter.region is None and values.ndim and np.ptp(values) > 0:
            raise ValueError(
                f"parameter {parameter.name!r} would give the whole body one value of "
                f"{parameter.field}, which now lies between {values.min():g} and "
                f"{values.max():g}. Name the tet group it is for in `region`."
            )
        taken = owner.setdefault(parameter.field, {})
        for tet in _tets(model, parameter):
            other = taken.setdefault(int(tet), parameter.name)
            if other != parameter.name:
                raise ValueError(
                    f"parameters {other!r} and {parameter.name!r} both set "
                    f"{parameter.field} of tet {tet}: give them regions that do not "
                    "overlap."
                )
    for side, z in (("lower", space.lower()), ("upper", space.upper())):
        applied = space.apply(model, z)
        try:
            _check_constants(applied.law)
            if not bool(jnp.all(applied.density >= 0.0)):
                raise ValueError("density must not be negative [kg/m3].")
        except ValueError as error:
            raise ValueError(
                f"with all parameters at their {side} bound: {error}"
            ) from (error)


def _tets(model: Any, parameter: Parameter):
    if parameter.region is None:
        return range(model.mesh.tets.shape[0])
    return model.mesh.tets_of(parameter.region)


def _check_constants(module: eqx.Module) -> None:
    """Run the checks of a law, and of the modules in it, as at construction."""
    check = getattr(module, "__check_init__", None)
    if check is not None:
        check()
    for value in vars(module).values():
        if isinstance(value, eqx.Module):
            _check_constants(value)
