"""The benchmark of growth: its powers, and a mesh that the machine cannot hold."""

import json

import numpy as np
import pytest

from benchmarks import growth
from benchmarks._problem import Options


def test_exponent_of_a_power():
    nodes = np.array([500.0, 4000.0, 100e3])
    np.testing.assert_allclose(growth.exponent(nodes, 3e-6 * nodes**1.5), 1.5)


def measured(across, power):
    nodes = 6 * across**3
    return {
        "nodes": nodes,
        "seconds": 1e-6 * nodes**power,
        "memory_gb": 1e-6 * nodes,
        "peak_gb": 0.3 + 1e-6 * nodes,
        "setup_s": 1.0,
        "steps": 4,
    }


def test_a_mesh_that_fails_ends_the_series_and_is_named(monkeypatch, tmp_path):
    largest = [99]
    powers = {"solve": 1.25, "calibration": 1.5}

    def process(command):
        kind, across = command[-2], int(command[-1])
        if across > largest[0]:
            raise RuntimeError(f"benchmarks.growth {across} ended with -9:\nkilled")
        return f"some line\n{json.dumps(measured(across, powers[kind]))}\n"

    monkeypatch.setattr(growth, "run_process", process)
    figures = growth.run(Options(tmp_path, lambda text: None)).figures
    last = {kind: across[-1] for kind, across in growth.ACROSS.items()}
    assert figures["largest_nodes"] == 6 * last["solve"] ** 3
    assert "largest mesh" in figures["ended_by"]
    np.testing.assert_allclose(figures["time_exponent"], 1.25)
    np.testing.assert_allclose(figures["calibration_time_exponent"], 1.5)
    np.testing.assert_allclose(figures["memory_exponent"], 1.0)
    peak = 0.3 + 6e-6 * last["solve"] ** 3
    np.testing.assert_allclose(figures["peak_memory_gb"], peak)
    peak = 0.3 + 6e-6 * last["calibration"] ** 3
    np.testing.assert_allclose(figures["calibration_peak_gb"], peak)
    largest[0] = 13
    figures = growth.run(Options(tmp_path, lambda text: None)).figures
    assert figures["largest_nodes"] == 6 * 13**3
    assert figures["ended_by"] == "16 cells across failed: killed"
    assert figures["calibration_ended_by"] == "14 cells across failed: killed"
    np.testing.assert_allclose(figures["time_exponent"], 1.25)
    np.testing.assert_allclose(figures["calibration_last_time_exponent"], 1.5)


def test_the_first_mesh_must_work(monkeypatch, tmp_path):
    def process(command):
        raise RuntimeError("no module")

    monkeypatch.setattr(growth, "run_process", process)
    with pytest.raises(RuntimeError, match="no module"):
        growth.run(Options(tmp_path, lambda text: None))
