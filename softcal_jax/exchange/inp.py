"""Calibrated models as input files of CalculiX and Abaqus, in one configuration."""

import os
import re
import textwrap
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from softcal_jax import materials
from softcal_jax._places import replacing
from softcal_jax._typing import Array, Float, HostArray, Int
from softcal_jax.actuators import actuator_geometry
from softcal_jax.configurations import ConfigurationArrays
from softcal_jax.equilibrium import Model
from softcal_jax.exchange._formats import check_no_bodies, check_rim
from softcal_jax.mesh import TetMesh, face_indices, tet_faces
from softcal_jax.results import LoadedResult, load_result

NO_TERM = 1e20
"""D_i of an absent term [1/Pa]: CalculiX replaces 0 by a number of its own."""

SMALLEST_D = 1e-10  # |D_1| below which CalculiX takes a number of its own

_GREEN = (
    "*ELASTIC with NLGEOM is linear in the Green strain in CalculiX (St. Venant-"
    "Kirchhoff), and in the logarithmic strain in Abaqus. "
)

_STRETCH = (
    " is linear in the stretch. Rotations may be large, but stresses differ by up to "
    "about 1.5 times the strain: by 15 % where the strain is 10 %."
)

_NEO_HOOKE = (
    "*HYPERELASTIC, NEO HOOKE splits off the change of volume, "
    "U = C10 (J^(-2/3) I1 - 3) + (J - 1)^2 / D1, where NeoHookean has "
    "mu/2 (I1 - 3) - mu ln J + lambda/2 (ln J)^2. They agree to second order in "
    "the strain, and nearly so at any strain where the volume hardly changes."
)

_VOLUME = (
    "The change of volume costs (J - 1)^2 / D1, D1 = 2 / K, in place of "
    "K/4 (J^2 - 1 - 2 ln J): the same to second order."
)


class InpLaw(NamedTuple):
    """A law in the terms of an input file.

    `keyword` opens it, like "*HYPERELASTIC, YEOH"; constants are in SI. The note says
    how it differs from the law of the model; `oriented` constants refer to the axes of
    the mesh.
    """

    keyword: str
    constants: Float[HostArray, "n_tets n_constants"]
    note: str
    oriented: bool


def write_inp(
    path: str | Path,
    model: Model,
    configuration: ConfigurationArrays,
    *,
    title: str = "softcal_jax",
) -> tuple[str, ...]:
    """Write a model in a configuration as an input file of CalculiX and Abaqus.

    In SI. Nodes and tets keep their order, counted from 1: C3D4 or C3D10, whose order
    of nodes is that of VTK. Tets of equal constants share a *MATERIAL. Node groups are
    sets of the name N_GROUP. One static step with NLGEOM has the supports, elastic ones
    as SPRING1, dead loads as *CLOAD, gravity as *DLOAD, GRAV, and pressures of chambers
    and surfaces as *DLOAD, P, which follow the surface too. Displacements are
    printed in the .dat file of CalculiX at the end.

    Args:
        path: The file, ending in .inp.
        model: The model.
        configuration: Arrays of one configuration, without a leading axis.
        title: First line of the file.

    Returns:
        How the programs differ from the model, in sentences; they are comments in the
        file, too.

    Raises:
        ValueError: If the name does not end in .inp, or the law, rigid bodies or
            actuators have no counterpart; the text gives the reason.
    """
    path = Path(path)
    if path.suffix != ".inp":
        raise ValueError(f"the file name must end in .inp, got {path.name!r}.")
    check_no_bodies(model, "a .inp file")
    # A text of users, which no program may take for a keyword.
    title = " ".join(title.encode("ascii", "replace").decode().split()).lstrip("*")[:80]
    law = inp_law(model)
    notes = [law.note]
    if model.formulation == "mean-dilatation":
        notes.append(
            "The tets of the model have one mean change of volume each, those of the "
            "file one at each of four points: C3D10 is stiffer where Poisson's ratio "
            "is nearly 0.5. In Abaqus, write C3D10H for C3D10; for CalculiX, calibrate "
            'with formulation = "displacement" in [material], the same element.'
        )
    wrapped = (line for note in notes for line in textwrap.wrap(note, 97))
    materials = [*_materials(model, law)]
    # Gravity acts on these: a set of all tets would overlap them, which many programs
    # that read meshes refuse.
    sets = [line.split("=")[1] for line in materials if line.startswith("*ELSET")]
    lines = [
        *("*HEADING", title, "** SI: m, kg, s, N, Pa"),
        *(f"** {line}" for line in wrapped),
        *_mesh(model.mesh),
        *materials,
        *_springs(model.mesh, configuration),
        *("*STEP, NLGEOM, INC=1000", "*STATIC", "0.1, 1."),
        *_held_and_loaded(model, configuration, sets),
        *_pressures(model, configuration),
        *("*NODE FILE", "U", "*EL FILE", "S, E"),
        *("*NODE PRINT, NSET=NALL, FREQUENCY=1000", "U", "*END STEP"),
    ]
    with replacing(path) as partial:
        partial.write_text("\n".join([*lines, ""]), encoding="ascii", newline="\n")
    return tuple(notes)


