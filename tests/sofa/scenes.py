"""Scenes of small bodies, as exported, without a calibration before."""

import equinox as eqx
import jax
import numpy as np

import softcal_jax as sc
from softcal_jax.configurations import configuration_arrays
from softcal_jax.equilibrium import NewtonSettings, build_model, solve_from_rest
from softcal_jax.fields import ParameterSpace
from softcal_jax.mesh import beam
from softcal_jax.sofa._component import component_of
from softcal_jax.sofa._configurations import scene_configurations, vertex_masses
from softcal_jax.sofa._units import scale_of
from softcal_jax.sofa._write import Scene, write_scene

LENGTH, SIDE, DENSITY = 0.1, 0.02, 1070.0
MESH = beam(LENGTH, SIDE, SIDE, (6, 2, 2))
TIP = sc.Markers(["tip", "middle"], [(LENGTH, 0.01, 0.01), (0.05, 0.013, 0.02)])
DENSITIES = ParameterSpace(
    [sc.Parameter("density", "density", start=DENSITY, lower=1.0, upper=1e4)]
)

_solve = eqx.filter_jit(solve_from_rest)


class Posed(eqx.Module):
    """A model with the equilibria of its configurations."""

    model: eqx.Module
    configurations: tuple
    displacement: np.ndarray

    def write(self, folder, *, release="v26.06", units="mm-kg-s"):
        """Write the scene to a folder."""
        scale, model = scale_of(units), self.model
        scene = Scene(
            name="test",
            release=release,
            units=scale.words,
            mesh=model.mesh,
            length=scale.length,
            elasticity=component_of(model.law, model.n_tets, release, scale),
            vertex_mass=vertex_masses(model),
            configurations=scene_configurations(
                model,
                DENSITIES,
                DENSITIES.start(),
                self.configurations,
                list(self.displacement),
                scale,
            ),
        )
        write_scene(folder, scene, text=["E: 1 Pa"], notes=[])
        return scene


def posed(law, configurations, *, mesh=MESH, actuators=()) -> Posed:
    """Solve the equilibria to rounding."""
    model = build_model(mesh, law, density=DENSITY, actuators=actuators)
    lanes = configuration_arrays(mesh, configurations, model.mechanism)
    settings = NewtonSettings(rtol=1e-12)
    found = _solve(model, lanes, settings.as_arrays())
    assert bool(np.all(jax.device_get(found.converged)))
    u = np.asarray(found.displacement)[:, : mesh.n_nodes]
    return Posed(model, tuple(configurations), u)
