"""The distribution: what is in it, and a fresh environment that has nothing else."""

import json
import os
import re
import shutil
import subprocess
import sys
import tarfile
import zipfile
from email.parser import Parser
from importlib.util import find_spec
from pathlib import Path

import pytest
from packaging.requirements import Requirement

import softcal_jax

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "softcal_jax"
PYTHONS = ("3.11", "3.12", "3.13")
"""Those that the distribution names."""

missing = [name for name in ("build", "hatchling") if find_spec(name) is None]
pytestmark = pytest.mark.skipif(
    bool(missing),
    reason=f"needs {' and '.join(missing)}; pip install -e '.[dev]' brings them",
)


def run(*command, **options):
    """Run a program to its end; what it printed is in the failure, if it fails."""
    done = subprocess.run(
        [str(part) for part in command], capture_output=True, text=True, **options
    )
    assert done.returncode == 0, f"{command}\n{done.stdout}\n{done.stderr}"
    return done.stdout


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """A folder with the source distribution, and the wheel that was built of it."""
    folder = tmp_path_factory.mktemp("dist")
    run(sys.executable, "-m", "build", "--no-isolation", "-o", folder, ROOT)
    return folder


@pytest.fixture(scope="module")
def wheel(built):
    (path,) = built.glob("*.whl")
    return path


@pytest.fixture(scope="module")
def metadata(wheel):
    with zipfile.ZipFile(wheel) as archive:
        (name,) = (n for n in archive.namelist() if n.endswith(".dist-info/METADATA"))
        return Parser().parsestr(archive.read(name).decode())


def test_the_wheel_of_the_checkout_is_that_of_the_source_distribution(wheel, tmp_path):
    """To the byte; so nothing that the package needs is missing in the latter."""
    build = (sys.executable, "-m", "build", "--no-isolation", "--wheel")
    run(*build, "-o", tmp_path, ROOT)
    assert (tmp_path / wheel.name).read_bytes() == wheel.read_bytes()


def test_the_source_distribution_has_tests_and_docs(built):
    (path,) = built.glob("*.tar.gz")
    with tarfile.open(path) as archive:
        names = {name.partition("/")[2] for name in archive.getnames()}
    for name in ("README.md", "LICENSE", "tests/conftest.py", "docs/conf.py"):
        assert name in names
    others = [name.removeprefix("softcal_jax/results/") for name in names]
    assert not [name for name in others if "results/" in name or ".venv" in name]


