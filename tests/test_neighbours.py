"""Calibrations beside other programs, and in environments as users have them.

Each runs in a process of its own: what torch, a fork or the locale leave behind belongs
to the process.
"""

import ctypes
import importlib.util
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import nbformat
import neighbours
import pytest
from nbclient import NotebookClient
from small_project import E_TRUE, write_small_project
from wording import says

TESTS = Path(__file__).parent
COMMAND = "import sys; from softcal_jax.cli import main; sys.exit(main())"


@pytest.fixture(autouse=True)
def _threads_as_users_have_them(monkeypatch):
    """Several, where tests have one."""
    for name in ("MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        monkeypatch.delenv(name, raising=False)


linux = pytest.mark.skipif(sys.platform != "linux", reason="Linux alone has it")


def run(argv, **options):
    """A finished process, without whose success the test ends with what it printed."""
    done = subprocess.run(
        [sys.executable, *argv], capture_output=True, text=True, timeout=300, **options
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done


def moduli(scenario, folder, **options):
    """Moduli that a scenario of `neighbours` finds."""
    done = run([neighbours.__file__, scenario, str(folder)], **options)
    return json.loads(done.stdout)


def needs(package):
    """Skips without a package that only this asks for."""
    missing = importlib.util.find_spec(package) is None
    return pytest.mark.skipif(missing, reason=f"{package} is not installed")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("scenario", "n"),
    [
        pytest.param("torch_before", 2, marks=needs("torch")),
        pytest.param("torch_after", 2, marks=needs("torch")),
        ("numpy_threads", 1),
        ("two_threads", 4),
        ("event_loop", 2),
        ("float32_later", 2),
        ("joblib_processes", 3),
        ("joblib_threads", 3),
        pytest.param("fork_before", 2, marks=linux),
        pytest.param("fork_after", 2, marks=linux),
    ],
)
def test_beside_another_user_of_the_process(scenario, n, tmp_path):
    estimates = moduli(scenario, tmp_path)
    assert estimates == [pytest.approx(E_TRUE, rel=1e-8)] * n


@pytest.mark.slow
@needs("torch")
def test_torch_changes_the_number_of_threads(tmp_path):
    """PARDISO keeps its own: a factorization with fewer than its analysis crashes."""
    estimates = moduli("torch_threads", tmp_path)
    assert estimates == [pytest.approx(estimates[0], rel=1e-10)] * 3


@pytest.mark.slow
@pytest.mark.parametrize("threads", ["1", "8"])
def test_the_number_of_openmp_threads(threads, tmp_path):
    environment = os.environ | {"OMP_NUM_THREADS": threads}
    (estimate,) = moduli("alone", tmp_path, env=environment)
    assert estimate == pytest.approx(E_TRUE, rel=1e-8)


@pytest.mark.slow
def test_a_kernel_of_jupyter(tmp_path):
    """It runs an event loop of its own in the main thread, and threads beside it."""
    cell = f"""import sys
sys.path.insert(0, {str(TESTS)!r})
import neighbours
print(*neighbours.alone({str(tmp_path)!r}), *neighbours.two_threads({str(tmp_path)!r}))
"""
    notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(cell)])
    NotebookClient(notebook, timeout=300, kernel_name="python3").execute()
    (printed,) = notebook.cells[0].outputs
    assert printed.name == "stdout", printed.text
    estimates = [float(word) for word in printed.text.split()]
    assert estimates == [pytest.approx(E_TRUE, rel=1e-8)] * 5


WITH_HOMES = ("HOME", "XDG_CACHE_HOME", "XDG_CONFIG_HOME", "JAX_COMPILATION_CACHE_DIR")


def command(folder, *, unset=(), code="", before=None, **environment):
    """What `softcal calibrate` prints in an environment; its results are checked."""
    path = write_small_project(folder)
    env = {k: v for k, v in os.environ.items() if k not in unset} | environment
    done = run(
        ["-c", code + COMMAND, "calibrate", path.name, "-o", "Maße, neu"],
        env=env, cwd=folder, encoding="utf-8", errors="replace", preexec_fn=before,
    )  # fmt: skip
    # Without a home Matplotlib says where it keeps its own files instead.
    assert [line for line in done.stderr.splitlines() if "atplotlib" not in line] == []
    result = json.loads((folder / "Maße, neu" / "result.json").read_text("utf-8"))
    assert result["parameters"][0]["value"] == pytest.approx(E_TRUE, rel=1e-8)
    assert (folder / "Maße, neu" / "report.html").exists()
    # Nothing lies about beside what was asked for.
    there = {p.name for p in folder.iterdir()}
    assert there == {"project.toml", "markers.csv", "Maße, neu"}
    return " ".join(done.stdout.split())


@pytest.mark.slow
def test_without_a_home(tmp_path):
    """As in a container whose user has no entry: nowhere to keep compiled programs."""
    nobody = """
import pwd
def unknown(uid):
    raise KeyError(uid)
pwd.getpwuid = unknown
"""
    printed = command(tmp_path, code=nobody, unset=WITH_HOMES)
    assert says(printed, "programs are not kept", "JAX_COMPILATION_CACHE_DIR")


def _without_root():
    """Give up what lets root write everywhere."""
    drop_from_bounding_set, write_anywhere = 24, 1  # linux/prctl.h, capability.h
    ctypes.CDLL(None).prctl(drop_from_bounding_set, write_anywhere)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:os.fork")  # what JAX says of `before`
@linux
def test_with_a_home_that_cannot_be_written(tmp_path):
    home = tmp_path / "home"
    home.mkdir(mode=0o555)
    printed = command(
        tmp_path / "project", unset=WITH_HOMES, HOME=str(home), before=_without_root
    )
    assert says(printed, "programs are not kept", "Permission denied")
    assert not list(home.iterdir())


@pytest.mark.slow
def test_in_the_locale_c(tmp_path):
    """With the ASCII that it had before UTF-8."""
    ascii_alone = {"PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    assert "300.00 kPa" in command(tmp_path, LC_ALL="C", **ascii_alone)


@pytest.mark.slow
def test_in_a_german_locale(tmp_path):
    """Whose decimal comma some libraries take from the process."""
    compiler = shutil.which("localedef")
    if compiler is None:
        pytest.skip("localedef is not installed")
    made = [compiler, "-i", "de_DE", "-f", "UTF-8", str(tmp_path / "de_DE.UTF-8")]
    if subprocess.run(made, capture_output=True).returncode:
        pytest.skip("the definition of de_DE is not installed")
    assert "300.00 kPa" in command(
        tmp_path / "project",
        code="import locale; locale.setlocale(locale.LC_ALL, ''); "
        "assert locale.localeconv()['decimal_point'] == ','\n",
        LOCPATH=str(tmp_path),
        LC_ALL="de_DE.UTF-8",
    )


@pytest.mark.slow
def test_in_a_path_with_blanks_and_umlauts(tmp_path):
    command(tmp_path / "Prüfstand, größer" / "ein Ärmel")


@pytest.mark.slow
def test_without_a_display(tmp_path):
    command(tmp_path, unset=("DISPLAY", "WAYLAND_DISPLAY", "MPLBACKEND"))
