"""Tables [material] of all laws, derived from the constants of their classes.

The laws are those of `softcal_jax.materials` and of installed packages with an entry
point in the group "softcal_jax.laws". A file beside the project is never imported.
"""

import dataclasses
import functools
import typing
from collections.abc import Callable, Iterable, Mapping
from importlib.metadata import EntryPoints, entry_points
from typing import Any, ClassVar, Literal, NamedTuple, Optional

import equinox as eqx
import numpy as np
from pydantic import Field, create_model

from softcal_jax._typing import Float, HostArray
from softcal_jax.materials import (
    ELASTICITIES,
    LAWS,
    AbstractElasticity,
    AbstractLaw,
    Fibre,
    Isotropic,
)
from softcal_jax.mesh import TetMesh
from softcal_jax.project._constants import DENSITY, Constant
from softcal_jax.project._directions import AnyDirections, TetData
from softcal_jax.project._problems import under
from softcal_jax.project._table import Density, Flag, Table, Undecided, undecided

GROUP = "softcal_jax.laws"
"""Group of the entry points by which installed packages offer laws."""


_FRAME = "directions"
"""Key of the formula for the directions of fibres."""

_DIRECTIONS: Any = Optional[AnyDirections]  # noqa: UP045 (`|` takes no Annotated)


class _OfLaw(Table):
    """Constants of a law, and its density; messages use `choice` and `listed`."""

    choice: ClassVar[str]
    constants: ClassVar[Mapping[str, Constant]]
    listed: ClassVar[str]

    @classmethod
    def foreign(cls, key: str) -> str | None:
        """Say which laws have a key that this one lacks; None if there are none."""
        owners = " or ".join(_owners(key))
        this = f"This is {cls.choice}, which has {cls.listed}."
        return f"{key} belongs to {owners}. {this}" if owners else None


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

    def values(self, key: str, mesh: TetMesh) -> Float[HostArray, "..."] | None:
        """Return a constant, as one value per tet where regions differ [SI].

        None for one that the law need not have and that the file leaves out.
        """
        regions = {name: getattr(own, key) for name, own in self.regions.items()}
        stated = {name: own for name, own in regions.items() if own is not None}
        if getattr(self, key) is None:
            for name in stated:
                raise ValueError(
                    f"regions.{name} has {key}, which the body lacks; give {key} in "
                    "[material] too."
                )
            return None
        base = np.asarray(getattr(self, key), float)
        for name, own in stated.items():
            base = np.broadcast_to(base, (mesh.n_tets,)).copy()
            base[mesh.tets_of(name)] = own
        return base

    def build(self, mesh: TetMesh, data: TetData) -> AbstractLaw:
        """Build the law; `data` returns arrays of the mesh file."""

        def value(key: str) -> Any:
            if key in self.constants:
                return self.values(key, mesh)
            return self._frames(mesh, data) if key == _FRAME else getattr(self, key)

        return type(self).makes(value)

    def _frames(
        self, mesh: TetMesh, data: TetData
    ) -> Float[HostArray, "n_tets 3 3"] | None:
        """Compute the local axes of the fibres; None where they are the mesh's."""
        base = getattr(self, _FRAME)
        owners = {n: own for n, own in self.regions.items() if getattr(own, _FRAME)}
        if base is None and not owners:
            return None
        frames = np.broadcast_to(np.eye(3), (mesh.n_tets, 3, 3)).copy()
        others = np.arange(mesh.n_tets)
        for name, own in owners.items():
            tets = np.asarray(mesh.tets_of(name))
            with under(f"regions.{name}.{_FRAME}"):
                frames[tets] = getattr(own, _FRAME).frames(mesh, tets, data)
            others = np.setdiff1d(others, tets)
        if base is not None and others.size:
            with under(_FRAME):
                frames[others] = base.frames(mesh, others, data)
        return frames


class _Undecided(Material, Undecided):
    density: Any = None


