"""The benchmark of transfer: what it plants, and how it changes a project."""

import numpy as np
import pytest

from benchmarks import transfer
from softcal_jax.robots import ready_made_path


@pytest.mark.slow
def test_a_wrong_mounting_is_told_apart_and_a_right_one_is_not():
    figures = transfer.planted(1)
    assert figures["wrong_told_apart_percent"] == 100.0
    assert figures["right_told_apart_percent"] == 0.0
    assert 1.0 < figures["wrong_fit_over_right"] < 4.0


def test_the_beam_gets_the_law_of_the_arm():
    changed = transfer._changed(ready_made_path("beam"), transfer._GENT)
    assert [p.name for p in changed.parameters] == ["mu"]
    law = changed.model.law
    assert type(law).__name__ == "Gent"
    np.testing.assert_allclose(law.J_m, 60.0)


def test_a_project_that_is_not_as_expected_is_no_robot_to_ask():
    with pytest.raises(RuntimeError, match="does not stand once"):
        transfer._changed(ready_made_path("beam"), [("not there", "")])
