"""Starts without an equilibrium: a bar in compression, which has a closed form.

St. Venant-Kirchhoff without Poisson effect: force per area E s (s^2 - 1) / 2 at the
stretch s, at most 0.19245 E in compression, at s = 1 / sqrt(3).
"""

import re

import jax.numpy as jnp
import numpy as np
import pytest
from watching import only
from wording import says

from softcal_jax.calibration import calibrate
from softcal_jax.configurations import Configuration, Markers, Support, SurfaceForce
from softcal_jax.equilibrium import EquilibriumProgress, build_model
from softcal_jax.fields import Parameter, exactly_known
from softcal_jax.materials import Isotropic, StVenantKirchhoff
from softcal_jax.mesh import beam

PUSH = 0.15
MESH = beam(2.0, 1.0, 1.0, (2, 1, 1))
MODEL = build_model(MESH, StVenantKirchhoff(Isotropic(1.0, 0.0)), density=1.0)
END = Markers(["end"], [(2.0, 0.0, 0.0)], 1e-3)
LIMIT = 0.5 * (1.0 - 1.0 / 3.0) / np.sqrt(3.0)


def stretch(E):
    s = np.roots([0.5, 0.0, -0.5, PUSH / E])
    return s[(s > 1.0 / np.sqrt(3.0)) & (s < 1.0)].real.item()


def pushed(name="pushed", push=PUSH):
    """The bar, pushed as it would be with E = 1."""
    supports = Support("x_min"), Support(np.arange(12), axes="yz")
    load = SurfaceForce("x_max", (-push, 0.0, 0.0))
    seen = np.array([[2.0 * stretch(1.0), 0.0, 0.0]])
    none = (0.0, 0.0, 0.0)
    return Configuration(name, supports, none, load, END, seen)


def fitted(start, upper, **more):
    E = Parameter("E", "E", start, 0.01, upper, unit="Pa")
    options = {"noise": "stated", "intervals": None, "uncertain": exactly_known()}
    return calibrate(MODEL, E, pushed(), **options, **more)


def test_a_start_that_is_too_soft_is_raised_and_said():
    """At E = 0.4 the bar carries 51 % of the load, at 0.8 all of it."""
    progress = []
    result = fitted(0.4, 10.0, watch=only(EquilibriumProgress, progress.append))
    assert result.converged
    # The data are exact, so Newton's tolerance of 1e-8 is all that is left.
    assert result.value("E") == pytest.approx(1.0, rel=1e-6)
    assert result.parameters[0].start == pytest.approx(0.8)
    carried = 100.0 * LIMIT * 0.4 / PUSH
    note = result.notes[0]
    assert says(note, "No equilibrium", "pushed", "stiffer", "E = 0.8 Pa")
    # The last equilibrium is at most one smallest load step, 0.1 %, below the limit.
    assert carried - 0.2 <= float(note.split("carries ")[1].split(" %")[0]) <= carried
    # Said while it ran, too: configuration, load, step and the factor on the moduli.
    assert {p.configuration for p in progress} == {"pushed"}
    assert {p.stiffer for p in progress} == {1.0, 2.0}
    assert progress[-1].load == 1.0
    assert max(p.load for p in progress if p.stiffer == 1.0) == pytest.approx(
        carried / 100.0, abs=2e-3
    )
    assert says(progress[-1], "pushed", "100 %", "moduli 2 times")
    # Where the load is cut for the third time, with its place and without an estimate.
    hard = [str(p) for p in progress if p.trouble]
    assert hard
    assert says(
        hard[-1],
        "pushed",
        "load steps cut to",
        "% (dead load does",
        "tets at",
        "deform most",
    )
    assert not any("left" in text for text in hard)


def test_without_being_told_the_fit_is_the_same():
    result = fitted(0.4, 10.0)
    assert result.parameters[0].start == pytest.approx(0.8)
    assert result.value("E") == pytest.approx(1.0, rel=1e-6)


def test_a_start_that_stands_is_not_touched():
    result = fitted(1.5, 10.0)
    assert result.parameters[0].start == 1.5
    assert not any("No equilibrium" in note for note in result.notes)


@pytest.mark.parametrize("watch", [None, lambda event: None])
def test_bounds_that_are_too_soft_are_named(watch):
    """At the upper bound of 0.5 Pa the bar carries 64 % of the load."""
    with pytest.raises(RuntimeError) as error:
        fitted(0.4, 0.5, watch=watch)
    text = str(error.value)
    assert re.search(
        "no equilibrium.*'pushed'.*law loses its stability.*51.* %", text, re.S
    )
    assert says(text, "stiffer moduli", "bounds", "E = 0.5 Pa")
    carried = float(text.split("pushed carries ")[1].split(" %")[0])
    assert carried == pytest.approx(100.0 * LIMIT * 0.5 / PUSH, abs=0.2)


def test_a_step_into_a_region_without_equilibrium_is_taken_back():
    """Data of a bar that is pushed less: the first step overshoots the limit."""
    soft = Parameter("E", "E", 0.82, 0.01, 10.0, unit="Pa")
    further = pushed()
    seen = jnp.array([[2.0 * (1.0 / np.sqrt(3.0) + 0.01), 0.0, 0.0]])
    further = Configuration(
        "pushed", further.supports, further.gravity, further.loads, END, seen
    )
    options = {"noise": "stated", "intervals": None, "uncertain": exactly_known()}
    result = calibrate(MODEL, soft, further, **options)
    s = float(seen[0, 0]) / 2.0
    assert result.value("E") == pytest.approx(PUSH / (0.5 * s * (1.0 - s**2)), rel=1e-5)
    assert any(not entry.accepted for entry in result.history)
