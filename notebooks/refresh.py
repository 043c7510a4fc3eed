"""Execute notebooks, and keep their outputs in the files for those who only read.

`python notebooks/refresh.py` does all, `python notebooks/refresh.py 01_silicone_beam`
one of them.
"""

import base64
import hashlib
import io
import sys
from pathlib import Path

import nbformat
from nbclient import NotebookClient
from nbformat import NotebookNode
from PIL import Image

FOLDER = Path(__file__).parent

MOST_BYTES = 100_000
"""Most bytes of a picture."""


def code_of(notebook: NotebookNode) -> str:
    """Digest the code of a notebook; its outputs belong to the one that they keep."""
    cells = [cell.source for cell in notebook.cells if cell.cell_type == "code"]
    return hashlib.sha256("\n\0\n".join(cells).encode()).hexdigest()


def executed(notebook: NotebookNode, folder: Path = FOLDER) -> NotebookNode:
    """Run every cell in a fresh kernel, and return the notebook with its outputs."""
    notebook = nbformat.from_dict(notebook)
    for cell in notebook.cells:
        if cell.cell_type == "code":
            cell.outputs, cell.execution_count = [], None
    client = NotebookClient(
        notebook,
        timeout=1800,
        kernel_name="python3",
        record_timing=False,
        resources={"metadata": {"path": str(folder)}},
    )
    client.execute()
    return notebook


def tidy(notebook: NotebookNode) -> None:
    """Make pictures small, take out what depends on the machine, and sign the code.

    Raises:
        ValueError: If a picture cannot be made small enough.
    """
    for cell in notebook.cells:
        if cell.cell_type == "code":  # a progress line leaves an empty output
            shown = [o for o in cell.outputs if o.get("data") != {"text/plain": ""}]
            cell.outputs = shown
    outputs = (output for cell in notebook.cells for output in cell.get("outputs", []))
    for output in outputs:
        if "image/png" in output.get("data", {}):
            content = base64.b64decode(output.data["image/png"])
            output.data["image/png"] = base64.b64encode(small(content)).decode()
    notebook.metadata = nbformat.from_dict(
        {
            "kernelspec": {
                "display_name": "Python 3",
                "language": "python",
                "name": "python3",
            },
            "language_info": {"name": "python"},
            "outputs_of": code_of(notebook),
        }
    )


def small(content: bytes) -> bytes:
    """Write a PNG with 256 colours, and smaller until it may be kept.

    Raises:
        ValueError: If it cannot be made small enough.
    """
    picture = Image.open(io.BytesIO(content)).convert("RGB")
    for share in (1.0, 0.8, 0.65, 0.5):
        size = tuple(round(share * side) for side in picture.size)
        shown = picture if share == 1.0 else picture.resize(size, Image.LANCZOS)
        written = io.BytesIO()
        shown.quantize(256, dither=Image.Dither.NONE).save(
            written, "png", optimize=True
        )
        if written.tell() <= MOST_BYTES:
            return written.getvalue()
    raise ValueError(
        f"a picture of {picture.size} pixels takes more than {MOST_BYTES} bytes; draw "
        "a smaller one."
    )


def refresh(path: Path) -> None:
    """Execute a notebook, and write it with its outputs."""
    notebook = executed(nbformat.read(path, as_version=4))
    tidy(notebook)
    nbformat.write(notebook, path)


if __name__ == "__main__":
    names = sys.argv[1:] or sorted(p.stem for p in FOLDER.glob("*.ipynb"))
    for name in names:
        refresh(FOLDER / f"{name}.ipynb")
        print(f"{name}: outputs written")
