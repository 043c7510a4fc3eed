"""Bodies in CalculiX and in the package: how far apart are their displacements?"""

import shutil
import subprocess
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from benchmarks._hollow import hollow_cube
from benchmarks._problem import Figure
from softcal_jax.actuators import Chamber
from softcal_jax.configurations import (
    Configuration,
    ConfigurationArrays,
    EdgeForce,
    ImposedForce,
    Support,
    configuration_arrays,
)
from softcal_jax.equilibrium import Model, build_model, solve_equilibrium
from softcal_jax.exchange.inp import write_inp
from softcal_jax.materials import (
    AbstractLaw,
    Corotational,
    Fibre,
    Isotropic,
    MooneyRivlin,
    NeoHookean,
    Ogden,
    StVenantKirchhoff,
    TransverseIsotropic,
    Yeoh,
)
from softcal_jax.mesh import TetMesh, beam

SIZE = (0.1, 0.02, 0.02)


class Body(NamedTuple):
    """A model, and one configuration of it."""

    model: Model
    lane: ConfigurationArrays


class Difference(NamedTuple):
    """How far two programs are apart.

    Attributes:
        apart: Largest distance of a node, over the largest motion [-].
        motion: The largest motion [m].
    """

    apart: float
    motion: float

    def __str__(self) -> str:
        return f"{100 * self.apart:.5f} % of {1e3 * self.motion:.1f} mm"


def run(count: int, say: Callable[[str], None]) -> dict[str, Figure]:
    """Solve at most so many bodies of each group by both programs.

    Returns:
        Largest distances of a node in per cent of the largest motion.
        `calculix_difference_percent`: the same law and element.
        `calculix_similar_law_difference_percent`: laws that agree for small strain
        alone; what differs, the export says.
        `calculix_incompressible_difference_percent`: nu = 0.499, where CalculiX's
        quadratic tets lock, and those of the package have a mean change of volume: the
        same law, but another element. Empty where CalculiX is missing.
    """
    if missing():
        say(
            "calculix: no figures. There is no program ccx; install the Debian package "
            "calculix-ccx."
        )
        return {}
    figures: dict[str, Figure] = {}
    for figure, bodies in GROUPS.items():
        worst = 0.0
        for name, body in list(bodies.items())[:count]:
            with tempfile.TemporaryDirectory() as folder:
                gap = difference(Path(folder), *body())
            say(f"calculix: {name}: {gap}")
            worst = max(worst, 100.0 * gap.apart)
        figures[figure] = worst
    return figures


def missing() -> bool:
    """Tell whether CalculiX is not installed."""
    return shutil.which("ccx") is None


def difference(folder: Path, model: Model, lane: ConfigurationArrays) -> Difference:
    """Solve a configuration by both programs.

    Args:
        folder: Where the files of CalculiX go.
        model: The model.
        lane: The configuration.

    Raises:
        RuntimeError: If one of them finds no equilibrium.
    """
    write_inp(folder / "job.inp", model, lane)
    theirs = solved_by_calculix(folder, model.mesh.n_nodes)
    solution = solve_equilibrium(model, lane)
    if not solution.converged:
        raise RuntimeError("the package finds no equilibrium.")
    ours = np.asarray(solution.displacement)[: model.mesh.n_nodes]
    motion = float(np.linalg.norm(ours, axis=1).max())
    apart = float(np.linalg.norm(theirs - ours, axis=1).max())
    return Difference(apart / motion, motion)


def solved_by_calculix(folder: Path, n_nodes: int) -> np.ndarray:
    """Run CalculiX on `job.inp`, and read the displacements at the end of the step [m].

    Raises:
        RuntimeError: If it fails.
    """
    done = subprocess.run(
        ["ccx", "job"], cwd=folder, capture_output=True, text=True, check=False
    )
    if done.returncode != 0 or "*ERROR" in done.stdout:
        raise RuntimeError(f"CalculiX failed: {done.stdout[-2000:]}")
    rows = _printed(folder, "displacements (vx,vy,vz) for set NALL").splitlines()
    u = np.array([row.split() for row in rows if row][:n_nodes], float)
    if not np.array_equal(u[:, 0], np.arange(1, n_nodes + 1)):
        raise RuntimeError("CalculiX wrote no displacements of the whole step.")
    return u[:, 1:]


def reaction_by_calculix(folder: Path, nodes: str) -> np.ndarray:
    """Read the total force on a set of nodes at the end of the step [N].

    The input file asks for it by `RF` in a *NODE PRINT with TOTALS=ONLY.
    """
    text = _printed(folder, f"total force (fx,fy,fz) for set {nodes}")
    return np.array(text.split()[:3], float)


def _printed(folder: Path, what: str) -> str:
    """Return what `job.dat` holds below a head, at the end of the step."""
    head = f"{what} and time  0.1000000E+01"
    _, separator, text = (folder / "job.dat").read_text().rpartition(head)
    if not separator:
        raise RuntimeError(f"CalculiX wrote no {what} of the whole step.")
    return text


