"""Input that is refused, and with which words."""

from contextlib import contextmanager

import pytest


@contextmanager
def refused(*texts):
    """What is done inside raises a ValueError that says all of this."""
    with pytest.raises(ValueError) as caught:  # noqa: PT011
        yield
    for text in texts:
        assert text in str(caught.value)
