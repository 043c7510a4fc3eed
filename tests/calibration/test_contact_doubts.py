"""Contact that is not what the model takes it for costs the word trust."""

from dataclasses import replace

import jax.numpy as jnp
import pytest
from export.handmade import make_fit, make_result
from obstacle_results import beside_obstacles, pressed
from wording import says

from softcal_jax.identifiability import assess

SCALE = 2e-4


@pytest.fixture(scope="module")
def model():
    made = beside_obstacles()
    contacts = replace(made.mechanism.contacts, scale=jnp.array(SCALE))
    return replace(made, mechanism=replace(made.mechanism, contacts=contacts))


def doubts(model, **felt):
    """The doubts of a calibration with a pose in which the probe feels that."""
    fit = make_fit(model.mesh, "press 3")
    fit = replace(fit, robot=pressed(model, **felt).robot)
    return make_result(model=model, fits=[fit])


def test_what_slides_is_named(model):
    result = doubts(model, sliding=0.3)
    (doubt,) = result.contact_doubts
    assert doubt == (
        '"press 3": 30 % of what touches "probe" slides, as if it had moved straight '
        "there: what turned back on its way is held by other forces."
    )
    assert doubt in str(result)
    assert doubt in assess(result).reasons


def test_what_slides_in_several_poses_is_one_doubt(model):
    """The one in which most slides comes first."""
    fits = [
        replace(make_fit(model.mesh, name), robot=pressed(model, sliding=share).robot)
        for name, share in (("press 3", 0.3), ("press 4", 0.4))
    ]
    (doubt,) = make_result(model=model, fits=fits).contact_doubts
    assert says(doubt, '"press 4" and "press 3": up to 40 % of what touches "probe"')


def test_a_rim_always_slides(model):
    assert doubts(model, sliding=0.05).contact_doubts == ()
    assert len(doubts(model, sliding=0.051).contact_doubts) == 1


def test_what_lies_deep_is_named(model):
    (doubt,) = doubts(model, depth=1.1 * SCALE).contact_doubts
    E = 3.0 * 2e5 / 2.8  # of a body with the same shear modulus that keeps its volume
    assert says(doubt, '"press 3"', "0.22 mm", '"probe"', f"{1e-3 * E:.6g} kPa")
    assert "Start with a larger modulus" in doubt
    assert doubts(model, depth=SCALE).contact_doubts == ()


def test_they_do_not_say_that_the_data_contradict_the_model(model):
    """So no mistake in the data is sought because of them."""
    sound, sliding = doubts(model), doubts(model, sliding=0.3)
    assert sliding.contradicted == sound.contradicted
    assert len(assess(sliding).reasons) == len(assess(sound).reasons) + 1
