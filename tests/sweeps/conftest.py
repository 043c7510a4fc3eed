"""Worker processes of the tests find the helpers beside them."""

import sys
from pathlib import Path

import pytest

HERE = Path(__file__).parent


@pytest.fixture(autouse=True)
def _importable(monkeypatch, tmp_path):
    """Workers import `cheap`, and keep compiled programs to this test."""
    folders = [str(HERE), str(HERE.parent)]
    for folder in folders:
        if folder not in sys.path:
            monkeypatch.syspath_prepend(folder)
    monkeypatch.setenv("PYTHONPATH", ":".join([*folders, *sys.path]))
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", str(tmp_path / "jax"))
    # Numbers that a test sets itself, see `threads_of_children`.
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