def material_table(raw: Any) -> type[Material]:
    """Build the schema of [material], read as `raw`, for the law that it names.

    For an unknown law it is one whose error lists the known names.
    """
    named = raw if isinstance(raw, dict) else {}
    # Anything else than a text is no name: the schema says so.
    law = str(named.get("law"))
    found = LAWS.get(law)
    if found is None:
        plug_ins = entry_points(group=GROUP)
        if law not in plug_ins.names:
            return _undecided("law", {**LAWS, **dict.fromkeys(sorted(plug_ins.names))})
        found = _plug_in(law, plug_ins.select(name=law))
    part = _part_of(found)
    aimed = _is_aimed(named)
    if part is None:
        return _table(law, found, "", aimed)
    choice = str(named.get(part.key, part.default))
    if choice not in part.known:
        return _undecided(part.key, part.known)
    return _table(law, found, choice, aimed)


def _is_aimed(named: dict[str, Any]) -> bool:
    """Return whether fibres have directions that need no angle, as a helix does."""
    regions = named.get("regions")
    tables = [named, *(regions.values() if isinstance(regions, dict) else ())]
    given = [own.get(_FRAME) for own in tables if isinstance(own, dict)]
    kinds = [own.get("type") for own in given if isinstance(own, dict)]
    return bool(kinds) and "helix" not in kinds


def _undecided(key: str, names: Iterable[str]) -> type[Material]:
    table: Any = undecided(key, tuple(names), _Undecided)
    table.constants = {"density": DENSITY}
    for kind in _choices().values():
        table.constants |= _constants(kind, None)
    return table


@functools.cache
def _table(
    name: str, law: type[AbstractLaw], choice: str, aimed: bool
) -> type[Material]:
    """Build the schema of a law, with the choice of its part, and of its regions.

    `aimed` fibres have a direction without an angle, which is 0 by default.
    """
    part = _part_of(law)
    words, chosen = f'law = "{name}"', None
    own: dict[str, Any] = {"law": (Literal[name], ...)}
    if part is not None:
        words += f' with {part.key} = "{choice}"'
        own[part.key] = (Literal[choice], choice)
        chosen = part.known[choice]
    constants, recipe = _constants(law, chosen), _recipe(law, chosen)
    for key, (field, hint) in recipe.keys.items():
        kind = constants[key].type if key in constants else hint
        default = ... if field.default is dataclasses.MISSING else field.default
        if key in constants and default is None:
            kind = kind | None
        if key == "theta" and aimed:
            default = 0.0
        description = field.metadata.get("words")
        own[key] = (kind, Field(default, description=description))
    listed = ", ".join(recipe.keys)
    constants["density"] = DENSITY
    others: dict[str, Any] = {k: (c.type | None, None) for k, c in constants.items()}
    if _FRAME in recipe.keys:
        others[_FRAME] = (_DIRECTIONS, None)
    region = create_model("Region", __base__=_OfLaw, **others)
    own["regions"] = (dict[str, region], Field(default_factory=dict))
    table = create_model("Material", __base__=Material, **own)
    for made in (region, table):
        made.choice, made.constants, made.listed = words, constants, listed
    table.makes = recipe.make
    return table


class _Part(NamedTuple):
    """A part of a law that a file chooses: its key, its default and what is known."""

    key: str
    default: str
    known: Mapping[str, type[eqx.Module]]


@functools.cache
def _part_of(law: type[eqx.Module]) -> _Part | None:
    hints = typing.get_type_hints(law).values()
    if AbstractElasticity in hints:
        return _Part("elasticity", "isotropic", ELASTICITIES)
    if AbstractLaw in hints:
        return _Part("matrix", "neo-hookean", _matrices())
    return None


