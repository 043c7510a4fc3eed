"""A parameter space without its names, so that alike ones share compiled programs."""

from collections.abc import Mapping
from dataclasses import replace

from softcal_jax.fields._control_points import ControlPoints
from softcal_jax.fields._parameters import Parameter
from softcal_jax.fields._setup import SetupParameter
from softcal_jax.fields._space import Entry, ParameterSpace
from softcal_jax.fields._spread import ControlPointParameters


def unnamed(space: ParameterSpace) -> ParameterSpace:
    """The same parameters, numbered.

    Names belong to a compiled program: spaces that differ in nothing else, like two
    layouts with as many control points, would be two programs. Numbered they are one.

    Args:
        space: The parameters.

    Returns:
        A space with the same parameters in the same order, for computing; reports need
        the names.
    """
    points: dict[str, str] = {}
    names: dict[str, str] = {}
    for entry in space.entries:
        if isinstance(entry, ControlPointParameters):
            for point in entry.control_points.names:
                number = points.setdefault(point, str(len(points) + 1))
                names[f"{entry.field} of {point}"] = f"{entry.field} of {number}"
        else:
            (parameter,) = entry.parameters
            names[parameter.name] = f"parameter {len(names) + 1}"

    def rename(name: str) -> str:
        return names.get(name, name)  # an order may name fields as well

    return ParameterSpace(
        tuple(_renamed(entry, points, names) for entry in space.entries),
        order=[(rename(small), rename(large)) for small, large in space.order],
        axes=[[rename(name) for name in axis] for axis in space.axes],
        tensor_steps=space.tensor_steps,
        pin=space.pin,
    )


def _renamed(
    entry: Entry, points: Mapping[str, str], names: Mapping[str, str]
) -> Entry:
    if isinstance(entry, Parameter):
        return replace(entry, name=names[entry.name])
    if isinstance(entry, SetupParameter):
        own = entry.parameter
        parameter = replace(own, name=names[own.name])
        return SetupParameter(entry.kind, entry.of, parameter, entry.axis)
    at = entry.control_points
    return ControlPointParameters(
        entry.field,
        ControlPoints(
            at.positions,
            names=[points[name] for name in at.names],
            power=at.power,
            nearest=at.nearest,
            axes=at.axes,
            max_distance=at.max_distance,
        ),
        start=entry.start,
        lower=entry.lower,
        upper=entry.upper,
        scale=entry.scale,
        S=entry.S,
        region=entry.region,
        interpolation=entry.interpolation,
        sampling=entry.sampling,
        fixed={points[name]: value for name, value in entry.fixed.items()},
        tied={points[name]: names[other] for name, other in entry.tied},
        max_step=entry.max_step,
        prior_std=entry.prior_std,
        core=entry.core,
    )
