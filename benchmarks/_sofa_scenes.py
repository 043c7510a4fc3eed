"""Scenes for SOFA of all kinds, as exported: does SOFA know each name in them?

Nothing is calibrated before, and for the names nothing needs to be solved: scenes of
robots at rest hold the same components.
"""

import itertools
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import numpy as np

import softcal_jax as sc
from benchmarks import _sofa
from benchmarks._hollow import hollow
from benchmarks._problem import Figure
from softcal_jax.configurations import (
    Configuration,
    PointForce,
    SurfaceForce,
    configuration_arrays,
)
from softcal_jax.equilibrium import (
    Model,
    NewtonSettings,
    build_model,
    solve_equilibrium,
)
from softcal_jax.exchange._formats import exported_poses
from softcal_jax.exchange.sofa import PluginElasticity
from softcal_jax.exchange.sofa._component import SofaRelease
from softcal_jax.exchange.sofa._export import scene_data, write_scene
from softcal_jax.fields import ParameterSpace
from softcal_jax.materials import AbstractLaw, SofaCorotational, StVenantKirchhoff
from softcal_jax.mesh import TetMesh, beam

LENGTH, SIDE, DENSITY = 0.1, 0.02, 1070.0
MESH = beam(LENGTH, SIDE, SIDE, (6, 2, 2))
TIP = sc.Markers(["tip", "middle"], [(LENGTH, 0.01, 0.01), (0.05, 0.013, 0.02)])
E = 2e5 * (1.0 + MESH.centroids[:, 0] / 0.1)

RELEASES: tuple[SofaRelease, ...] = ("v25.12", "v26.06")
UNITS = ("mm-kg-s", "SI")

CONFIGURATIONS = (
    Configuration(
        "bent",
        "x_min",
        (0.5, 1.0, -9.7),
        [
            SurfaceForce("x_max", (0.0, 0.02, 0.0)),
            PointForce((0.07, 0.01, 0.02), (0.01, 0.0, -0.01)),
        ],
        TIP,
        measured=[(0.1, 0.01, 0.0), (0.05, 0.0, 0.01)],
    ),
    Configuration(
        "sprung & moved",
        [
            sc.Support("x_min", "xy"),
            sc.Support("x_max", "x", (-0.002, 0.0, 0.0)),
            sc.Support("z_min", "yz", stiffness=4e5),
        ],
        (0.0, 0.0, -9.8),
        markers=TIP,
    ),
)
"""Gravity, loads on a face and at a point, clamps, sliding, moved and elastic supports.
"""

GROUND = sc.Guide((-0.01, 0.01, 0.02), "ground")


class Posed(eqx.Module):
    """A model with displacements in its configurations.

    Attributes:
        model: The model.
        configurations: Its configurations.
        displacement: Of the nodes in each [m].
    """

    model: Model
    configurations: tuple[Configuration, ...]
    displacement: np.ndarray

    def write(
        self, folder: Path, *, release: SofaRelease = "v26.06", units: str = "mm-kg-s"
    ) -> None:
        """Write the scene to a folder."""
        model, space = self.model, densities()
        moved = self.configurations, list(self.displacement)
        data = scene_data(
            "test",
            model,
            exported_poses(model, space, space.start(), *moved),
            release=release,
            units="SI" if units == "SI" else "mm-kg-s",
        )
        write_scene(folder, data, model.mesh.tets, text=["E: 1 Pa"], notes=[])


def run(count: int, say: Callable[[str], None]) -> dict[str, Figure]:
    """Write so many kinds of scenes for both releases in both units, and run them.

    Returns:
        `sofa_scene_names_unknown`: components, plugins and data that SOFA does not
        know, each as often as it is used. `sofa_scenes`: how many were run.
    """
    unknown: list[str] = []
    n = 0
    for name in KINDS[:count]:
        say(f"sofa_scenes: {name}")
        robot = at_rest(name)
        for release, units in itertools.product(RELEASES, UNITS):
            if name == "procrustes" and release == "v25.12":
                continue  # which has no such component, so that it is refused
            with tempfile.TemporaryDirectory() as folder:
                path = Path(folder) / "scene"
                robot.write(path, release=release, units=units)
                for configuration in robot.configurations:
                    texts: list[str] = []
                    pose = configuration.name
                    _sofa.run(path, release, name=pose, unknown=texts)
                    for text in texts:
                        say(f"not known: {name}, {release}, {pose}: {text}")
                    unknown, n = unknown + texts, n + 1
    return {"sofa_scene_names_unknown": len(unknown), "sofa_scenes": n}