def export_inp(
    result: LoadedResult | str | os.PathLike[str],
    path: str | os.PathLike[str],
    *,
    configuration: str | None = None,
) -> tuple[str, ...]:
    """Write a calibrated model in a configuration for CalculiX or Abaqus.

    The file has the law with its calibrated values where it has a counterpart, the
    supports, loads and pressures of the configuration, and one static step; in SI. See
    `write_inp` for its content and what is returned.

    Args:
        result: The results folder, its `result.json`, or what `load_result` returned.
        path: The file, ending in .inp.
        configuration: Name of the configuration; may be left out where there is one.

    Raises:
        ResultError: If the result cannot be loaded, see `load_result`.
        ValueError: If there is no such configuration, the name does not end in .inp, or
            something has no counterpart; the text gives the reason.
    """
    loaded = result if isinstance(result, LoadedResult) else load_result(result)
    posed, arrays = loaded.posed(configuration)
    title = f"{loaded.project.name}: {posed.name}"
    return write_inp(Path(path), loaded.model, arrays, title=title)


def _number(value: float) -> str:
    """Write a number in 20 characters at most, which is all that the programs read."""
    return f"{value:.12g}"


def _rows(values: Iterable[str], per_line: int = 8) -> Iterator[str]:
    """Write data in lines that go on with a comma; Abaqus wants eight a line."""
    values = list(values)
    for i in range(0, len(values), per_line):
        more = "," if i + per_line < len(values) else ""
        yield ", ".join(values[i : i + per_line]) + more


def _mesh(mesh: TetMesh) -> Iterator[str]:
    yield "*NODE, NSET=NALL"
    for i, x in enumerate(mesh.points, start=1):
        yield ", ".join((str(i), *map(_number, x)))
    kind = "C3D4" if mesh.order == 1 else "C3D10"
    yield f"*ELEMENT, TYPE={kind}"
    for i, nodes in enumerate(mesh.tets + 1, start=1):
        yield ", ".join(map(str, (i, *nodes)))
    taken: set[str] = set()
    for group, nodes in mesh.node_groups.items():
        stem = f"N_{re.sub(r'[^A-Z0-9_]+', '_', group.upper())[:70]}"
        name, copy = stem, 2
        while name in taken:
            name, copy = f"{stem}_{copy}", copy + 1
        taken.add(name)
        yield f"*NSET, NSET={name}"
        yield from _rows(map(str, np.asarray(nodes) + 1), per_line=16)


def _materials(model: Model, law: InpLaw) -> Iterator[str]:
    """Write materials, and the sets of tets that have them."""
    density = np.broadcast_to(np.asarray(model.density, float), model.n_tets)
    table = np.column_stack([law.constants, density])
    distinct, of_tet = np.unique(table, axis=0, return_inverse=True)
    order = np.argsort(of_tet.ravel(), kind="stable")
    ends = np.cumsum(np.bincount(of_tet.ravel()))
    if law.oriented:
        yield from ("*ORIENTATION, NAME=AXES, SYSTEM=RECTANGULAR", "1, 0, 0, 0, 1, 0")
    axes = ", ORIENTATION=AXES" * law.oriented
    for k, (*constants, rho) in enumerate(distinct):
        tets = order[ends[k - 1] if k else 0 : ends[k]]
        yield f"*ELSET, ELSET=E{k + 1}"
        yield from _rows(map(str, tets + 1), per_line=16)
        yield from (f"*MATERIAL, NAME=M{k + 1}", law.keyword)
        yield from _rows(map(_number, constants))
        if rho > 0.0:
            yield from ("*DENSITY", _number(rho))
        yield f"*SOLID SECTION, ELSET=E{k + 1}, MATERIAL=M{k + 1}{axes}"