def lane_of(model: Model, configuration: Configuration) -> ConfigurationArrays:
    """Arrays of one configuration, without a leading axis."""
    batch = configuration_arrays(model.mesh, [configuration], model.mechanism)
    return jax.tree.map(lambda leaf: leaf[0], batch)


def bar(
    law: AbstractLaw,
    *,
    order: int = 2,
    cells: tuple[int, int, int] = (2, 1, 1),
    density: Any = 1000.0,
    **more: Any,
) -> Model:
    """Build a bar along x, whose upper edge at the end is a group."""
    mesh = beam(*SIZE, cells, order=order)
    mesh = mesh.with_node_group("tip & edge", tip_edge(mesh))
    return build_model(mesh, law, density=density, **more)


def tip_edge(mesh: TetMesh) -> np.ndarray:
    """Nodes of the upper edge of the end face."""
    x, _, z = mesh.points.T
    return np.flatnonzero(np.isclose(x, SIZE[0]) & np.isclose(z, SIZE[2]))


def bent_bar(
    law: AbstractLaw, order: int = 2, supports: Any = "x_min", **options: Any
) -> Body:
    """Bend a bar until its tip goes down by a quarter of its length."""
    model = bar(law, order=order, cells=(8, 2, 2), **options)
    loads = EdgeForce(tip_edge(model.mesh), (0.0, 0.0, -0.04))
    return Body(model, lane_of(model, Configuration("bent", supports, loads=loads)))


def inflated(order: int, law: AbstractLaw | None = None, pressure: float = 2e3) -> Body:
    """Inflate the cavity of a cube that stands on its base [Pa]."""
    mesh = hollow_cube(order=order)
    fixed = np.flatnonzero(np.isclose(mesh.points[:, 2], -0.5))
    mesh = mesh.with_node_group("base", fixed)
    law = NeoHookean(2e5, 0.4) if law is None else law
    model = build_model(mesh, law, density=0.0, actuators=[Chamber("c", "cavity")])
    blow = {"c": ImposedForce(pressure)}
    configuration = Configuration("blow", "base", gravity=(0, 0, 0), actuation=blow)
    return Body(model, lane_of(model, configuration))


def isotropic(E: Any = 2e5) -> AbstractLaw:
    """St. Venant-Kirchhoff, with one modulus or one for each tet [Pa]."""
    return StVenantKirchhoff(Isotropic(E, 0.3))


def incompressible() -> AbstractLaw:
    """A rubber, nearly incompressible."""
    return Yeoh(3.4e4, -3e3, 1e3, 0.499)


def _across() -> TransverseIsotropic:
    return TransverseIsotropic(3e5, 1.5e5, 0.3, 0.25, 8e4, Fibre(0.4, 0.2))


FIELD = np.linspace(1.5e5, 3e5, 8 * 2 * 2 * 6)

Laws = Mapping[str, Callable[[], AbstractLaw]]
Bodies = Mapping[str, Callable[[], Body]]

# Laws are built when they are used: numbers that are held before float64 is switched on
# keep single precision.
SAME: Laws = {
    "st venant-kirchhoff": isotropic,
    "of each tet": lambda: isotropic(FIELD),
    "anisotropic": lambda: StVenantKirchhoff(_across()),
    "mooney-rivlin": lambda: MooneyRivlin(2e4, 1.4e4, 0.45),
    "yeoh": lambda: Yeoh(3.4e4, -3e3, 1e3, 0.45),
    # pyright takes the order of a base class for that of the arguments.
    "ogden": lambda: Ogden(4e4, 2.5, -4e3, -2.0, nu=0.45),  # pyright: ignore
}
"""Laws that CalculiX has, up to the change of volume at second order."""

SIMILAR: Laws = {
    "neo-hookean, nu 0.3": lambda: NeoHookean(2e5, 0.3),
    "neo-hookean, nu 0.45": lambda: NeoHookean(2e5, 0.45),
    "corotational": lambda: Corotational(Isotropic(2e5, 0.3)),
    "corotational, anisotropic": lambda: Corotational(_across()),
}
"""Laws that agree for small strain; what differs is said in the notes of the export."""


def _bent(laws: Laws) -> Bodies:
    return {name: lambda law=law: bent_bar(law()) for name, law in laws.items()}


GROUPS: dict[str, Bodies] = {
    "calculix_difference_percent": {
        **_bent(SAME),
        "pressure, linear tets": lambda: inflated(1, isotropic(), 1.5e4),
        "pressure, quadratic tets": lambda: inflated(2, isotropic(), 1.5e4),
        "elastic support": lambda: bent_bar(
            isotropic(), supports=Support("x_min", stiffness=2e8)
        ),
        "nu 0.499, linear tets": lambda: bent_bar(
            incompressible(), 1, formulation="displacement"
        ),
        "nu 0.499, quadratic tets, both lock": lambda: bent_bar(
            incompressible(), 2, formulation="displacement"
        ),
    },
    "calculix_similar_law_difference_percent": _bent(SIMILAR),
    "calculix_incompressible_difference_percent": {
        "nu 0.499, quadratic tets, CalculiX alone locks": lambda: bent_bar(
            incompressible()
        )
    },
}
"""Bodies by the figure that they belong to."""
