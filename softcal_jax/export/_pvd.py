"""All configurations of a results folder as one file for ParaView."""

from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree


def write_pvd(path: str | Path, files: Sequence[Sequence[str]]) -> None:
    """Write the list of the .vtu files of configurations, which ParaView opens at once.

    Each configuration is a time, 0, 1, 2 and so on, and its files are parts. (VTK has
    no writer for this format; see "ParaView file formats" in its documentation.)

    Args:
        path: The file, ending in .pvd.
        files: The files of each configuration, relative to the folder of `path`.

    Raises:
        ValueError: If the name does not end in .pvd.
    """
    path = Path(path)
    if path.suffix != ".pvd":
        raise ValueError(f"the file name must end in .pvd, got {path.name!r}.")
    version = {"type": "Collection", "version": "0.1", "byte_order": "LittleEndian"}
    root = ElementTree.Element("VTKFile", version)
    collection = ElementTree.SubElement(root, "Collection")
    for time, parts in enumerate(files):
        for part, file in enumerate(parts):
            entry = {"timestep": str(time), "part": str(part), "file": file}
            ElementTree.SubElement(collection, "DataSet", entry)
    tree = ElementTree.ElementTree(root)
    ElementTree.indent(tree)
    tree.write(path, encoding="utf-8", xml_declaration=True)
