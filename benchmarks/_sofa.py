"""A stand-in of the module `Sofa`, strict where SOFA only warns.

It knows the components that scenes may use, the plugins that have them, and the names
of their data in both releases (_sofa_names.json). Unknown names, plugins that were not
required, links to nothing and a mesh that SOFA could not read are errors; where unknown
names are counted, they are collected instead.
"""

import importlib.util
import json
import os
import sys
import types
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

_NAMES = json.loads(Path(__file__).with_name("_sofa_names.json").read_text())

# Arguments of `addObject` that are no data.
_ARGUMENTS = {"template"}

_VARIABLE = "SOFTCAL_CONFIGURATION"


def components(release: str) -> dict[str, tuple[str | None, set[str]]]:
    """Return plugin and names of the data of each component of a release."""
    common = set(_NAMES["of all"].split())
    known = _NAMES["both"] | _NAMES[release]
    return {
        name: (entry["plugin"], common | set(entry["data"].split()))
        for name, entry in known.items()
    }


class Data:
    """A field of a component or a node."""

    def __init__(self, value: Any):
        """Hold a value."""
        self.value = value


class Object:
    """A component with its data."""

    def __init__(self, component: str, data: dict[str, Any]):
        """Hold what a component was made with."""
        self.component, self.data = component, data
        self.name = data.get("name", component)
        self.position = Data(data.get("position"))


class Controller:
    """What `Sofa.Core.Controller` is, to those that inherit from it."""

    def __init__(self, name: str = "Controller"):
        """Take a name."""
        self.name = name


class Node:
    """A node of the scene graph that checks what is added.

    Attributes:
        objects: Components and controllers.
        children: Nodes below.
        plugins: Those that were required, at the root.
    """

    def __init__(
        self,
        name: str,
        release: str,
        *,
        root: "Node | None" = None,
        unknown: list[str] | None = None,
    ):
        """Make a node of a release, which is a root if none is given.

        Args:
            name: Name of the node.
            release: Release of SOFA, like "v26.06".
            root: The root, for all other nodes.
            unknown: Takes what is not known, at the root; errors without.
        """
        self.name, self.release, self.root = name, release, root or self
        self.objects: list[Any] = []
        self.children: list[Node] = []
        self.gravity, self.dt = Data(None), Data(None)
        self.plugins: set[str] = set()
        self._unknown = unknown

    def addChild(self, name: str) -> "Node":
        """Add a node below, like SOFA's function of that name."""
        _check(name.isidentifier(), f"{name!r} is no name of a node")
        taken = name in [child.name for child in self.children]
        _check(not taken, f"there are two nodes {name}")
        self.children.append(Node(name, self.release, root=self.root))
        return self.children[-1]

    def addObject(self, component: "str | Controller", **data: Any) -> Any:
        """Add a component with its data, or a controller.

        Raises:
            ValueError: If SOFA does not know a name, or could not follow a link.
        """
        if isinstance(component, Controller):
            _check(not data, "a controller takes no data")
            self.objects.append(component)
            return component
        self._check_names(component, set(data) - _ARGUMENTS)
        if component == "RequiredPlugin":
            self.root.plugins.add(data["name"])
        if component == "MeshVTKLoader":
            data |= read_vtk(data["filename"])
        made = Object(component, {k: self._linked(v) for k, v in data.items()})
        if "name" in data:
            taken = made.name in [other.name for other in self.objects]
            _check(not taken, f"there are two objects {made.name}")
        self.objects.append(made)
        if component == "RequiredPlugin":
            plugins = {plugin for plugin, _ in components(self.release).values()}
            if data["name"] not in plugins:
                self._note(f"no component needs a plugin {data['name']}")
        return made

    def _check_names(self, component: str, names: set[str]) -> None:
        known = components(self.release)
        if component not in known:
            self._note(f"SOFA {self.release} has no component {component}")
            return
        plugin, data = known[component]
        if plugin is not None and plugin not in self.root.plugins:
            self._note(f"{component} needs the plugin {plugin}")
        for name in sorted(names - data):
            self._note(f"{component} has no data {name}")

    def _note(self, text: str) -> None:
        """Collect what is unknown, or raise."""
        if self.root._unknown is None:
            raise ValueError(text)
        self.root._unknown.append(text)

    def _linked(self, value: Any) -> Any:
        """Follow a link like "@loader.position", or check one like "@newton"."""
        if not (isinstance(value, str) and value.startswith("@")):
            return value
        name, _, field = value[1:].partition(".")
        owners = [o for o in self.objects if o.name == name]
        _check(len(owners) == 1, f"the link {value} leads nowhere")
        return owners[0].data[field] if field else value

    def find(self, component: str) -> list[Any]:
        """All components of a class in this node and below."""
        hits = [o for o in self.objects if getattr(o, "component", None) == component]
        return hits + [o for child in self.children for o in child.find(component)]


