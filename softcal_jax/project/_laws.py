"""The laws that a project file knows, their constants, and which belongs to which."""

from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Any, NamedTuple

from pydantic_core import PydanticCustomError

from softcal_jax._typing import Float, HostArray
from softcal_jax.materials import (
    AbstractElasticity,
    AbstractLaw,
    ClassicalCorotational,
    Corotational,
    Fibre,
    FibreReinforced,
    Isotropic,
    NeoHookean,
    ReducedTransverseIsotropic,
    StVenantKirchhoff,
    TransverseIsotropic,
)
from softcal_jax.project._quantities import (
    ANGLE,
    DENSITY,
    PRESSURE,
    Dimension,
    parse_scalar,
)

if TYPE_CHECKING:
    from softcal_jax.project._schema_material import MaterialTable

Value = Callable[[str], Float[HostArray, "..."]]


class Constant(NamedTuple):
    """A constant of a material.

    Attributes:
        dimension: What it measures; None for a plain number.
        unit: SI unit, as results name it.
        words: What it is, with an example.
    """

    dimension: Dimension | None
    unit: str
    words: str


CONSTANTS = {
    "E": Constant(PRESSURE, "Pa", 'Young\'s modulus: "200 kPa"'),
    "nu": Constant(None, "", "Poisson's ratio: 0.499"),
    "E_t": Constant(PRESSURE, "Pa", 'Young\'s modulus across the fibre: "700 kPa"'),
    "E_l": Constant(PRESSURE, "Pa", 'Young\'s modulus along the fibre: "400 kPa"'),
    "nu_t": Constant(None, "", "Poisson's ratio in the plane across the fibre: 0.3"),
    "nu_tl": Constant(
        None, "", "contraction along the fibre for stress across it: 0.3"
    ),
    "mu_l": Constant(PRESSURE, "Pa", 'shear modulus along the fibre: "200 kPa"'),
    "theta": Constant(ANGLE, "rad", 'angle of the fibre in its print plane: "20 deg"'),
    "phi": Constant(ANGLE, "rad", 'angle of the fibre out of its plane: "10 deg"'),
    "density": Constant(DENSITY, "kg/m3", 'mass density: "1070 kg/m^3"'),
}
"""All constants, by their key in the file, which is their field in the law."""


def parse_in_si(value: Any, unit: str) -> float:
    """A value as a project file writes it, in SI.

    Args:
        value: "200 kPa", or a plain number where there is no unit.
        unit: SI unit of the constant that it is a value of.

    Raises:
        ValueError: If it is no such value; the text says how to write one.
    """
    dimension = next(c.dimension for c in CONSTANTS.values() if c.unit == unit)
    if dimension is not None:
        try:
            return parse_scalar(value, dimension)
        except PydanticCustomError as error:
            raise ValueError(error.message()) from error
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ValueError(f"got {value!r}; expected a number, like 0.45.")
    return float(value)


ANGLES = ("theta", "phi")
RATIOS = ("nu", "nu_t", "nu_tl")

_FIBRE = ("theta", "phi", "print_plane")
_OF_LAW = {
    "neo-hookean": ("E", "nu"),
    "fibre-reinforced": ("E_t", "E_l", "nu", "mu_l", *_FIBRE),
}
_OF_ELASTICITY = {
    "isotropic": ("E", "nu"),
    "transverse-isotropic": ("E_t", "E_l", "nu_t", "nu_tl", "mu_l", *_FIBRE),
    "reduced-transverse-isotropic": ("E_t", "E_l", "nu", *_FIBRE),
}
_LINEAR = {
    "corotational": Corotational,
    "classical-corotational": ClassicalCorotational,
    "st-venant-kirchhoff": StVenantKirchhoff,
}
_OPTIONAL = ("phi", "print_plane")


def constants_of(law: str, elasticity: str | None) -> tuple[str, ...]:
    """Keys of a law besides the density; empty if there is no such law."""
    if law in _LINEAR:
        return _OF_ELASTICITY.get(elasticity or "isotropic", ())
    return _OF_LAW.get(law, ())


