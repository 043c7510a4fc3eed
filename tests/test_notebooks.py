"""The notebooks run, and what is committed of their outputs belongs to their code."""

import base64
import importlib.util
import re
from pathlib import Path

import nbformat
import pytest

FOLDER = Path(__file__).parents[1] / "notebooks"

spec = importlib.util.spec_from_file_location("refresh", FOLDER / "refresh.py")
refresh = importlib.util.module_from_spec(spec)
spec.loader.exec_module(refresh)

NOTEBOOKS = [
    pytest.param(path, id=path.stem) for path in sorted(FOLDER.glob("*.ipynb"))
]

OF_A_MACHINE = re.compile(
    r"PosixPath|/tmp/|/home/|/root/|/Users/|site-packages|0x[0-9a-f]{6}"
)
"""Paths and addresses, which differ from one run to the next."""

HOW = "run `python notebooks/refresh.py {}` and commit what it writes"


def outputs_of(notebook):
    return [output for cell in notebook.cells for output in cell.get("outputs", [])]


def refused(notebook):
    """What is wrong with the outputs of a notebook; empty if nothing is."""
    outputs, wrong = outputs_of(notebook), []
    if notebook.metadata.get("outputs_of") != refresh.code_of(notebook):
        wrong.append("of other code")
    if not any("image/png" in output.get("data", {}) for output in outputs):
        wrong.append("no picture")
    for output in outputs:
        if output.output_type == "error" or output.get("name") == "stderr":
            wrong.append("error or warning")
        if OF_A_MACHINE.search(output.get("text", "") + str(texts_of(output))):
            wrong.append("of a machine")
        picture = output.get("data", {}).get("image/png", "")
        if len(base64.b64decode(picture)) > refresh.MOST_BYTES:
            wrong.append("a large picture")
    return wrong


def texts_of(output):
    data = output.get("data", {})
    return [data[kind] for kind in ("text/plain", "text/html") if kind in data]


@pytest.mark.parametrize("path", NOTEBOOKS)
def test_outputs_are_committed(path):
    notebook = nbformat.read(path, as_version=4)
    assert refused(notebook) == [], HOW.format(path.stem)


def test_outputs_of_changed_code_are_refused():
    notebook = nbformat.read(NOTEBOOKS[0].values[0], as_version=4)
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    code[1].source += " "
    code[2].outputs = [
        nbformat.v4.new_output("stream", name="stderr", text="in /tmp/x\n")
    ]
    assert refused(notebook) == ["of other code", "error or warning", "of a machine"]


@pytest.mark.slow
@pytest.mark.notebook
@pytest.mark.parametrize("path", NOTEBOOKS)
def test_notebook_runs(path):
    """Runs every cell in a fresh kernel; the notebooks hold their own assertions."""
    notebook = refresh.executed(nbformat.read(path, as_version=4))
    printed = [
        output.text
        for output in outputs_of(notebook)
        if output.output_type == "stream" and output.name == "stderr"
    ]
    assert printed == []
