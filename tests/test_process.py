"""What a process must be like: every way in says what is wrong, instead of waiting."""

import os

import jax
import pytest
from problems import lane_of
from small_project import write_small_project

from softcal_jax import _process
from softcal_jax.calibration import build_problem, calibrate, multi_start
from softcal_jax.configurations import configuration_arrays
from softcal_jax.equilibrium import build_model, solve_equilibrium
from softcal_jax.identifiability import identify
from softcal_jax.project import load_project


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    return load_project(write_small_project(tmp_path_factory.mktemp("small")))


@pytest.fixture(
    params=["build_model", "load", "solve", "calibrate", "search", "identify"]
)
def entry(request, project):
    """Calls an entry point with what was made beforehand."""
    model, fitted = project.model, (project.space, project.calibration)
    lanes = configuration_arrays(model.mesh, project.calibration)
    problem = build_problem(model, *fitted)
    return {
        "build_model": lambda: build_model(model.mesh, model.law, density=1.0),
        "load": lambda: load_project(project.path),
        "solve": lambda: solve_equilibrium(model, lane_of(lanes)),
        "calibrate": lambda: calibrate(model, *fitted),
        "search": lambda: multi_start(problem, 2),
        "identify": lambda: identify(model, *fitted),
    }[request.param]


def test_float32_is_refused_also_where_it_is_switched_on_later(entry):
    with (
        jax.enable_x64(False),
        pytest.raises(ValueError, match=r"float64.*float32"),
    ):
        entry()


def test_a_forked_child_is_refused(entry, monkeypatch):
    """It would wait for ever for threads that only its parent has."""
    parent = os.getppid()
    monkeypatch.setattr(_process, "_first", [parent])
    message = rf"forked from .* computed \({parent}\).*get_context\(\"spawn\"\)"
    with pytest.raises(RuntimeError, match=message):
        entry()