def at_rest(kind: str) -> Posed:
    """Build a robot of some kind, not solved."""
    law, mesh, actuators, configurations = None, MESH, [], CONFIGURATIONS
    if kind == "actuators":
        mesh = hollow_beam()
        law = SofaCorotational.of_mesh(mesh, sc.Isotropic(2e5, 0.3), "edge")
        actuators, configurations = actuated()
    model = build_model(
        mesh, law or LAWS[kind](), density=DENSITY, actuators=tuple(actuators)
    )
    shape = (len(configurations), *mesh.points.shape)
    return Posed(model, tuple(configurations), np.zeros(shape))


def posed(
    law: AbstractLaw,
    configurations: Sequence[Configuration],
    *,
    mesh: TetMesh = MESH,
    actuators: Sequence[Any] = (),
) -> Posed:
    """Solve the equilibria to rounding.

    Raises:
        RuntimeError: If there is none.
    """
    model = build_model(mesh, law, density=DENSITY, actuators=tuple(actuators))
    lanes = configuration_arrays(mesh, configurations, model.mechanism)
    newton = NewtonSettings(rtol=1e-12)
    solution = jax.vmap(lambda c: solve_equilibrium(model, c, settings=newton))(lanes)
    if not np.all(jax.device_get(solution.converged)):
        raise RuntimeError("a configuration has no equilibrium.")
    u = np.asarray(solution.displacement)[:, : mesh.n_nodes]
    return Posed(model, tuple(configurations), u)


def densities() -> ParameterSpace:
    """Space of one parameter, which scenes do not depend on."""
    density = sc.Parameter("density", "density", start=DENSITY, lower=1.0, upper=1e4)
    return ParameterSpace([density])


def edge_law(nu: float = 0.3) -> SofaCorotational:
    """Tets of `TetrahedronFEMForceField`, the method polar, a modulus each."""
    return SofaCorotational.of_mesh(MESH, sc.Isotropic(E, nu), "edge")


def _with_fibre() -> SofaCorotational:
    fibre = sc.Fibre(0.5 + 5.0 * MESH.centroids[:, 0])
    law = PluginElasticity(sc.ReducedTransverseIsotropic(2 * E, E, 0.3, fibre))
    return SofaCorotational.of_mesh(MESH, law, "large")


LAWS: dict[str, Callable[[], AbstractLaw]] = {
    "edge": edge_law,
    "procrustes": lambda: SofaCorotational.of_mesh(
        MESH, sc.Isotropic(E, 0.3), "procrustes"
    ),
    "large": lambda: SofaCorotational.of_mesh(MESH, sc.Isotropic(E, 0.3), "large"),
    "neo-hookean": lambda: sc.NeoHookean(2e5, 0.4),
    "st-venant-kirchhoff": lambda: StVenantKirchhoff(sc.Isotropic(2e5, 0.3)),
    "plugin": _with_fibre,
}
"""One law for each component of SOFA, or method of it."""

KINDS = ("actuators", *LAWS)


def hollow_beam() -> TetMesh:
    """Build a beam with a closed cavity along it."""
    full = beam(LENGTH, SIDE, SIDE, (5, 4, 4))
    away = np.abs(full.centroids - (0.05, 0.01, 0.01))
    mesh = hollow(full, np.all(away < (0.03, 0.005, 0.005), axis=1))
    return mesh.with_node_group("x_min", np.flatnonzero(mesh.points[:, 0] == 0.0))


def actuated() -> tuple[list[Any], list[Configuration]]:
    """Cables from the ground at either end and on the body, and a chamber.

    Forces and a pressure are imposed in all configurations but the last, which imposes
    a length and a volume.
    """
    path = [(0.02, 0.01, 0.02), (0.06, 0.01, 0.02), (LENGTH, 0.01, 0.02)]
    actuators = [
        sc.Cable("from the ground", [GROUND, *path]),
        sc.Cable("to the ground", [*path[::-1], GROUND]),
        sc.Cable("on the body", path),
        sc.Chamber("cavity", "cavity"),
    ]
    common = {"supports": "x_min", "gravity": (0.0, 0.0, -9.8), "markers": TIP}
    asked = {
        "pulled": (0.3, 0.0, 0.0, 0.0),
        "pulled at the other end": (0.0, 0.3, 0.0, 0.0),
        "all": (0.1, 0.0, 0.2, 2e3),
    }
    names = [a.name for a in actuators]
    configurations = [
        Configuration(
            name,
            actuation={
                actuator: sc.ImposedForce(value)
                for actuator, value in zip(names, values, strict=True)
            },
            **common,
        )
        for name, values in asked.items()
    ]
    wound = {
        "from the ground": sc.ImposedDisplacement(0.002),
        "cavity": sc.ImposedDisplacement(1e-7),
    }
    return actuators, [
        *configurations,
        Configuration("wound", actuation=wound, **common),
    ]
