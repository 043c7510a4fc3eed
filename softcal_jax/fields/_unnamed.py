"""A parameter space without its names, so that alike ones share compiled programs."""

from softcal_jax.fields._space import ParameterSpace
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
            for parameter in entry.parameters:
                names[parameter.name] = f"parameter {len(names) + 1}"

    def rename(name: str) -> str:
        return names.get(name, name)  # an order may name fields as well

    return ParameterSpace(
        tuple(entry.renamed(points, names) for entry in space.entries),
        order=[(rename(small), rename(large)) for small, large in space.order],
        axes=[[rename(name) for name in axis] for axis in space.axes],
        tensor_steps=space.tensor_steps,
        pin=space.pin,
    )
