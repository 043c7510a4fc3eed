"""A light cantilever under its weight and pushed: the likelihood in closed form."""

from dataclasses import replace

import numpy as np

from softcal_jax.configurations import Configuration, Markers, PointForce
from softcal_jax.equilibrium import build_model
from softcal_jax.fields import Parameter
from softcal_jax.materials import NeoHookean
from softcal_jax.mesh import beam
from softcal_jax.robots import simulated_measurements

MESH = beam(0.1, 0.02, 0.02, (3, 1, 1), order=1)
MODEL = build_model(MESH, NeoHookean(400e3, 0.3), density=1.0)
TIP = (0.1, 0.01, 0.01)
STD = 0.1e-6
"""A sixteenth of how far the tip sinks, of a body so light that it stays linear [m]."""


def measured(noise=0.5, std=STD):
    """A tip under its weight, and pushed as well; off by some standard deviations."""
    tip = Markers(["tip"], [TIP], std)
    poses = [
        Configuration("hanging", "x_min", markers=tip),
        Configuration(
            "pushed", "x_min", loads=[PointForce(TIP, (0, 0, -4e-5))], markers=tip
        ),
    ]
    off = noise * STD * np.array([[[0.3, -0.2, 0.5]], [[0.4, 0.3, -0.6]]])
    return [
        replace(pose, measured=np.array(pose.measured) + gap)
        for pose, gap in zip(simulated_measurements(MODEL, poses), off, strict=True)
    ]


def unknowns(prior_std=None, upper=1e8):
    """E and the density, of which the first pose alone sees nothing but the ratio."""
    return [
        Parameter("E", "E", 300e3, 1e3, upper, unit="Pa", prior_std=prior_std),
        Parameter("density", "density", 1.2, 1e-2, 1e2),
    ]


def relative_error(result):
    """Of 1 / E: displacements are linear in it, times the load, and in density / E.

    From the design matrix of these two, at their values in the best fit.
    """
    moved = lambda f: np.ravel([p.simulated - p.at_rest for p in f.points])
    weight, both = (moved(f) / STD for f in result.configurations)
    design = np.stack([np.append(0 * weight, both - weight), np.append(weight, weight)])
    return float(np.sqrt(np.linalg.inv(design @ design.T)[0, 0]))