def _springs(mesh: TetMesh, c: ConfigurationArrays) -> Iterator[str]:
    """Write elastic supports: springs of nodes to the ground, and between nodes."""
    to_ground = np.asarray(c.springs.coefficients())[: mesh.n_nodes]
    rest = np.asarray(c.springs.rest)[: mesh.n_nodes]
    if np.any(rest[to_ground != 0.0]):
        raise ValueError(
            "an elastic support is moved by an imposed displacement, which springs of "
            "the file cannot be: make the support rigid, or its displacement zero."
        )
    first = mesh.n_tets
    between = _between_nodes(mesh, c)
    for axis in range(3):
        single = np.arange(mesh.n_nodes)[:, None]
        for ends, stiffness in ((single, to_ground), between):
            values, of_spring = np.unique(stiffness[:, axis], return_inverse=True)
            for k in np.flatnonzero(values):
                springs = ends[of_spring.ravel() == k] + 1
                name, n_ends = f"S{first + 1}", springs.shape[1]
                yield f"*ELEMENT, TYPE=SPRING{n_ends}, ELSET={name}"
                for number, nodes in enumerate(springs.tolist(), start=first + 1):
                    yield ", ".join(map(str, [number, *nodes]))
                yield f"*SPRING, ELSET={name}"
                yield ", ".join(n_ends * [str(axis + 1)])
                yield _number(values[k])
                first += len(springs)


def _between_nodes(
    mesh: TetMesh, c: ConfigurationArrays
) -> tuple[Int[HostArray, "n 2"], Float[HostArray, "n 3"]]:
    """List the pairs of nodes that springs join, and their stiffness [N/m]."""
    nodes = mesh.tets[np.asarray(c.springs.tets)]
    a, b = np.triu_indices(mesh.tets.shape[1], 1)
    # What resists a relative motion is minus what acts along with the other node.
    stiffness = -np.asarray(c.springs.between_nodes())[:, a, b].reshape(-1, 3)
    ends = np.sort(np.stack([nodes[:, a], nodes[:, b]], axis=-1).reshape(-1, 2))
    pairs, which = np.unique(ends, axis=0, return_inverse=True)
    total = np.zeros((len(pairs), 3))
    np.add.at(total, which.ravel(), stiffness)
    # Ten digits, so that equal faces share sets; the rest is rounding, zeros too.
    size = np.max(np.abs(total), initial=0.0)
    scale = 10.0 ** np.floor(10.0 - np.log10(size)) if size > 0.0 else 1.0
    return pairs, np.round(total * scale) / scale


def _held_and_loaded(
    model: Model, c: ConfigurationArrays, sets: Sequence[str]
) -> Iterator[str]:
    """Write rigid supports, dead loads, and gravity on sets of tets."""
    n_nodes = model.mesh.n_nodes
    fixed, force = np.asarray(c.fixed)[:n_nodes], np.asarray(c.dead_loads)[:n_nodes]
    imposed = np.asarray(c.imposed)
    if fixed.any():
        yield "*BOUNDARY"
    for node, axis in np.argwhere(fixed):
        value = _number(float(imposed[node, axis]))
        yield f"{node + 1}, {axis + 1}, {axis + 1}, {value}"
    if force.any():
        yield "*CLOAD"
    for node, axis in np.argwhere(force):
        yield f"{node + 1}, {axis + 1}, {_number(float(force[node, axis]))}"
    g = np.asarray(c.acceleration)
    size = float(np.linalg.norm(g))
    if size > 0.0 and np.any(np.asarray(model.density) > 0.0):
        along = ", ".join(map(_number, g / size))
        yield "*DLOAD"
        yield from (f"{name}, GRAV, {_number(size)}, {along}" for name in sets)


def _pressures(model: Model, c: ConfigurationArrays) -> Iterator[str]:
    """Write the pressures of chambers and surfaces; no other actuator may act."""
    actuators = model.mechanism.actuators
    forces = np.asarray(c.actuation.forces)
    acting = forces != 0.0
    by_displacement = np.asarray(c.actuation.by_displacement)
    every = zip(actuators.names, actuators.kinds, strict=True)
    for a, (name, kind) in enumerate(every):
        if by_displacement[a]:
            raise ValueError(
                f"{kind.noun} {name!r}: its displacement is imposed, and a file can "
                "impose forces and pressures only. Impose the force that the "
                "equilibrium has (robot.csv)."
            )
        if acting[a] and kind.force_unit != "Pa":
            raise ValueError(
                f"{kind.noun} {name!r} acts, and CalculiX has no counterpart of it: "
                "only chambers and surface pressures are written."
            )
    if not acting.any():
        return
    walls = actuator_geometry(actuators, np.asarray(model.mechanism.points))
    for a in np.flatnonzero(acting):
        check_rim(model, c, int(a), "a .inp file")
    places = face_indices(walls.faces, tet_faces(model.mesh.tets))
    yield "*DLOAD"
    for place, owner in zip(places.tolist(), walls.face_owner, strict=True):
        if acting[owner]:
            tet, side = divmod(place, 4)
            yield f"{tet + 1}, P{side + 1}, {_number(float(forces[owner]))}"


