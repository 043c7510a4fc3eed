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
    return {
        "nodes": nodes,
        "solve_s": 1e-6 * nodes**1.25,
        "memory_gb": 1e-6 * nodes,
        "peak_gb": 0.3 + 1e-6 * nodes,
        "setup_s": 1.0,
        "steps": 4,
    }


def test_a_mesh_that_fails_ends_the_series_and_is_named(monkeypatch, tmp_path):
    largest = [99]

    def process(command):
        across = int(command[-1])
        if across > largest[0]:
            raise RuntimeError(f"benchmarks.growth {across} ended with -9:\nkilled")
        return f"some line\n{json.dumps(measured(across))}\n"

    monkeypatch.setattr(growth, "run_process", process)
    figures = growth.run(Options(tmp_path, lambda text: None)).figures
    assert figures["largest_nodes"] == 6 * growth.ACROSS[-1] ** 3
    assert figures["ended_by"] == "the largest mesh that was asked for"
    np.testing.assert_allclose(figures["time_exponent"], 1.25)
    np.testing.assert_allclose(figures["memory_exponent"], 1.0)
    np.testing.assert_allclose(
        figures["peak_memory_gb"], 0.3 + 6e-6 * growth.ACROSS[-1] ** 3
    )
    largest[0] = 13
    figures = growth.run(Options(tmp_path, lambda text: None)).figures
    assert figures["largest_nodes"] == 6 * 13**3
    assert figures["ended_by"] == "16 cells across failed: killed"
    np.testing.assert_allclose(figures["time_exponent"], 1.25)


def test_the_first_mesh_must_work(monkeypatch, tmp_path):
    def process(command):
        raise RuntimeError("no module")

    monkeypatch.setattr(growth, "run_process", process)
    with pytest.raises(RuntimeError, match="no module"):
        growth.run(Options(tmp_path, lambda text: None))
