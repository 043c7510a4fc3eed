"""Tables [material] of all laws, derived from the constants of their classes.

The laws are those of `softcal_jax.materials` and of installed packages with an entry
point in the group "softcal_jax.laws". A file beside the project is never imported.
"""

import dataclasses
import functools
import typing
from collections.abc import Callable, Mapping
from importlib.metadata import EntryPoints, entry_points
from typing import Any, ClassVar, Literal, NamedTuple

import equinox as eqx
import numpy as np
from pydantic import Field, create_model

from softcal_jax._typing import Float, HostArray
from softcal_jax.materials import (
    DENSITY,
    ELASTICITIES,
    LAWS,
    AbstractElasticity,
    AbstractLaw,
    Fibre,
    Isotropic,
)
from softcal_jax.mesh import TetMesh
from softcal_jax.project import _quantities as typed
from softcal_jax.project._robot import AnyDirections, Frames, TetData
from softcal_jax.project._table import (
    Table,
    as_table,
    entry_of,
    fields_of,
    type_of,
    under,
    wrong_choice,
    wrong_key,
)

GROUP = "softcal_jax.laws"
"""Group of the entry points by which installed packages offer laws."""

_FRAME = "directions"  # key of the formula for the directions of fibres


def _owners(key: str) -> str:
    """Say which laws have a key that another lacks; empty if there are none."""
    has = lambda kind: key in _recipe(kind, None)[0]
    chooses = lambda law: (part := _part_of(law)) is not None and part.key == key
    owners = [
        *(f'elasticity = "{k}"' for k, kind in ELASTICITIES.items() if has(kind)),
        *(f'law = "{k}"' for k, law in LAWS.items() if has(law) or chooses(law)),
    ]
    return f" {key} belongs to {' or '.join(owners)}." if owners else ""


class Material(Table):
    """The law and its constants before calibration; `material_table` adds their keys.

    `makes` makes the law from a function that returns the value of a key; `constants`
    has the metadata of each, see `softcal_jax.materials.constant`.
    """

    foreign: ClassVar = staticmethod(_owners)
    makes: ClassVar[Callable[[Callable[[str], Any]], AbstractLaw]]
    constants: ClassVar[Mapping[str, Mapping[str, Any]]]

    law: str
    density: typed.Density = Field(description=DENSITY["words"])
    formulation: Literal["auto", "displacement", "mean-dilatation"] = "auto"
    contact_scale: typed.PositiveLength | None = None
    touching: list[tuple[str, str]] = Field(default_factory=list)
    touching_reach: typed.PositiveLength | None = None
    regions: dict[str, Any] = Field(default_factory=dict)

    def constant(self, key: str, region: str | None = None) -> float:
        """Return a constant of the body, or of a region that may have its own [SI]."""
        regional = getattr(self.regions.get(region or ""), key, None)
        return getattr(self, key) if regional is None else regional

    def values(self, key: str, mesh: TetMesh) -> Float[HostArray, "..."] | None:
        """Return a constant, as one value per tet where regions differ [SI].

        None for an optional constant that the file leaves out.
        """
        regions = {name: getattr(region, key) for name, region in self.regions.items()}
        stated = {name: value for name, value in regions.items() if value is not None}
        if getattr(self, key) is None:
            for name in stated:
                raise ValueError(f"regions.{name} has {key}: give [material] one too.")
            return None
        base = np.asarray(getattr(self, key), float)
        for name, value in stated.items():
            base = np.broadcast_to(base, (mesh.n_tets,)).copy()
            base[mesh.tets_of(name)] = value
        return base

    def build(self, mesh: TetMesh, data: TetData) -> AbstractLaw:
        """Build the law; `data` returns arrays of the mesh file."""

        def value(key: str) -> Any:
            if key in self.constants:
                return self.values(key, mesh)
            return self._frames(mesh, data) if key == _FRAME else getattr(self, key)

        return type(self).makes(value)

    def _frames(self, mesh: TetMesh, data: TetData) -> Frames | None:
        """Compute the local axes of the fibres; None for the axes of the mesh."""
        base = getattr(self, _FRAME)
        owners = {n: r for n, r in self.regions.items() if getattr(r, _FRAME)}
        if base is None and not owners:
            return None
        frames = np.broadcast_to(np.eye(3), (mesh.n_tets, 3, 3)).copy()
        others = np.arange(mesh.n_tets)
        for name, region in owners.items():
            tets = np.asarray(mesh.tets_of(name))
            with under(f"regions.{name}.{_FRAME}"):
                frames[tets] = getattr(region, _FRAME).build(mesh, tets, data)
            others = np.setdiff1d(others, tets)
        if base is not None and others.size:
            with under(_FRAME):
                frames[others] = base.build(mesh, others, data)
        return frames


def material_table(raw: Any) -> type[Material]:
    """Build the schema of [material], read as `raw`, for the law that it names.

    A ValueError lists the laws that there are, if there is no such law.
    """
    named = as_table(raw)
    name = str(named.get("law"))
    law = LAWS.get(name)
    if law is None:
        plug_ins = entry_points(group=GROUP)
        if name not in plug_ins.names:
            known = dict.fromkeys([*LAWS, *sorted(plug_ins.names)])
            raise wrong_choice("law", named, known)
        law = _plug_in(name, plug_ins.select(name=name))
    part = _part_of(law)
    choice = "" if part is None else str(named.get(part.key, part.default))
    if part is not None and choice not in part.known:
        raise wrong_choice(part.key, named, part.known)
    # Whether fibres have directions, and no helix, which needs `theta`.
    regions = named.get("regions")
    tables = [named, *(regions.values() if isinstance(regions, dict) else ())]
    given = [table.get(_FRAME) for table in tables if isinstance(table, dict)]
    kinds = [frame.get("type") for frame in given if isinstance(frame, dict)]
    return _table(law, choice, bool(kinds) and "helix" not in kinds)


