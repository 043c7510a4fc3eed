"""Compiled programs on the disk: where, when not, and whether they survive a process.

Whether the mesh is in a program, rather than an argument of it, is seen here as well:
such a program would serve no other mesh, and its entry no other project.
"""

import json
import math
import os
import re
import stat
import subprocess
import sys
import warnings

import jax
import platformdirs
import pytest
from small_project import write_small_project
from wording import says

from softcal_jax import use_compilation_cache
from softcal_jax.cli import main
from softcal_jax.project import ProjectError

KEYS = (
    "jax_compilation_cache_max_size",
    "jax_enable_compilation_cache",
    "jax_compilation_cache_dir",
    "jax_persistent_cache_min_compile_time_secs",
)


@pytest.fixture
def config(monkeypatch, tmp_path):
    """JAX's settings as a user has them who set nothing; afterwards as they were."""
    before = {key: jax.config.values[key] for key in KEYS}
    jax.config.update("jax_enable_compilation_cache", True)
    jax.config.update("jax_compilation_cache_dir", None)
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 1.0)
    jax.config.update("jax_compilation_cache_max_size", -1)
    monkeypatch.delenv("JAX_COMPILATION_CACHE_MAX_SIZE", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    yield lambda key: jax.config.values[key]
    for key, value in before.items():
        jax.config.update(key, value)


def test_the_folder_is_in_the_users_cache(config):
    folder = use_compilation_cache()
    assert folder == platformdirs.user_cache_path("softcal_jax", False) / "jax"
    assert folder.is_dir()
    assert config("jax_compilation_cache_dir") == str(folder)
    assert config("jax_persistent_cache_min_compile_time_secs") == 0.0


def test_the_users_folder_is_kept(config, tmp_path):
    """What JAX_COMPILATION_CACHE_DIR says; what a caller names comes first."""
    jax.config.update("jax_compilation_cache_dir", str(tmp_path / "mine"))
    assert use_compilation_cache() == tmp_path / "mine"
    assert use_compilation_cache(tmp_path / "named") == tmp_path / "named"


def test_an_address_is_left_to_jax(config, tmp_path):
    jax.config.update("jax_compilation_cache_dir", "gs://bucket/programs")
    assert use_compilation_cache() is None
    assert config("jax_compilation_cache_dir") == "gs://bucket/programs"
    assert config("jax_enable_compilation_cache")


def test_switched_off_it_stays_off(config, tmp_path):
    jax.config.update("jax_enable_compilation_cache", False)
    assert use_compilation_cache(tmp_path / "named") is None
    assert config("jax_compilation_cache_dir") is None
    assert not (tmp_path / "named").exists()


def test_a_folder_that_cannot_be_written_is_said_once(config, tmp_path):
    (tmp_path / "file").write_text("")
    folder = tmp_path / "file" / "cache"
    text = rf"not kept, .* {re.escape(str(folder))} cannot be "
    with pytest.warns(UserWarning, match=text + r"written \(Not a dir"):
        assert use_compilation_cache(folder) is None
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert use_compilation_cache(folder) is None


posix = pytest.mark.skipif(os.name != "posix", reason="modes and owners of POSIX")


def mode(folder):
    return stat.S_IMODE(folder.stat().st_mode)


def refused(folder, text):
    """Whether a warning says so, and JAX neither reads nor writes programs there."""
    with pytest.warns(UserWarning, match=text):
        assert use_compilation_cache(folder) is None
    return not jax.config.values["jax_enable_compilation_cache"]


@posix
def test_a_new_folder_is_private(config, tmp_path):
    """Whatever the umask; one of the user's that others may read is left as it is."""
    before = os.umask(0o002)
    try:
        assert mode(use_compilation_cache()) == 0o700
        assert mode(use_compilation_cache(tmp_path / "named" / "deep")) == 0o700
    finally:
        os.umask(before)
    (tmp_path / "shown").mkdir(mode=0o755)
    assert mode(use_compilation_cache(tmp_path / "shown")) == 0o755


@posix
@pytest.mark.parametrize("bits", [0o770, 0o707])
def test_a_folder_that_others_may_write_is_refused(config, tmp_path, bits):
    """Also through a link: programs are native code, and somebody else's would run."""
    (tmp_path / "shared").mkdir()
    (tmp_path / "shared").chmod(bits)
    (tmp_path / "link").symlink_to(tmp_path / "shared")
    folder = tmp_path / "link"
    assert refused(folder, rf"link .*mode 0{bits:o}\b.*chmod 700 ")
    assert list(folder.iterdir()) == []


@posix
def test_a_folder_of_another_user_is_refused(config, tmp_path, monkeypatch):
    (tmp_path / "theirs").mkdir()
    uid = os.getuid()
    monkeypatch.setattr(os, "getuid", lambda: uid + 1)
    assert refused(tmp_path / "theirs", rf"theirs .*another user .*uid {uid}\b")


@posix
def test_a_folder_that_anyone_may_replace_is_refused(config, tmp_path):
    """As below a folder for all, unless only owners may rename there, as in /tmp."""
    (tmp_path / "for all").mkdir()
    (tmp_path / "for all").chmod(0o1777)
    assert use_compilation_cache(tmp_path / "for all" / "mine") is not None
    (tmp_path / "for all").chmod(0o777)
    assert refused(tmp_path / "for all" / "mine", "mine .*replaced.*for all")


def three_programs(folder):
    """Three programs of 1000 bytes, and a note; the second was used last."""
    folder.mkdir(mode=0o700)
    for name, used in {"jit_a-1": 100.0, "jit_b-2": 300.0, "jit_c-3": 200.0}.items():
        (folder / f"{name}-cache").write_bytes(bytes(1000))
        os.utime(folder / f"{name}-cache", (used, 50.0))
    (folder / "note.txt").write_bytes(bytes(1000))
    return folder


def kept(folder):
    return sorted(entry.name for entry in folder.iterdir())


@pytest.mark.parametrize(
    ("limit", "left"),
    [("2999", "bc"), ("2000", "bc"), ("1999", "b"), ("3000", "abc"), ("-1", "abc")],
)
def test_the_least_recently_used_programs_go(
    config, tmp_path, monkeypatch, limit, left
):
    """Until the rest is as small as JAX's variable says; files of others stay.

    JAX's own removal would need another package.
    """
    monkeypatch.setenv("JAX_COMPILATION_CACHE_MAX_SIZE", limit)
    jax.config.update("jax_compilation_cache_max_size", int(limit))
    folder = three_programs(tmp_path / "cache")
    for _ in range(2):
        use_compilation_cache(folder)
        assert [name[4] for name in kept(folder) if name != "note.txt"] == list(left)
        assert "note.txt" in kept(folder)
        assert config("jax_compilation_cache_max_size") == -1


def test_by_default_two_gigabytes_are_kept(config, tmp_path):
    """Of a sparse file, which takes no room."""
    folder = three_programs(tmp_path / "cache")
    os.truncate(folder / "jit_a-1-cache", 2_000_000_000)
    os.utime(folder / "jit_a-1-cache", (100.0, 50.0))
    use_compilation_cache(folder)
    assert kept(folder) == ["jit_b-2-cache", "jit_c-3-cache", "note.txt"]


def test_without_a_home_nothing_is_made_where_the_program_runs(
    config, tmp_path, monkeypatch
):
    """As in a container whose user has no entry; "~" is no folder then."""

    def unknown(uid):
        raise KeyError(uid)

    pwd = pytest.importorskip("pwd", reason="Windows knows no such users")
    monkeypatch.setattr(pwd, "getpwuid", unknown)
    for name in ("HOME", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.chdir(tmp_path)
    with pytest.warns(UserWarning, match="no home folder"):
        assert use_compilation_cache() is None
    assert not list(tmp_path.iterdir())


def test_commands_use_it(config, tmp_path, capsys):
    """Also where they go no further than the project file; a problem is a line."""
    missing = str(tmp_path / "no.toml")
    assert main(["identify", missing]) == 2
    assert config("jax_compilation_cache_dir") == str(
        tmp_path / "cache" / "softcal_jax" / "jax"
    )
    capsys.readouterr()
    (tmp_path / "file").write_text("")
    jax.config.update("jax_compilation_cache_dir", str(tmp_path / "file"))
    assert main(["identify", missing]) == 2
    printed = capsys.readouterr().out.replace("\n", "")
    assert printed.count("programs are not kept") == 1
    assert says(printed, "warning: ", "JAX_ENABLE_COMPILATION_CACHE=0")


CALIBRATE = """
import json, sys
from collections import Counter
from pathlib import Path

import jax

from softcal_jax import load_project, use_compilation_cache

events = Counter()
jax.monitoring.register_event_listener(lambda event, **_: events.update([event]))
jax.config.update("jax_enable_x64", True)
use_compilation_cache(Path(sys.argv[2]))
result = load_project(sys.argv[1]).calibrate()
json.dump(
    {
        "asked": events["/jax/compilation_cache/compile_requests_use_cache"],
        "found": events["/jax/compilation_cache/cache_hits"],
        "E": result.value("E"),
        "solver": result.model.solver.name,
        "cost": [entry.cost for entry in result.history],
        "predicted": result.configurations[1].points[0].simulated.tolist(),
    },
    sys.stdout,
)
"""


def fresh_process(project, cache, **environment):
    done = subprocess.run(
        [sys.executable, "-c", CALIBRATE, str(project), str(cache)],
        capture_output=True,
        text=True,
        env={**os.environ, "JAX_ENABLE_COMPILATION_CACHE": "1", **environment},
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout), done.stderr


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """One calibration in two processes: without entries, and with one of them torn."""
    folder = tmp_path_factory.mktemp("cached")
    # 144 tets: more than any table of an element has entries.
    project = write_small_project(folder, ("cells = [3, 1, 1]", "cells = [6, 2, 2]"))
    cache, dump = folder / "cache", folder / "dump"
    first = fresh_process(project, cache, JAX_DUMP_IR_TO=str(dump))
    (torn,) = cache.glob("jit_decide-*-cache")
    torn.write_bytes(torn.read_bytes()[:1000])
    return first, fresh_process(project, cache), dump


@pytest.mark.slow
def test_the_second_process_compiles_nothing_but_what_is_torn(runs):
    """Every program has an entry: none calls the host, whose programs get none.

    Of the torn one, as a killed process leaves it, JAX says so and goes on.
    """
    (first, _), (second, errors), _ = runs
    assert first["asked"] > 20
    assert first["found"] < 5
    assert second["asked"] == first["asked"]
    assert second["found"] == second["asked"] - 1
    assert "Error reading persistent compilation cache entry" in errors


@pytest.mark.slow
def test_programs_from_the_disk_give_the_same(runs):
    """Bit for bit, the sparse solver of another process included."""
    (first, _), (second, _), _ = runs
    for name in ("solver", "E", "cost", "predicted"):
        assert second[name] == first[name]


def test_commands_throw_a_torn_entry_away(config, tmp_path, capsys, monkeypatch):
    """JAX would keep it, and compile the program again in every run."""
    jax.config.update("jax_compilation_cache_dir", str(tmp_path))
    use_compilation_cache(tmp_path)
    torn, other = (tmp_path / f"jit_{n}-0af-cache" for n in ("decide", "decider"))
    torn.write_bytes(b"x")
    other.write_bytes(b"y")

    def meets_it(path, **_):
        warnings.simplefilter("always")
        warnings.warn(
            "Error reading persistent compilation cache entry for 'jit_decide': error: "
            "incomplete data",
            stacklevel=1,
        )
        raise ProjectError("enough")

    monkeypatch.setattr("softcal_jax.project.load_project", meets_it)
    assert main(["identify", str(tmp_path / "project.toml")]) == 2
    assert not torn.exists()
    assert other.exists()
    assert says(
        capsys.readouterr().out, "warning: ... jit_decide ... damaged ... again"
    )


EMITTERS = "--xla_cpu_use_fusion_emitters"


@pytest.mark.parametrize(
    ("stated", "expected"),
    [
        ("", f"{EMITTERS}=0"),
        ("--xla_dump_to=/tmp/x", f"--xla_dump_to=/tmp/x {EMITTERS}=0"),
        (f"{EMITTERS}=true", f"{EMITTERS}=true"),
        # A file, to which none can be added.
        ("/etc/flags_of_xla", "/etc/flags_of_xla"),
    ],
)
def test_programs_compile_quickly_unless_told_otherwise(
    config, tmp_path, monkeypatch, stated, expected
):
    """Where XLA has the older code still; later it would end at the flag."""
    monkeypatch.setenv("XLA_FLAGS", stated)
    if jax.__version_info__ >= (0, 11, 1):
        expected = stated
    for _ in range(2):  # as in a shell that runs commands
        use_compilation_cache(tmp_path)
    assert os.environ["XLA_FLAGS"] == expected
    # Workers of sweeps inherit it, and take back what nobody has stated.
    use_compilation_cache(tmp_path, quickly=False)
    assert os.environ["XLA_FLAGS"] == stated


def constants(text):
    """Sizes of the constants of a program that hold more than one number."""
    for body, shape in re.findall(r'dense<("[^"]*"|[^>]*)> : tensor<((?:\d+x)+)', text):
        if body.startswith(("[", '"')):
            yield math.prod(int(n) for n in shape.split("x")[:-1])


@pytest.mark.slow
def test_the_mesh_is_an_argument_of_every_program(runs):
    *_, dump = runs
    programs = {path.name: path.read_text() for path in dump.glob("*.mlir")}
    assert any("equilibrium_response" in name for name in programs)
    largest = {name: max(constants(text), default=0) for name, text in programs.items()}
    assert max(largest.values()) < 144, largest


def test_the_walk_sees_constants():
    """The test above must have something to judge."""
    table = jax.numpy.arange(500.0) ** 2
    text = jax.jit(lambda x: x + table).lower(table).as_text()
    assert list(constants(text)) == [500]
