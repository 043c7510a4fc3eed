"""Worker processes of the tests find the helpers beside them."""

import sys
from pathlib import Path

import pytest

HERE = Path(__file__).parent


@pytest.fixture(autouse=True)
def _importable(monkeypatch):
    """Workers import `cheap`, and find the compiled programs of other tests."""
    folders = [str(HERE), str(HERE.parent)]
    for folder in folders:
        if folder not in sys.path:
            monkeypatch.syspath_prepend(folder)
    monkeypatch.setenv("PYTHONPATH", ":".join([*folders, *sys.path]))
    # Numbers that a test sets itself, see `threads_of_children`.
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
