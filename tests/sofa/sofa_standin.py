"""A stand-in of the module `Sofa`, strict where SOFA only warns.

It knows the components that scenes may use, the plugins that have them, and the names
of their data in both releases (sofa_names.json). Unknown names, plugins that were not
required, links to nothing and a mesh that SOFA could not read are errors.
"""

import importlib.util
import json
import sys
import types
from pathlib import Path

import numpy as np

_NAMES = json.loads(Path(__file__).with_name("sofa_names.json").read_text())

# Arguments of `addObject` that are no data.
_ARGUMENTS = {"template"}


def components(release):
    """Plugin and names of the data of each component of a release."""
    common = set(_NAMES["of all"].split())
    known = _NAMES["both"] | _NAMES[release]
    return {
        name: (own["plugin"], common | set(own["data"].split()))
        for name, own in known.items()
    }


class Data:
    def __init__(self, value):
        self.value = value


class Object:
    """A component with its data."""

    def __init__(self, component, data):
        self.component, self.data = component, data
        self.name = data.get("name", component)
        self.position = Data(data.get("position"))


class Controller:
    def __init__(self, name="Controller"):
        self.name = name


class Node:
    """A node of the scene graph that checks what is added."""

    def __init__(self, name, release, root=None):
        self.name, self.release, self.root = name, release, root or self
        self.objects, self.children = [], []
        self.gravity, self.dt = Data(None), Data(None)
        if root is None:
            self.plugins = set()

    def addChild(self, name):
        assert name.isidentifier(), f"{name!r} is no name of a node"
        assert name not in [child.name for child in self.children]
        self.children.append(Node(name, self.release, self.root))
        return self.children[-1]

    def addObject(self, component, **data):
        if isinstance(component, Controller):
            assert not data
            self.objects.append(component)
            return component
        known = components(self.release)
        if component not in known:
            raise ValueError(f"SOFA {self.release} has no component {component}")
        plugin, names = known[component]
        if plugin is not None and plugin not in self.root.plugins:
            raise ValueError(f"{component} needs the plugin {plugin}")
        unknown = set(data) - names - _ARGUMENTS
        if unknown:
            raise ValueError(f"{component} has no data {', '.join(sorted(unknown))}")
        if component == "RequiredPlugin":
            self.root.plugins.add(data["name"])
        if component == "MeshVTKLoader":
            data |= read_vtk(data["filename"])
        made = Object(component, {k: self._linked(v) for k, v in data.items()})
        assert made.name not in [own.name for own in self.objects if "name" in data]
        self.objects.append(made)
        return made

    def _linked(self, value):
        """Follow a link like "@loader.position", or check one like "@newton"."""
        if not (isinstance(value, str) and value.startswith("@")):
            return value
        name, _, field = value[1:].partition(".")
        owners = [own for own in self.objects if own.name == name]
        if len(owners) != 1:
            raise ValueError(f"the link {value} leads nowhere")
        return owners[0].data[field] if field else value

    def find(self, component):
        """All components of a class in this node and below."""
        own = [o for o in self.objects if getattr(o, "component", None) == component]
        return own + [o for child in self.children for o in child.find(component)]


def read_vtk(path):
    """Points and tets as the legacy reader of SOFA takes them."""
    lines = Path(path).read_text().split("\n")
    version = float(lines[0].removeprefix("# vtk DataFile Version "))
    assert version < 5, "SOFA cannot read VTK 5"
    assert lines[2] == "ASCII"
    assert lines[3] == "DATASET UNSTRUCTURED_GRID"
    words = " ".join(lines[4:]).split()
    at = {key: words.index(key) for key in ("POINTS", "CELLS", "CELL_TYPES")}
    n_points = int(words[at["POINTS"] + 1])
    start = at["POINTS"] + 3
    points = np.array(words[start : start + 3 * n_points], float).reshape(-1, 3)
    n_cells, size = (int(word) for word in words[at["CELLS"] + 1 : at["CELLS"] + 3])
    assert size == 5 * n_cells, "there are other cells than linear tets"
    start = at["CELLS"] + 3
    cells = np.array(words[start : start + size], int).reshape(-1, 5)
    assert np.all(cells[:, 0] == 4)
    start = at["CELL_TYPES"] + 2
    assert set(words[start : start + n_cells]) == {"10"}
    return {"position": points.tolist(), "tetrahedra": cells[:, 1:].tolist()}


def run(folder, release, monkeypatch, name=None):
    """Build the scene in a folder; returns its root and its monitor."""
    core = types.ModuleType("Sofa.Core")
    core.Controller = Controller
    sofa = types.ModuleType("Sofa")
    sofa.Core = core
    monkeypatch.setitem(sys.modules, "Sofa", sofa)
    monkeypatch.setitem(sys.modules, "Sofa.Core", core)
    if name is None:
        monkeypatch.delenv("SOFTCAL_CONFIGURATION", raising=False)
    else:
        monkeypatch.setenv("SOFTCAL_CONFIGURATION", name)
    spec = importlib.util.spec_from_file_location("scene", Path(folder) / "scene.py")
    scene = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(scene)
    root = Node("root", release)
    scene.createScene(root)
    (monitor,) = [own for own in root.objects if isinstance(own, Controller)]
    return root, monitor
