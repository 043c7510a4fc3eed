"""The line of a long call in Python: where it is shown, and what is left of it."""

import io
import sys
import time
from types import SimpleNamespace

import pytest

from softcal_jax._process import progress_line


class Terminal(io.StringIO):
    def isatty(self):
        return True


def test_on_a_terminal_it_goes_on_and_leaves_nothing(monkeypatch):
    monkeypatch.setattr(sys, "stderr", terminal := Terminal())
    with progress_line(wanted=True) as line:
        assert line is not None
        line("step 3: rms 0.1 mm\nand more")
        time.sleep(1.2)
    shown = [text.rstrip() for text in terminal.getvalue().split("\r")]
    assert len([text for text in shown if text.endswith("s: step 3: rms 0.1 mm")]) >= 2
    assert shown[-2:] == ["", ""]
    assert "\n" not in terminal.getvalue()


@pytest.mark.parametrize(("stream", "wanted"), [(Terminal, False), (io.StringIO, True)])
def test_elsewhere_nothing_is_written(monkeypatch, stream, wanted):
    monkeypatch.setattr(sys, "stderr", written := stream())
    with progress_line(wanted=wanted) as line:
        assert line is None
    assert written.getvalue() == ""


def test_a_notebook_has_an_output_that_is_replaced(monkeypatch):
    class Handle:
        def display(self, shown, *, raw):
            outputs.append(shown)

        def update(self, shown, *, raw):
            outputs.append(shown)

    outputs, kernel = [], SimpleNamespace(kernel=None)
    display = SimpleNamespace(DisplayHandle=Handle)
    ipython = SimpleNamespace(get_ipython=lambda: kernel, display=display)
    monkeypatch.setitem(sys.modules, "IPython", ipython)
    with progress_line(wanted=True) as line:
        assert line is not None
        line("predicting")
        time.sleep(0.7)
    texts = [shown["text/plain"] for shown in outputs]
    assert (texts[0], texts[-1]) == ("", "")
    assert any(text.endswith("s: predicting") for text in texts)
