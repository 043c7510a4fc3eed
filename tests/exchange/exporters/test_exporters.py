"""`softcal export` writes what installed packages register, too."""

from types import SimpleNamespace

import pytest
from wording import says

from softcal_jax.cli import main
from softcal_jax.exchange.exporters import ExporterWarning, exporters

PACKAGE = """
from softcal_jax.exchange.exporters import AbstractExporter


class Names(AbstractExporter):
    writes = "names of the parameters"
    description = "One name a line."
    cannot_hold = "parameters without a name"
    output = "FILE.txt", "the file"
    next_step = "read it"

    def add_options(self, command):
        command.add_argument("--upper", action="store_true", help="in capitals")

    def write(self, source, output, options, progress):
        if options.upper:
            raise ValueError("names have no capitals; leave --upper out.")
        progress.begins("writing names")
        output.write_text("\\n".join(source.values))
        progress.computed(f"{len(source.values)} names")
        return ["values are not written"]


class NoExporter:
    pass
"""


@pytest.fixture
def install(tmp_path, monkeypatch):
    """Install a package with these entry points, by name."""

    def write(points):
        folder = tmp_path / "site"
        about = folder / "strangers_formats-1.0.dist-info"
        about.mkdir(parents=True)
        (folder / "strangers_formats.py").write_text(PACKAGE)
        head = "Metadata-Version: 2.1\nName: strangers_formats\nVersion: 1.0\n"
        (about / "METADATA").write_text(head)
        lines = [f"{name} = {value}" for name, value in points.items()]
        lines = ["[softcal_jax.exporters]", *lines]
        (about / "entry_points.txt").write_text("\n".join(lines))
        monkeypatch.syspath_prepend(folder)

    return write


@pytest.fixture
def names(install):
    install({"names": "strangers_formats:Names"})


@pytest.mark.usefixtures("names")
def test_help_lists_what_is_installed(capsys):
    with pytest.raises(SystemExit):
        main(["export", "--help"])
    text = capsys.readouterr().out
    for name in ("inp", "sofa", "mujoco", "icesl"):
        assert f"    {name} " in text
    assert "names of the parameters" in text
    with pytest.raises(SystemExit):
        main(["export", "names", "--help"])
    text = " ".join(capsys.readouterr().out.split())
    assert "One name a line." in text
    assert "--upper" in text
    assert "parameters without a name." in text


LOADED = SimpleNamespace(
    project=SimpleNamespace(calibration=(), parameters=(), settings=None),
    values={"E": 1.0, "nu": 0.3},
    content={"assessment": {"reasons": ["few data"]}},
)
"""What the command needs of a result that is loaded."""


@pytest.mark.usefixtures("names")
def test_what_is_installed_writes(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("softcal_jax.results.load_result", lambda *a, **k: LOADED)
    file = tmp_path / "names.txt"
    argv = ["export", "names", "results", "-o", str(file)]
    assert main([*argv, "--upper"]) == 2
    assert "leave --upper out" in capsys.readouterr().err
    assert not file.exists()
    assert main(argv) == 0
    assert file.read_text() == "E\nnu"
    text = capsys.readouterr().out
    notes = "Note: values are not written ... Note: ... few data"
    assert says(text, "2 names", notes, f"Wrote {file}; read it.")
    assert main(argv) == 2
    assert "--force" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("name", "value", "reason"),
    [
        ("sofa", "strangers_formats:Names", "has this name"),
        ("names", "strangers_formats:NoExporter", "AbstractExporter"),
        ("names", "strangers_formats:Missing", "'Missing'"),
        ("names", "not_installed:Names", "not_installed"),
    ],
)
def test_what_cannot_be_used_is_left_out(install, name, value, reason):
    """It keeps nobody from the other formats."""
    install({name: value})
    with pytest.warns(ExporterWarning, match=rf"'{name}' .*left out.*{reason}"):
        known = exporters()
    assert list(known) == ["inp", "sofa", "mujoco", "icesl"]
