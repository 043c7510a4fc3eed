"""Tables [material] of all laws, derived from the constants of their classes.

The laws are those of `softcal_jax.materials` and of installed packages with an entry
point in the group "softcal_jax.laws". A file beside the project is never imported.
"""

import dataclasses
import functools
import typing
from collections.abc import Callable, Iterable, Mapping
from importlib.metadata import EntryPoints, entry_points
from typing import Annotated, Any, ClassVar, Literal, NamedTuple

import equinox as eqx
import numpy as np
from pydantic import BeforeValidator, ConfigDict, Field, create_model

from softcal_jax._typing import Float, HostArray
from softcal_jax.materials import (
    ELASTICITIES,
    LAWS,
    AbstractElasticity,
    AbstractLaw,
    constant,
)
from softcal_jax.mesh import TetMesh
from softcal_jax.project._problems import one_of
from softcal_jax.project._quantities import dimension_of, scalar
from softcal_jax.project._table import Density, Number, Table

GROUP = "softcal_jax.laws"
"""Group of the entry points by which installed packages offer laws."""


class Constant(NamedTuple):
    """A constant of a material, as its law declares it.

    Attributes:
        unit: SI unit, as results name it.
        words: What it is, with an example.
        within: Open interval in which the bounds of a parameter must lie.
    """

    unit: str
    words: str
    within: tuple[float, float]

    @property
    def is_angle(self) -> bool:
        """Whether it is the angle of an axis."""
        return self.unit == "rad"

    @property
    def scale(self) -> Literal["log", "linear"]:
        """Default scale: moduli are positive, so that their steps are ratios."""
        return "linear" if self.unit in ("", "rad") else "log"

    @property
    def type(self) -> Any:
        """Pydantic type of its key in a table."""
        if not self.unit:
            return Number
        return Annotated[float, BeforeValidator(scalar(dimension_of(self.unit)))]


DENSITY = Constant(**constant("kg/m3", 'mass density: "1070 kg/m^3"'))


class _OfLaw(Table):
    """A table of the constants of a law, including the density.

    Messages say how a file makes the `choice` of the law, and its keys `listed`.
    """

    choice: ClassVar[str]
    constants: ClassVar[Mapping[str, Constant]]
    listed: ClassVar[str]

    @classmethod
    def foreign(cls, key: str) -> str | None:
        """Say which laws have a key that this one lacks; None if there are none."""
        owners = _owners(key)
        if not owners:
            return None
        *first, last = owners
        named = f"{', '.join(first)} or {last}" if first else last
        return (
            f"{key} belongs to {named}. This is {cls.choice}, which has {cls.listed}."
        )


class Material(_OfLaw):
    """The law and its constants before calibration; `material_table` adds their keys.

    `makes` makes the law from a function that returns the value of a key.
    """

    makes: ClassVar[Callable[[Callable[[str], Any]], AbstractLaw]]

    law: str
    density: Density = Field(description=DENSITY.words)
    formulation: Literal["auto", "displacement", "mean-dilatation"] = "auto"
    regions: dict[str, Any] = Field(default_factory=dict)

    def constant(self, key: str, region: str | None = None) -> float:
        """Return a constant of the body, or of a region that may have its own [SI]."""
        own = getattr(self.regions.get(region or ""), key, None)
        return getattr(self, key) if own is None else own

    def values(self, key: str, mesh: TetMesh) -> Float[HostArray, "..."]:
        """Return a constant, as one value per tet where regions differ [SI]."""
        base = np.asarray(getattr(self, key), float)
        for name, region in self.regions.items():
            tets = mesh.tets_of(name)
            if getattr(region, key) is not None:
                base = np.broadcast_to(base, (mesh.n_tets,)).copy()
                base[tets] = getattr(region, key)
        return base

    def build(self, mesh: TetMesh) -> AbstractLaw:
        """Build the law."""
        own = self.constants
        return type(self).makes(
            lambda key: self.values(key, mesh) if key in own else getattr(self, key)
        )


class _Undecided(Material):
    """A table whose law is unknown, so that none of its other keys is checked."""

    model_config = ConfigDict(extra="ignore")

    density: Any = None


def material_table(raw: Any) -> type[Material]:
    """Build the schema of [material], read as `raw`, for the law that it names.

    For an unknown law it is one whose error lists the known names.
    """
    named = raw if isinstance(raw, dict) else {}
    # Anything else than a text is no name: the schema says so.
    law, elasticity = str(named.get("law")), str(named.get("elasticity", "isotropic"))
    found = LAWS.get(law)
    if found is None:
        plug_ins = entry_points(group=GROUP)
        if law not in plug_ins.names:
            return _undecided("law", {**LAWS, **dict.fromkeys(sorted(plug_ins.names))})
        found = _plug_in(law, plug_ins.select(name=law))
    if not _takes_elasticity(found):
        return _table(law, found, "")
    if elasticity not in ELASTICITIES:
        return _undecided("elasticity", ELASTICITIES)
    return _table(law, found, elasticity)


