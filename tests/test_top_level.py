"""What type checkers know of the top level, whose names are imported on first use."""

import subprocess
import sys

import pytest

TRIAL = """\
import softcal_jax as sc

reveal_type(sc.beam)
sc.does_not_exist
"""


@pytest.mark.slow
def test_pyright_knows_the_names_and_no_others(tmp_path):
    (tmp_path / "trial.py").write_text(TRIAL)
    done = subprocess.run(
        [sys.executable, "-m", "pyright", "--pythonpath", sys.executable, "trial.py"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
    )
    assert 'Type of "sc.beam" is "(length: float' in done.stdout
    assert '"does_not_exist" is not a known attribute' in done.stdout
    assert "1 error" in done.stdout
