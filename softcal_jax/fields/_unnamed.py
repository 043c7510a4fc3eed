"""Parameter spaces without names, so that similar ones share compiled programs."""

from softcal_jax.fields._space import ParameterSpace
from softcal_jax.fields._spread import ControlPointParameters


def unnamed(space: ParameterSpace) -> ParameterSpace:
    """Replace the names of parameters by numbers.

    Names are static in compiled programs, so spaces that only differ in names, like two
    layouts with equally many control points, would compile twice.

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