def read_vtk(path: str) -> dict[str, list]:
    """Read points and tets as the legacy reader of SOFA takes them.

    Raises:
        ValueError: If it could not read the file.
    """
    lines = Path(path).read_text().split("\n")
    version = float(lines[0].removeprefix("# vtk DataFile Version "))
    _check(version < 5, "SOFA cannot read VTK 5")
    head = ["ASCII", "DATASET UNSTRUCTURED_GRID"]
    _check(lines[2:4] == head, "the mesh is no unstructured grid in ASCII")
    words = " ".join(lines[4:]).split()
    at = {key: words.index(key) for key in ("POINTS", "CELLS", "CELL_TYPES")}
    n_points = int(words[at["POINTS"] + 1])
    start = at["POINTS"] + 3
    points = np.array(words[start : start + 3 * n_points], float).reshape(-1, 3)
    n_cells, size = (int(word) for word in words[at["CELLS"] + 1 : at["CELLS"] + 3])
    start = at["CELL_TYPES"] + 2
    linear = size == 5 * n_cells and set(words[start : start + n_cells]) == {"10"}
    _check(linear, "there are other cells than linear tets")
    start = at["CELLS"] + 3
    cells = np.array(words[start : start + size], int).reshape(-1, 5)
    _check(bool(np.all(cells[:, 0] == 4)), "a tet has other than four nodes")
    return {"position": points.tolist(), "tetrahedra": cells[:, 1:].tolist()}


def run(
    folder: Path,
    release: str,
    *,
    name: str | None = None,
    unknown: list[str] | None = None,
) -> tuple[Node, Any]:
    """Build the scene in a folder.

    Args:
        folder: Folder of `scene.py`.
        release: Release of SOFA that runs it, like "v26.06".
        name: Configuration; the first if left out.
        unknown: Takes what SOFA does not know, in place of an error.

    Returns:
        The root of the scene, and its monitor.

    Raises:
        ValueError: If the scene does what SOFA would not understand.
    """
    spec = importlib.util.spec_from_file_location("scene", folder / "scene.py")
    if spec is None or spec.loader is None:
        raise ValueError(f"{folder} has no scene.py.")
    scene = importlib.util.module_from_spec(spec)
    with _sofa_installed(), _configuration(name):
        spec.loader.exec_module(scene)
        root = Node("root", release, unknown=unknown)
        scene.createScene(root)
    (monitor,) = [o for o in root.objects if isinstance(o, Controller)]
    return root, monitor


@contextmanager
def _sofa_installed() -> Iterator[None]:
    """Let `import Sofa` find the stand-in."""
    core = types.ModuleType("Sofa.Core")
    core.__dict__["Controller"] = Controller
    sofa = types.ModuleType("Sofa")
    sofa.__dict__["Core"] = core
    modules = {"Sofa": sofa, "Sofa.Core": core}
    before = {name: sys.modules.get(name) for name in modules}
    sys.modules.update(modules)
    try:
        yield
    finally:
        for name, module in before.items():
            if module is None:
                del sys.modules[name]
            else:
                sys.modules[name] = module


@contextmanager
def _configuration(name: str | None) -> Iterator[None]:
    """Choose a configuration as a user does, by a variable of the environment."""
    before = os.environ.pop(_VARIABLE, None)
    if name is not None:
        os.environ[_VARIABLE] = name
    try:
        yield
    finally:
        os.environ.pop(_VARIABLE, None)
        if before is not None:
            os.environ[_VARIABLE] = before


def _check(holds: bool, text: str) -> None:
    if not holds:
        raise ValueError(text)