@functools.cache
def _table(law: type[AbstractLaw], choice: str, aimed: bool) -> type[Material]:
    """Build the schema of a law, with the choice of its part, and of its regions.

    Where fibres are `aimed`, they have directions without `theta`, which defaults to 0.
    """
    part = _part_of(law)
    of_law, make = _recipe(law, None if part is None else part.known[choice])
    keys: dict[str, Any] = {}
    if part is not None:  # `material_table` has refused any other choice
        keys[part.key] = (Literal[tuple(part.known)], choice)
    constants: dict[str, Mapping[str, Any]] = {}
    for key, (field, kind) in of_law.items():
        if "unit" in field.metadata:
            constants[key] = field.metadata
        entry = entry_of(field, kind)
        needless = aimed and field in dataclasses.fields(Fibre) and entry.is_required()
        keys[key] = kind, 0.0 if needless else entry
    others: dict[str, Any] = {k: (keys[k][0], None) for k in constants}
    others["density"] = (typed.Density, None)
    constants["density"] = DENSITY
    if _FRAME in of_law:
        others[_FRAME] = (AnyDirections, None)
    region = create_model("Region", __base__=Table, **others)
    region.foreign = _owners
    keys["regions"] = (dict[str, region], Field(default_factory=dict))
    table = create_model("Material", __base__=Material, **keys)
    table.makes, table.constants = make, constants
    return table


class _Part(NamedTuple):
    """A part of a law that a file chooses: its key, default and known classes."""

    key: str
    default: str
    known: Mapping[str, type[eqx.Module]]


@functools.cache
def _part_of(law: type[eqx.Module]) -> _Part | None:
    hints = typing.get_type_hints(law).values()
    if AbstractElasticity in hints:
        return _Part("elasticity", "isotropic", ELASTICITIES)
    if AbstractLaw not in hints:
        return None
    # A matrix has a potential and no fibres.
    fibrous = lambda law: {Fibre, AbstractLaw} & {*typing.get_type_hints(law).values()}
    plain = {k: v for k, v in LAWS.items() if v.conservative and not fibrous(v)}
    return _Part("matrix", "neo-hookean", plain)


Keys = dict[str, tuple[dataclasses.Field, Any]]
"""Keys of a law, each with its field, of the class or of a part's class, and type."""


@functools.cache
def _recipe(
    kind: type[eqx.Module], chosen: type[eqx.Module] | None
) -> tuple[Keys, Callable[[Callable[[str], Any]], Any]]:
    """Derive the keys of a class from its fields, and what makes it.

    That is a function of the one that returns the value of a key. `chosen` is the class
    of its part that a file chooses; None leaves the keys of the part out. The
    elasticity of a matrix is isotropic.
    """
    keys: Keys = {}
    # Each argument comes from a key, or from what makes a part.
    arguments: dict[str, str | Callable[..., Any]] = {}
    for field, hint in fields_of(kind):
        key = field.metadata.get("key", field.name)
        if hint in (AbstractElasticity, AbstractLaw):
            if chosen is None:
                continue
            hint = chosen
        if isinstance(hint, type) and issubclass(hint, eqx.Module):
            more, arguments[field.name] = _recipe(hint, Isotropic)
        elif key == _FRAME or {"unit", "static"} & {*field.metadata}:
            read = AnyDirections if key == _FRAME else type_of(hint, field.metadata)
            more, arguments[field.name] = {key: (field, read)}, key
        else:
            raise ValueError(
                f"{kind.__name__}.{field.name} has no unit: declare it with "
                '`eqx.field(metadata=softcal_jax.materials.constant("Pa", ...))`.'
            )
        for key in more.keys() & (keys.keys() | Material.model_fields.keys()):
            raise ValueError(
                f"{kind.__name__}.{field.name}: [material] has another {key}, and a "
                "file could not tell the two apart. Give the field another name."
            )
        keys |= more

    def make(value: Callable[[str], Any]) -> Any:
        given = arguments.items()
        return kind(
            **{n: value(k) if isinstance(k, str) else k(value) for n, k in given}
        )

    return keys, make


def _plug_in(name: str, plug_ins: EntryPoints) -> type[AbstractLaw]:
    packages = [entry.dist.name if entry.dist else entry.value for entry in plug_ins]
    if len(packages) > 1:
        raise wrong_key(
            "law",
            f'two packages have a law "{name}": uninstall {" or ".join(packages)}.',
        )
    (entry,) = plug_ins
    try:
        law = entry.load()
        if not (isinstance(law, type) and issubclass(law, AbstractLaw)):
            raise TypeError(f"{law!r} is no softcal_jax.materials.AbstractLaw")
        _recipe(law, Isotropic)
    except Exception as error:  # a foreign module may raise anything
        raise wrong_key(
            "law",
            f'the law "{name}" of the package {packages[0]} ({entry.value}) cannot be '
            f"loaded: {type(error).__name__}: {error}. Update or uninstall it.",
        ) from error
    return law
