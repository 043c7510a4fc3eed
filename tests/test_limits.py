"""Limits: what they say, and how they are raised."""

import pytest

from softcal_jax._places import MEGABYTES, TRIALS, LimitError


def test_a_limit_names_the_number_and_the_remedy():
    TRIALS.check("starts", 100_000)
    said = r"^count = 100001: 100 001 trials, .* 100 000\. .*raise .*SOFTCAL_MAX_TRIALS"
    with pytest.raises(LimitError, match=said):
        TRIALS.check("count = 100001", 100_001)


def test_a_limit_can_be_raised(monkeypatch):
    monkeypatch.setenv("SOFTCAL_MAX_TRIALS", "1e6")
    TRIALS.check("count", 1_000_000)
    with pytest.raises(LimitError, match=r"count: 1e\+12 trials, .* 1 000 000\."):
        TRIALS.check("count", 10**12)


@pytest.mark.parametrize("text", ["many", "-1", "0", "nan"])
def test_a_limit_that_is_no_number_is_refused(monkeypatch, text):
    monkeypatch.setenv("SOFTCAL_MAX_FILE_MB", text)
    with pytest.raises(ValueError, match=f"SOFTCAL_MAX_FILE_MB is '{text}'; "):
        MEGABYTES.check("file", 1)
