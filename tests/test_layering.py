"""The direction of imports: a package knows only those above it in this list."""

import ast
import functools
from collections.abc import Mapping, Sequence
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

import softcal_jax

ROOT = Path(softcal_jax.__file__).parent

LAYERS = [
    {"_notebook", "_places", "_process", "_results", "_text", "_typing"},
    {"_apart", "_units"},
    {"_lanes", "_module"},
    {"_files"},
    {"_compilation_cache"},
    {"elements"},
    {"mesh"},
    {"contact"},
    {"materials"},
    {"bodies"},
    {"actuators"},
    {"configurations"},
    {"equilibrium"},
    {"fields"},
    {"sensitivity"},
    {"inference"},
    {"unknowns"},
    {"calibration"},
    {"identifiability", "control", "mistakes", "readings"},
    {"designs", "layouts"},
    {"robots"},
    {"plotting"},
    {"exchange.cad", "exchange.camera"},
    {"project"},
    {"sweeps"},
    {"results"},
    {"exchange._formats"},
    {
        *("exchange.icesl", "exchange.inp", "exchange.mujoco"),
        *("exchange.proposal", "exchange.sofa"),
    },
    {"exchange.exporters"},
    {"cli"},
    {"__main__"},
]
LEVEL = {name: level for level, names in enumerate(LAYERS) for name in names}
SHARED = LAYERS[0] | LAYERS[1]

WITHOUT_LAYER = {ROOT / "__init__.py", ROOT / "exchange" / "__init__.py"}
"""The list of public names, and a docstring."""

MODULES = sorted(set(ROOT.rglob("*.py")) - WITHOUT_LAYER)


@functools.cache
def imported_modules(path: Path) -> list[str]:
    """Names of all modules that a file imports, `from` imports with their members."""
    modules = []
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            modules += (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: imports are absolute here"
            modules += (f"{node.module}.{alias.name}" for alias in node.names)
        elif isinstance(node, ast.Call) and node.args:
            called = getattr(node.func, "attr", getattr(node.func, "id", ""))
            if called in ("import_module", "__import__"):
                name = node.args[0]
                if isinstance(name, ast.Constant):
                    modules.append(name.value)
    return modules


def package_of(path: Path) -> str:
    """First name below `softcal_jax` of a file; of the wing with its folder."""
    return split(path.relative_to(ROOT).with_suffix("").parts)[0]


def split(names: Sequence[str]) -> tuple[str, Sequence[str]]:
    """Split names below `softcal_jax` into a package and what is in it."""
    n = 2 if names[0] == "exchange" else 1
    return ".".join(names[:n]), names[n:]


def crossings(path: Path):
    """Imports of other packages of the house: (package, rest of the name)."""
    for name in imported_modules(path):
        house, *names = name.split(".")
        if house == "softcal_jax":
            package, rest = split(names)
            if package != package_of(path):
                yield package, rest


@pytest.mark.parametrize("package", sorted({package_of(path) for path in MODULES}))
def test_a_package_imports_from_above_and_nothing_private(package):
    assert package in LEVEL, f"give {package!r} its place in LAYERS"
    for path in MODULES:
        if package_of(path) != package:
            continue
        for other, rest in crossings(path):
            assert other in LEVEL, f"give {other!r} its place in LAYERS"
            assert LEVEL[other] < LEVEL[package], f"{path} must not import {other}"
            private = [name for name in rest if name.startswith("_")]
            imported = f"{other}.{'.'.join(rest)}"
            assert other in SHARED or not private, f"{path}: {imported} is private"


FILES = {
    ".".join(path.relative_to(ROOT.parent).with_suffix("").parts): path
    for path in ROOT.rglob("*.py")
}
FILES = {name.removesuffix(".__init__"): path for name, path in FILES.items()}
"""Files by the names of their modules."""


def needs(module: str, files: Mapping[str, Path]):
    """Modules that run, or are looked at by a type checker, before one is complete.

    To import `a.b.c` also runs `a` and `a.b`, unless the importing module is in them.
    """
    for name in imported_modules(files[module]):
        parts = name.split(".")
        while parts and ".".join(parts) not in files:  # a class, or a foreign package
            parts.pop()
        for n in range(len(parts), 0, -1):
            other = ".".join(parts[:n])
            holds_module = f"{module}.".startswith(f"{other}.")
            if n == len(parts) or not holds_module:
                yield other


def circle(files: Mapping[str, Path]) -> list[str]:
    """Modules of which each imports the next, the last one the first; [] if none do."""
    graph = {module: set(needs(module, files)) for module in files}
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        return error.args[1]
    return []


def test_no_imports_go_in_a_circle():
    """Neither between files, nor by imports in functions, by name, or for types."""
    assert circle(FILES) == []


@pytest.mark.parametrize(
    "back",
    [
        "from softcal_jax.b import thing",
        "def f():\n    import softcal_jax.b",
        "if TYPE_CHECKING:\n    from softcal_jax import b",
        "from importlib import import_module\nimport_module('softcal_jax.b').thing",
        "import softcal_jax.c.d",  # runs c, which imports b
    ],
)
def test_circles_are_seen(tmp_path, back):
    files = {}
    for name, text in {
        "softcal_jax": "import softcal_jax.a",
        "softcal_jax.a": back,
        "softcal_jax.b": "from softcal_jax.a import thing",
        "softcal_jax.c": "from softcal_jax.b import thing",
        "softcal_jax.c.d": "import numpy",
    }.items():
        files[name] = tmp_path / f"{name}.py"
        files[name].write_text(text)
    assert {"softcal_jax.a", "softcal_jax.b"} <= set(circle(files))
    files["softcal_jax.a"] = tmp_path / "harmless.py"
    files["softcal_jax.a"].write_text("import numpy")
    assert circle(files) == []


def test_the_walk_sees_imports():
    """The tests above must have something to judge."""
    solve = ROOT / "equilibrium" / "_solve.py"
    assert {"_results", "configurations"} <= {other for other, _ in crossings(solve)}


def test_packages_offer_their_names_as_themselves():
    """So that type checkers and readers know a name that is offered from one in use."""
    for init in ROOT.glob("**/__init__.py"):
        package = ".".join(init.parent.relative_to(ROOT.parent).parts)
        for node in ast.parse(init.read_text()).body:
            if isinstance(node, ast.ImportFrom):
                offered = [name.asname == name.name for name in node.names]
                if f"{package}._" in str(node.module):
                    assert all(offered), init
                elif "._" not in str(node.module):  # another package has pages for it
                    assert not any(offered), init


def test_the_top_level_is_short():
    """What a notebook needs; the rest is imported from its package."""
    names = softcal_jax.__all__
    assert all(
        hasattr(softcal_jax, name) and name in dir(softcal_jax) for name in names
    )
    assert names == sorted(names)
    assert len(names) <= 59
    with pytest.raises(AttributeError, match="no attribute 'load_projects'"):
        softcal_jax.load_projects  # noqa: B018
