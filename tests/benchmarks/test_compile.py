"""Cold and warm starts, in processes of their own."""

import pytest

from benchmarks import compile as starts
from benchmarks._compilations import Compilations


@pytest.mark.slow  # compiles the calibration of an anisotropic beam
def test_a_warm_start_takes_every_program_from_the_disk():
    figures = starts.beam_starts((3, 1, 1))
    assert figures["beam_programs"] > 50
    assert figures["beam_programs_not_kept"] == 0
    assert figures["recompilations_after_first_step"] == 0
    assert figures["beam_warm_compile_s"] < 0.5 * figures["beam_cold_compile_s"]
    assert figures["beam_warm_first_result_s"] < figures["beam_cold_first_result_s"]


@pytest.mark.slow  # compiles the calibration of a robot with cables and a body
def test_the_trunk_starts_cold_and_warm():
    figures = starts.trunk_starts()
    assert figures["trunk_warm_calibration_s"] < figures["trunk_cold_calibration_s"]


def test_the_table_has_cold_beside_warm():
    figures = {"import_s": 0.5, "demo_cold_s": 20.0, "demo_warm_s": 9.0}
    figures["beam_cold_over_before"] = 0.5  # a ratio is not a time
    table = starts._table(figures)
    assert table.rows == [["demo_s", "20.00", "9.00"]]


def test_compilations_are_those_within():
    import jax
    import jax.numpy as jnp

    double, x = jax.jit(lambda x: 2 * x), jnp.arange(3.0)
    with Compilations() as seen:
        double(x)
        double(x + 0)
    with Compilations() as again:
        double(x)
    assert "jit(<lambda>)" in seen.programs
    assert len(seen.seconds) == len(seen.programs)
    assert again.programs == []
