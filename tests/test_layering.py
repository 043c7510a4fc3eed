"""The direction of imports: a package knows only those above it in this list."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import softcal_jax

ROOT = Path(softcal_jax.__file__).parent

LAYERS = [
    {"_warnings"},
    {
        *("_compilation_cache", "_limits", "_machine", "_names", "_places"),
        *("_process", "_results", "_text", "_typing", "_units"),
    },
    {"_files", "_module"},
    {"_text_table"},
    {"elements"},
    {"mesh"},
    {"materials"},
    {"fields"},
    {"bodies"},
    {"actuators"},
    {"configurations"},
    {"camera"},
    {"equilibrium"},
    {"sensitivity"},
    {"calibration"},
    {"identifiability", "control"},
    {"layouts"},
    {"robots"},
    {"export"},
    {"plotting"},
    {"project"},
    {"sweeps"},
    {"report"},
    {"proposal"},
    {"sofa"},
    {"cli"},
    {"__main__"},
]
LEVEL = {name: level for level, names in enumerate(LAYERS) for name in names}
SHARED = LAYERS[0] | LAYERS[1]

MODULES = sorted(path for path in ROOT.rglob("*.py") if path != ROOT / "__init__.py")


def imported_modules(path: Path):
    """Names of all modules that a file imports, `from` imports with their members."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: imports are absolute here"
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def package_of(path: Path) -> str:
    """First name below `softcal_jax` of a file."""
    return path.relative_to(ROOT).parts[0].removesuffix(".py")


def crossings(path: Path):
    """Imports of other packages of the house: (package, rest of the name)."""
    for name in imported_modules(path):
        house, *rest = name.split(".")
        if house == "softcal_jax" and rest[0] != package_of(path):
            yield rest[0], rest[1:]


def identity(path: Path) -> str:
    return str(path.relative_to(ROOT))


@pytest.mark.parametrize("path", MODULES, ids=identity)
def test_imports_point_upwards(path):
    own = package_of(path)
    assert own in LEVEL, f"give {own!r} its place in LAYERS"
    for other, _ in crossings(path):
        assert other in LEVEL, f"give {other!r} its place in LAYERS"
        assert LEVEL[other] < LEVEL[own], f"{own} must not import {other}"


@pytest.mark.parametrize("path", MODULES, ids=identity)
def test_private_names_stay_at_home(path):
    for other, rest in crossings(path):
        private = [name for name in rest if name.startswith("_")]
        assert other in SHARED or not private, f"{other}.{'.'.join(rest)} is private"


def test_the_walk_sees_imports():
    """The two tests above must have something to judge."""
    newton = ROOT / "equilibrium" / "_newton.py"
    assert {"_results", "configurations"} <= {other for other, _ in crossings(newton)}


def test_every_public_name_exists():
    """What `__all__` lists is there, sorted, and nothing private."""
    for init in ROOT.glob("*/__init__.py"):
        package = __import__(f"softcal_jax.{init.parent.name}", fromlist=["x"])
        names = getattr(package, "__all__", [])
        assert all(hasattr(package, name) for name in names)
        assert len(set(names)) == len(names)
        assert not any(name.startswith("_") for name in names)


def test_the_top_level_is_short():
    """What a notebook needs; the rest is imported from its package."""
    names = softcal_jax.__all__
    assert all(
        hasattr(softcal_jax, name) and name in dir(softcal_jax) for name in names
    )
    assert names == sorted(names)
    assert len(names) <= 50
    with pytest.raises(AttributeError, match="no attribute 'load_projects'"):
        softcal_jax.load_projects  # noqa: B018


def test_importing_the_package_reads_no_project_files():
    """Pydantic and pint take most of a second, which only `load_project` needs."""
    code = (
        "import sys, softcal_jax; "
        "print({'pydantic', 'pint', 'softcal_jax.report'} & set(sys.modules)); "
        "softcal_jax.load_project, softcal_jax.write_results"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == "set()"