def _undecided(key: str, names: Iterable[str]) -> type[Material]:
    choice: Any = (Literal[*names], Field(description=one_of("", names).rstrip(".")))
    table = create_model("Material", __base__=_Undecided, **{key: choice})
    table.constants = {"density": DENSITY}
    for kind in _without_parts().values():
        table.constants |= _constants(kind, "")
    return table


@functools.cache
def _table(name: str, law: type[AbstractLaw], elasticity: str) -> type[Material]:
    """Build the schema of a law and of its regions."""
    constants, choice = _constants(law, elasticity), f'law = "{name}"'
    own: dict[str, Any] = {"law": (Literal[name], ...)}
    if elasticity:
        choice += f' with elasticity = "{elasticity}"'
        own["elasticity"] = (Literal[elasticity], elasticity)
    recipe = _recipe(law, elasticity)
    for key, (field, hint) in recipe.keys.items():
        kind = constants[key].type if key in constants else hint
        default = ... if field.default is dataclasses.MISSING else field.default
        words = field.metadata.get("words")
        own[key] = (kind, Field(default, description=words))
    listed = ", ".join(recipe.keys)
    constants["density"] = DENSITY
    others: dict[str, Any] = {k: (c.type | None, None) for k, c in constants.items()}
    region = create_model("Region", __base__=_OfLaw, **others)
    own["regions"] = (dict[str, region], Field(default_factory=dict))
    table = create_model("Material", __base__=Material, **own)
    for made in (region, table):
        made.choice, made.constants, made.listed = choice, constants, listed
    table.makes = recipe.make
    return table


class _Recipe(NamedTuple):
    """How to make an object from a function that returns the value of a key.

    `keys` have the field of the class, or of a part's class, and its type.
    """

    keys: dict[str, tuple[dataclasses.Field, Any]]
    make: Callable[[Callable[[str], Any]], Any]


@functools.cache
def _recipe(kind: type[eqx.Module], elasticity: str) -> _Recipe:
    """Derive the recipe of a class from its fields."""
    keys, arguments = {}, {}
    hints = typing.get_type_hints(kind)
    for field in dataclasses.fields(kind):
        hint, key = hints[field.name], field.metadata.get("key", field.name)
        if hint is AbstractElasticity:
            hint = ELASTICITIES[elasticity]
        if isinstance(hint, type) and issubclass(hint, eqx.Module):
            part = _recipe(hint, elasticity)
            keys |= part.keys
            arguments[field.name] = part.make
        elif "unit" in field.metadata or field.metadata.get("static"):
            keys[key] = (field, hint)
            arguments[field.name] = lambda value, key=key: value(key)
        else:
            raise ValueError(
                f"{kind.__name__}.{field.name} has no unit: declare it with "
                '`eqx.field(metadata=softcal_jax.materials.constant("Pa", ...))`.'
            )
    return _Recipe(keys, lambda v: kind(**{k: get(v) for k, get in arguments.items()}))


def _constants(kind: type[eqx.Module], elasticity: str) -> dict[str, Constant]:
    return {
        key: Constant(*(field.metadata[k] for k in Constant._fields))
        for key, (field, _) in _recipe(kind, elasticity).keys.items()
        if "unit" in field.metadata
    }


def _takes_elasticity(law: type[AbstractLaw]) -> bool:
    return AbstractElasticity in typing.get_type_hints(law).values()


def _without_parts() -> dict[str, type[eqx.Module]]:
    """Return elasticities and laws with constants of their own, by their choice."""
    plain = {name: law for name, law in LAWS.items() if not _takes_elasticity(law)}
    kinds = {"elasticity": ELASTICITIES, "law": plain}
    return {
        f'{key} = "{name}"': kind
        for key, own in kinds.items()
        for name, kind in own.items()
    }


def _owners(key: str) -> list[str]:
    """List what has a key, as a file chooses it; empty for keys that all have."""
    if key == "elasticity":
        linear = [name for name, law in LAWS.items() if _takes_elasticity(law)]
        return [f'law = "{name}"' for name in linear]
    kinds = _without_parts().items()
    return [choice for choice, kind in kinds if key in _recipe(kind, "").keys]


def _plug_in(name: str, found: EntryPoints) -> type[AbstractLaw]:
    """Load the law of an installed package."""
    packages = [entry.dist.name if entry.dist else entry.value for entry in found]
    if len(packages) > 1:
        raise ValueError(
            f'the packages {" and ".join(packages)} both have a law "{name}"; '
            "uninstall one of them."
        )
    (entry,) = found
    what = f'the law "{name}" of the package {packages[0]} ({entry.value})'
    try:
        law = entry.load()
    except Exception as error:  # a foreign module may raise anything
        raise ValueError(
            f"{what} cannot be loaded: {type(error).__name__}: {error}. Update or "
            "uninstall the package."
        ) from error
    if not (isinstance(law, type) and issubclass(law, AbstractLaw)):
        raise ValueError(
            f"{what} is {law!r}, expected a subclass of "
            "softcal_jax.materials.AbstractLaw."
        )
    try:
        _recipe(law, "isotropic")
    except (ValueError, NameError) as error:
        raise ValueError(f"{what} cannot be used: {error}") from error
    return law