def law_problems(raw: dict[str, Any]) -> list[str]:
    """Constants that a file lacks, or that belong to another law.

    Args:
        raw: The file as it was read. What is wrong in itself is not judged here.
    """
    material = raw.get("material")
    if not isinstance(material, dict):
        return []
    law, elasticity = (material.get(key) for key in ("law", "elasticity"))
    if not isinstance(law, str) or not isinstance(elasticity, str | None):
        return []
    own = constants_of(law, elasticity)
    if not own:
        return []
    problems = []
    if elasticity is not None and law not in _LINEAR:
        owners = _listed(f'law = "{name}"' for name in _LINEAR)
        problems.append(
            f'material.elasticity: law = "{law}" has none; elasticity belongs to '
            f"{owners}."
        )
        elasticity = None
    problems += [
        f"material.{key}: missing. Expected {CONSTANTS[key].words}."
        for key in own
        if key not in material and key not in _OPTIONAL
    ]
    choice = _choice(law, elasticity)
    tables = {"material": material}
    regions = material.get("regions")
    if isinstance(regions, dict):
        tables |= {f"material.regions.{name}": r for name, r in regions.items()}
    for where, table in tables.items():
        problems += [
            f"{where}.{key}: {_foreign(key, own, choice)}"
            for key in (table if isinstance(table, dict) else ())
            if key not in own and _owners(key)
        ]
    return problems + _field_problems(raw.get("parameters"), own, choice)


def _field_problems(tables: Any, own: tuple[str, ...], choice: str) -> list[str]:
    """Parameters that set what the law does not have."""
    problems = []
    for table in tables if isinstance(tables, list) else ():
        field = table.get("field") if isinstance(table, dict) else None
        if isinstance(field, str) and field not in own and _owners(field):
            problems.append(
                f"parameters.{table.get('name', field)}.field: "
                f"{_foreign(field, own, choice)}"
            )
    return problems


def _choice(law: str, elasticity: str | None) -> str:
    if law not in _LINEAR:
        return f'law = "{law}"'
    return f'law = "{law}" with elasticity = "{elasticity or "isotropic"}"'


def _foreign(key: str, own: tuple[str, ...], choice: str) -> str:
    return (
        f"{key} belongs to {_listed(_owners(key))}. This is {choice}, which has "
        f"{', '.join(own)}."
    )


def _owners(key: str) -> list[str]:
    """What has a constant, as a user chooses it; nobody owns what all have."""
    owners = [
        f'elasticity = "{e}"' for e, keys in _OF_ELASTICITY.items() if key in keys
    ]
    return owners + [f'law = "{law}"' for law, keys in _OF_LAW.items() if key in keys]


def _listed(texts: Iterable[str]) -> str:
    *first, last = texts
    return f"{', '.join(first)} or {last}" if first else last


def build_law(table: "MaterialTable", value: Value) -> AbstractLaw:
    """The law of a material, from the value of each of its constants."""
    if table.law == "neo-hookean":
        return NeoHookean(value("E"), value("nu"))
    if table.law == "fibre-reinforced":
        return FibreReinforced(
            value("E_t"), value("E_l"), value("nu"), value("mu_l"), _fibre(table, value)
        )
    return _LINEAR[table.law](_elasticity(table, value))


def _elasticity(table: "MaterialTable", value: Value) -> AbstractElasticity:
    if table.elasticity == "transverse-isotropic":
        return TransverseIsotropic(
            value("E_t"),
            value("E_l"),
            value("nu_t"),
            value("nu_tl"),
            value("mu_l"),
            _fibre(table, value),
        )
    if table.elasticity == "reduced-transverse-isotropic":
        return ReducedTransverseIsotropic(
            value("E_t"), value("E_l"), value("nu"), _fibre(table, value)
        )
    return Isotropic(value("E"), value("nu"))


def _fibre(table: "MaterialTable", value: Value) -> Fibre:
    return Fibre(value("theta"), value("phi"), table.print_plane or "xz")
