"""The benchmark of growth: its powers, and a mesh that the machine cannot hold."""

import json

import numpy as np
import pytest

from benchmarks import growth
from benchmarks._problem import Options


def test_exponent_of_a_power():
    nodes = np.array([500.0, 4000.0, 100e3])
    np.testing.assert_allclose(growth.exponent(nodes, 3e-6 * nodes**1.5), 1.5)


def measured(across):
    nodes = 6 * across**3
    columns = {"setup_s": 1.0, "steps": 4, "peak_gb": 0.3 + 1e-6 * nodes}
    columns |= {"tip_m": -0.01}
    return columns | {
        "nodes": nodes,
        "solve_s": 1e-6 * nodes**1.25,
        "memory_gb": 1e-6 * nodes,
    }


def test_a_mesh_that_fails_ends_the_series_and_is_named(monkeypatch, tmp_path):
    slower = {"auto": 1.0, "direct": 2.0, "multigrid": 3.0}
    limit = {"auto": 99, "direct": 13, "multigrid": 99}

    def process(command):
        solver, across = command[-2], int(command[-1])
        if across > limit[solver]:
            raise RuntimeError(f"benchmarks.growth {across} ended with -9:\nkilled")
        found = measured(across)
        found["solve_s"] *= slower[solver]
        found["tip_m"] *= 1.0 + 1e-9 * (solver == "direct")
        return f"some line\n{json.dumps(found)}\n"

    monkeypatch.setattr(growth, "run_process", process)
    figures = growth.run(Options(tmp_path, lambda text: None)).figures
    assert figures["direct_largest_nodes"] == 6 * 13**3
    assert figures["direct_ended_by"] == "16 cells across failed: killed"
    np.testing.assert_allclose(figures["direct_time_exponent"], 1.25)
    # The other series go on, and are held against that one as far as it went.
    assert figures["largest_nodes"] == 6 * growth.ACROSS[-1] ** 3
    np.testing.assert_allclose(figures["time_exponent"], 1.25)
    np.testing.assert_allclose(figures["memory_exponent"], 1.0)
    np.testing.assert_allclose(
        figures["peak_memory_gb"], 0.3 + 6e-6 * growth.ACROSS[-1] ** 3
    )
    np.testing.assert_allclose(figures["over_direct_at_its_largest"], 0.5)
    np.testing.assert_allclose(figures["multigrid_over_direct_left_out"], 1.5)
    np.testing.assert_allclose(figures["tip_difference"], 1e-9, rtol=1e-6)
    assert figures["multigrid_ended_by"] == "the largest mesh that was asked for"
    # What is known of the others is kept where multigrid, or the direct solver, fails.
    limit.update(direct=6, multigrid=4)
    figures = growth.run(Options(tmp_path, lambda text: None)).figures
    assert figures["multigrid_ended_by"] == "9 cells across failed: killed"
    assert "multigrid_over_direct_left_out" not in figures
    np.testing.assert_allclose(figures["over_direct_at_its_largest"], 0.5)


def test_the_first_mesh_must_work(monkeypatch, tmp_path):
    def process(command):
        raise RuntimeError("no module")

    monkeypatch.setattr(growth, "run_process", process)
    with pytest.raises(RuntimeError, match="no module"):
        growth.run(Options(tmp_path, lambda text: None))
