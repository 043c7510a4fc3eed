"""What tests ask of a message is looked for as whole words, and in order."""

import pytest
from wording import says

TEXT = "E_t of root is 0.7 MPa,\nabove its upper bound of 0.65 MPa: raise upper."


@pytest.mark.parametrize(
    "part", ["E_t ... 0.7 MPa", "0.65 MPa", "bound of 0.65", "above its", "raise upper"]
)
def test_what_a_text_says(part):
    assert says(TEXT, part)
    assert says(["nothing", TEXT], part)


@pytest.mark.parametrize(
    "part", ["7 MPa", "0.6", "0.7 M", "E", "0.65 MPa ... E_t", "nothing ... E_t"]
)
def test_what_it_does_not_say(part):
    with pytest.raises(AssertionError, match="says"):
        says(["nothing", TEXT], part)