def test_all_files_of_the_package_are_in_the_wheel_and_no_others(wheel):
    """Project files, meshes, recordings, the style of pages, `py.typed`."""
    with zipfile.ZipFile(wheel) as archive:
        packed = {n for n in archive.namelist() if ".dist-info/" not in n}
    there = {
        path.relative_to(ROOT).as_posix()
        for path in PACKAGE.rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    assert packed == there
    assert "softcal_jax/py.typed" in packed


def test_what_the_metadata_say(wheel, metadata):
    """Licences with their texts, the versions of Python, a README that is shown."""
    assert metadata["Version"] == softcal_jax.__version__
    assert metadata["License-Expression"] == "Apache-2.0 AND MIT"
    assert metadata["Description-Content-Type"] == "text/markdown"
    assert metadata["Requires-Python"] == f">={PYTHONS[0]}"
    prefix = "Programming Language :: Python :: 3."
    named = [c for c in metadata.get_all("Classifier") if c.startswith(prefix)]
    assert [c.rpartition(" ")[2] for c in named] == list(PYTHONS)
    texts = metadata.get_all("License-File")
    data = {path.parent.name for path in PACKAGE.glob("robots/*/LICENSE*")}
    assert len(texts) == 1 + len(data)
    with zipfile.ZipFile(wheel) as archive:
        packed = archive.namelist()
    for text in texts:
        assert [n for n in packed if n.endswith(f".dist-info/licenses/{text}")]


def interpreter(version):
    """Return a Python of this version on this machine, or None."""
    kept = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv"), "versions")
    names = [sys.executable, shutil.which(f"python{version}")]
    names += sorted(kept.glob(f"{version}.*/bin/python"))
    code = "import ensurepip, sys; print('%d.%d' % sys.version_info[:2])"
    for name in filter(None, names):
        done = subprocess.run([name, "-c", code], capture_output=True, text=True)
        if done.returncode == 0 and done.stdout.strip() == version:
            return name
    return None


@pytest.fixture(scope="module")
def network(tmp_path_factory):
    """Skip where pip reaches no index."""
    fetch = ["download", "-q", "--no-deps", "--retries", "0", "--timeout", "20"]
    folder = tmp_path_factory.mktemp("network")
    done = subprocess.run(
        [sys.executable, "-m", "pip", *fetch, "-d", folder, "hatchling"],
        capture_output=True,
        text=True,
    )
    if done.returncode:
        pytest.skip(f"pip reaches no index: {done.stderr.splitlines()[-1]}")


def lowest(metadata):
    """Return what `pip install -c` reads: the lowest version of each requirement."""
    lines = []
    for text in metadata.get_all("Requires-Dist"):
        asked = Requirement(text)
        if asked.marker is None or asked.marker.evaluate({"extra": ""}):
            least = [spec.version for spec in asked.specifier if spec.operator == ">="]
            lines += [f"{asked.name}=={version}" for version in least]
    return lines


@pytest.fixture
def environment(request, wheel, metadata, tmp_path):
    """Programs of a fresh environment with the wheel, which is gone then: 2 GB."""
    version, _, oldest = request.param.partition(" ")
    python = interpreter(version)
    if python is None:
        pytest.skip(f"no Python {version} here, on the PATH or by pyenv")
    folder, constraints = tmp_path / "venv", tmp_path / "constraints.txt"
    constraints.write_text("\n".join(lowest(metadata) if oldest else []))
    run(python, "-m", "venv", folder)
    env = {**os.environ, "PIP_COMPILE": "0"}  # most of it is never imported
    pip = (folder / "bin/python", "-m", "pip", "install", "-q", "-c", constraints)
    run(*pip, wheel, env=env)
    yield folder / "bin"
    shutil.rmtree(folder)


@pytest.mark.slow
@pytest.mark.usefixtures("network")
@pytest.mark.skipif(os.name == "nt", reason="looks for programs in bin/")
@pytest.mark.parametrize(
    "environment", [*PYTHONS, f"{PYTHONS[0]} lowest"], indirect=True
)
def test_a_fresh_environment_runs_the_demo(environment, tmp_path):
    """With the wheel alone, far from the checkout; with the lowest versions, too."""
    home, cwd = tmp_path / "home", tmp_path / "cwd"
    home.mkdir()
    cwd.mkdir()
    unset = ("PYTHONPATH", "XLA_FLAGS", "JAX_COMPILATION_CACHE_DIR", "XDG_CACHE_HOME")
    env = {name: value for name, value in os.environ.items() if name not in unset}
    user = {"cwd": cwd, "env": {**env, "HOME": str(home)}}
    softcal = environment / "softcal"

    checked = run(environment / "python", "-m", "pip", "check", **user)
    assert "No broken requirements found." in checked
    assert run(softcal, "--version", **user) == f"softcal {softcal_jax.__version__}\n"
    where = "import softcal_jax; print(softcal_jax.__file__)"
    home_of_package = run(environment / "python", "-c", where, **user).strip()
    assert Path(home_of_package).is_relative_to(environment.parent)

    run(softcal, "new", "finger", "--robot", "pneumatic-finger", **user)
    printed = run(softcal, "check", "finger/project.toml", **user)
    assert re.search(r"\bE\b", printed)
    assert (cwd / "finger/project_check.png").stat().st_size > 0

    run(softcal, "demo", "-o", "beam", **user)
    result = json.loads((cwd / "beam/result.json").read_text())
    (E,) = (p for p in result["parameters"] if p["name"] == "E")
    assert result["converged"]
    assert 255e3 < E["value"] < 280e3
    assert {"report.html", "load52.vtu"} <= set(result["files"])
