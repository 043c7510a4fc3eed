"""The workspace: a batch gives what its members give, and names its failures."""

import jax
import numpy as np
import pytest
from arm import EFFECTORS, LENGTH, TIGHT, arm, arrays, pose, solved

from softcal_jax.configurations import ImposedDisplacement
from softcal_jax.control import sample_workspace

START = pose(effectors=EFFECTORS, motor=0.0, top=ImposedDisplacement(0.0))
# The second would shorten a cable by three times its length.
INPUTS = [[0.2, 0.004], [0.0, 3 * LENGTH], [-0.1, 0.001]]


def test_batch_equals_its_members_and_names_the_one_that_failed():
    workspace = sample_workspace(arm(), START, INPUTS, settings=TIGHT)
    np.testing.assert_array_equal(workspace.converged, [True, False, True])
    assert workspace.names == ("motor", "top")
    (text,) = workspace.failures
    assert text.startswith("sample 1 (motor = 0, top = 0.3): ")
    assert np.all(np.isnan(workspace.effectors["tip"][1]))
    assert np.all(np.isnan(workspace.effectors["frame"][1]))
    assert workspace.effectors["frame"].shape == (3, 2, 3)
    configuration = arrays(START)
    for i in (0, 2):
        motor, top = INPUTS[i]
        solution, state = solved(
            arm(), configuration, jax.numpy.array([top, 0.0, motor])
        )
        np.testing.assert_array_equal(
            workspace.solution.displacement[i], solution.displacement
        )
        # Points first, then turns.
        tip = workspace.effectors["tip"][i, 0]
        frame = workspace.effectors["frame"][i]
        np.testing.assert_allclose(
            [tip, *frame], state.effectors[:3], rtol=1e-12, atol=1e-15
        )


@pytest.mark.parametrize(
    ("inputs", "message"),
    [
        ([0.1, 0.2], r"motor, top, .* got \(2,\)"),
        ([[0.1]], r"shape \(n_samples, 2\), got \(1, 1\)"),
        ([[0.1, 0.0], [20.0, 0.0]], "'arm, sample 1': .*'motor' .* 20 rad"),
        ([[np.nan, 0.0]], "'arm, sample 0': .*'motor' .* nan rad"),
    ],
)
def test_bad_inputs(inputs, message):
    with pytest.raises(ValueError, match=message):
        sample_workspace(arm(), START, inputs)


def test_nothing_to_command_or_follow():
    with pytest.raises(ValueError, match="'arm' commands no actuator"):
        sample_workspace(arm(), pose(), [[]])
    with pytest.raises(ValueError, match="'arm' has no effectors"):
        sample_workspace(arm(), pose(effectors=[], motor=0.0), [[0.0]])
