"""Limits: what they say, and how they are raised."""

import pytest

from softcal_jax.mesh import read_mesh
from softcal_jax.sweeps import grid, run_sweep


def swept(folder, n):
    points = grid({"a": list(range(n))})
    return run_sweep(lambda trial: {"x": trial["a"]}, points, folder, workers=0)


def test_a_limit_names_the_number_and_the_remedy_and_can_be_raised(
    tmp_path, monkeypatch
):
    monkeypatch.setenv("SOFTCAL_MAX_TRIALS", "3")
    said = r"4 trials, .* 3\. .*SOFTCAL_MAX_TRIALS"
    with pytest.raises(ValueError, match=said):
        swept(tmp_path, 4)
    monkeypatch.setenv("SOFTCAL_MAX_TRIALS", "4e0")
    assert len(swept(tmp_path, 4).rows) == 4


@pytest.mark.parametrize("text", ["many", "-1", "0", "nan"])
def test_a_limit_that_is_no_number_is_refused(tmp_path, monkeypatch, text):
    monkeypatch.setenv("SOFTCAL_MAX_FILE_MB", text)
    (tmp_path / "a.vtu").write_text("")
    with pytest.raises(ValueError, match=f"SOFTCAL_MAX_FILE_MB is '{text}'; "):
        read_mesh(tmp_path / "a.vtu", length_unit="m")
