"""Text of others on the terminal."""

import io
import sys

import pytest
from rich.progress import Progress, TextColumn
from rich.table import Table
from rich.text import Text

from softcal_jax.cli import main
from softcal_jax.cli._display import PlainConsole

EVIL = "\x1b[2J\x9b\u202e"


def test_control_characters_of_others_reach_no_terminal(tmp_path, capsys):
    """Neither in paths nor in what a file says of itself, nor in wrong usage."""
    path = tmp_path / f"a{EVIL}.toml"
    assert main(["simulate", str(path), "-o", str(tmp_path / "out")]) == 2
    path.write_text('name = "x')
    assert main(["simulate", str(path), "-o", str(tmp_path / f"{EVIL}b")]) == 2
    with pytest.raises(SystemExit):
        main(["simulate", "a", "-o", "b", f"--{EVIL}"])
    said = "".join(capsys.readouterr())
    assert r"a\x1b[2J\x9b\u202e.toml does not exist" in said
    assert r"unrecognized arguments: --\x1b[2J" in said
    assert said.replace("\n", "").isprintable()


def test_tables_and_spinners_show_control_characters():
    file = io.StringIO()
    console = PlainConsole(file=file, force_terminal=True, width=80, color_system=None)
    table = Table(EVIL)
    table.add_row(Text(f"row {EVIL}"))
    console.print(table)
    with Progress(TextColumn("{task.description}"), console=console) as progress:
        progress.add_task(f"task {EVIL}")
    text = file.getvalue()
    for shown in (r"row \x1", r"task \x1"):  # cut to the width of the name as it was
        assert shown in text
    for hidden in EVIL:
        assert f"row {hidden}" not in text
        assert f"task {hidden}" not in text
    assert "\x9b" not in text


def test_characters_that_the_encoding_lacks_are_escaped(tmp_path, monkeypatch):
    """As in the locale C, whose streams take nothing but ASCII."""
    streams = {
        name: io.TextIOWrapper(io.BytesIO(), encoding="ascii", write_through=True)
        for name in ("stdout", "stderr")
    }
    for name, stream in streams.items():
        monkeypatch.setattr(sys, name, stream)
    path = tmp_path / "größe.toml"
    assert main(["simulate", str(path), "-o", str(tmp_path / "out")]) == 2
    sys.stdout.write("±")
    said = {name: stream.buffer.getvalue() for name, stream in streams.items()}
    assert rb"gr\xf6\xdfe.toml does not exist" in said["stderr"]
    assert said["stdout"].endswith(rb"\xb1")