@functools.cache
def _matrices() -> Mapping[str, type[AbstractLaw]]:
    """Return the laws that may be a matrix: with a potential and without fibres."""
    hints = {
        name: set(typing.get_type_hints(law).values()) for name, law in LAWS.items()
    }
    return {
        name: law
        for name, law in LAWS.items()
        if law.conservative and not {Fibre, AbstractLaw} & hints[name]
    }


class _Recipe(NamedTuple):
    """How to make an object from a function that returns the value of a key.

    `keys` have the field of the class, or of a part's class, and its type.
    """

    keys: dict[str, tuple[dataclasses.Field, Any]]
    make: Callable[[Callable[[str], Any]], Any]


@functools.cache
def _recipe(kind: type[eqx.Module], chosen: type[eqx.Module] | None) -> _Recipe:
    """Derive the recipe of a class from its fields.

    `chosen` is the class of its part that a file chooses; None leaves the keys of the
    part out. The elasticity of a matrix is isotropic.
    """
    keys, arguments = {}, {}
    hints = typing.get_type_hints(kind)
    for field in dataclasses.fields(kind):
        hint, key = hints[field.name], field.metadata.get("key", field.name)
        if hint in (AbstractElasticity, AbstractLaw):
            if chosen is None:
                continue
            hint = chosen
        if isinstance(hint, type) and issubclass(hint, eqx.Module):
            part = _recipe(hint, Isotropic)
            keys |= part.keys
            arguments[field.name] = part.make
        elif key == _FRAME:
            keys[key] = (field, _DIRECTIONS)
            arguments[field.name] = lambda value: value(_FRAME)
        elif "unit" in field.metadata or field.metadata.get("static"):
            keys[key] = (field, Flag if hint is bool else hint)
            arguments[field.name] = lambda value, key=key: value(key)
        else:
            raise ValueError(
                f"{kind.__name__}.{field.name} has no unit: declare it with "
                '`eqx.field(metadata=softcal_jax.materials.constant("Pa", ...))`.'
            )
    return _Recipe(keys, lambda v: kind(**{k: get(v) for k, get in arguments.items()}))


def _constants(
    kind: type[eqx.Module], chosen: type[eqx.Module] | None
) -> dict[str, Constant]:
    return {
        key: Constant(*(field.metadata[k] for k in Constant._fields))
        for key, (field, _) in _recipe(kind, chosen).keys.items()
        if "unit" in field.metadata
    }


def _choices() -> dict[str, type[eqx.Module]]:
    """Return elasticities and laws by their choice in a file."""
    kinds = {"elasticity": ELASTICITIES, "law": LAWS}
    return {
        f'{key} = "{name}"': kind
        for key, own in kinds.items()
        for name, kind in own.items()
    }


def _owners(key: str) -> list[str]:
    """List what has a key, as a file chooses it; empty for keys that all have."""
    parts = {name: _part_of(law) for name, law in LAWS.items()}
    owners = [
        f'law = "{name}"' for name, part in parts.items() if part and part.key == key
    ]
    return owners or [
        choice for choice, kind in _choices().items() if key in _recipe(kind, None).keys
    ]


def _plug_in(name: str, found: EntryPoints) -> type[AbstractLaw]:
    """Load the law of an installed package."""
    packages = [entry.dist.name if entry.dist else entry.value for entry in found]
    if len(packages) > 1:
        raise ValueError(
            f'the packages {" and ".join(packages)} both have a law "{name}"; '
            "uninstall one of them."
        )
    (entry,) = found
    try:
        law = entry.load()
        if not (isinstance(law, type) and issubclass(law, AbstractLaw)):
            raise TypeError(
                f"{law!r} is no subclass of softcal_jax.materials.AbstractLaw"
            )
        _recipe(law, Isotropic)
    except Exception as error:  # a foreign module may raise anything
        raise ValueError(
            f'the law "{name}" of the package {packages[0]} ({entry.value}) cannot be '
            f"loaded: {type(error).__name__}: {error}. Update or uninstall the package."
        ) from error
    return law