def inp_law(model: Model) -> InpLaw:
    """Convert the law of a model; a ValueError says why neither program has it."""
    law, note, oriented = model.law, _VOLUME, False
    match law:
        case (
            materials.Corotational()
            | materials.ClassicalCorotational()
            | materials.StVenantKirchhoff()
        ):
            same = isinstance(law, materials.StVenantKirchhoff)
            differs = type(law).__name__ + _STRETCH
            note = _GREEN + ("The former is the law of the model." if same else differs)
            oriented = not isinstance(law.elasticity, materials.Isotropic)
            if isinstance(law.elasticity, materials.Isotropic):
                keyword, constants = "*ELASTIC", (law.elasticity.E, law.elasticity.nu)
            else:
                keyword = "*ELASTIC, TYPE=ANISO"
                constants = _anisotropic(law.elasticity)
        case materials.NeoHookean():
            mu = law.E / (2.0 * (1.0 + law.nu))
            bulk = law.E / (3.0 * (1.0 - 2.0 * law.nu))
            keyword, note = "*HYPERELASTIC, NEO HOOKE", _NEO_HOOKE
            constants = 0.5 * mu, _D(bulk)
        case materials.MooneyRivlin():
            keyword = "*HYPERELASTIC, MOONEY-RIVLIN"
            constants = law.c10, law.c01, _D(law.bulk_modulus())
        case materials.Yeoh():
            keyword = "*HYPERELASTIC, YEOH"
            volume = _D(law.bulk_modulus()), NO_TERM, NO_TERM
            constants = law.c10, law.c20, law.c30, *volume
        case materials.Ogden():  # W has 2 mu / alpha^2 there, and mu / alpha here
            terms = law.terms()
            keyword = f"*HYPERELASTIC, OGDEN, N={len(terms)}"
            distortion = [c for mu, alpha in terms for c in (0.5 * mu * alpha, alpha)]
            volume = _D(law.bulk_modulus()), *[NO_TERM] * (len(terms) - 1)
            constants = *distortion, *volume
        case _:
            raise ValueError(
                f"{type(law).__name__} has no counterpart in Abaqus or CalculiX"
                f"{_without(law)}."
            )
    columns = [np.broadcast_to(np.asarray(c, float), model.n_tets) for c in constants]
    return InpLaw(keyword, np.stack(columns, axis=1), note, oriented)


def _without(law: materials.AbstractLaw) -> str:
    """Say why there is no counterpart, and what to do."""
    if isinstance(law, materials.Gent):
        return (
            ", which have no law that locks in this way; calibrate Yeoh, which "
            "stiffens too, and export that"
        )
    if isinstance(law, materials.FibreReinforced | materials.TransverseHyperelastic):
        return (
            ": their laws with fibres (Holzapfel) are exponential, and CalculiX has "
            "them as user materials alone. For small strains calibrate Corotational "
            "of TransverseIsotropic, and export that"
        )
    return ": it would need a user subroutine (UMAT) there"


def _anisotropic(elasticity: materials.AbstractElasticity) -> list[HostArray]:
    """Return the 21 constants in the order of *ELASTIC, TYPE=ANISO.

    That is the upper triangle by columns, in the order 11, 22, 33, 12, 13, 23.
    """
    order = [0, 1, 2, 5, 4, 3]  # in Voigt's order, that of the entries
    by_rows = [(a, b) for a in range(6) for b in range(a, 6)]
    table = materials.TabulatedElasticity.of(elasticity)
    entries = dict(zip(by_rows, table.entries, strict=True))
    pairs = (sorted((order[i], order[j])) for j in range(6) for i in range(j + 1))
    return [np.asarray(entries[a, b]) for a, b in pairs]


def _D(bulk: Float[Array, "..."]) -> HostArray:
    """Compute D_1 = 2 / K [1/Pa], if CalculiX takes it as it is."""
    D = np.asarray(2.0 / bulk)
    if np.any(D < SMALLEST_D):
        raise ValueError(
            f"D1 = 2 / K would be {D.min():.3g} 1/Pa, and below {SMALLEST_D:g} "
            "CalculiX takes a number of its own: lower Poisson's ratio; 0.499 is "
            "enough for an incompressible rubber."
        )
    return D
