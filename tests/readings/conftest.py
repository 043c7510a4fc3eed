"""Files that tests of tables write."""

import pytest


@pytest.fixture
def table(tmp_path):
    """Writes a text to a file, and says where that is."""
    path = tmp_path / "table.csv"

    def write(text):
        path.write_text(text)
        return path

    return write
