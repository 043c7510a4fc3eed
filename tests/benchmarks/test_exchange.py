"""The benchmark of exchange: its parts, with few of each."""

import pytest

from benchmarks import exchange
from benchmarks._problem import Options


@pytest.mark.slow
def test_random_fields_for_icesl(tmp_path):
    said = []
    found = exchange.run(Options(tmp_path, said.append, {"icesl": 4}))
    assert 0.4 < found.figures["icesl_roundtrip_steps"] < 0.501
    assert found.figures["icesl_unlisted_voxels"] == 0
    # Some of what is asked for lies out of the foam's reach, so the list is not empty.
    assert found.figures["icesl_listed_percent"] > 0
    assert set(found.goals) < set(found.figures)
    assert len(said) == 4
