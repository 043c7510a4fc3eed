"""Input that is refused, and with which words."""

from contextlib import contextmanager

import pytest
from wording import says


@contextmanager
def refused(*texts):
    """What is done inside raises a ValueError that says all of this."""
    with pytest.raises(ValueError) as caught:  # noqa: PT011
        yield
    assert all(says(caught.value, text) for text in texts)
