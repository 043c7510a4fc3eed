"""Inputs that must be refused, drawn from a seed: wrong project files."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

Random = np.random.Generator

LARGE = (1e6, 1e9, 1e12, 1e15, 1e18)
WORDS = ("stif", "meshh", "kräfte", "x" * 300, "..", "[x]", "\t", "=1+1", "\u202e")
QUANTITIES = ('"200 kPa"', '"1070 kg/m^3"', '"50 kPa"', '"1 MPa"', '"1 mm"', '"15 mm"')


class Given(NamedTuple):
    """Where an input is made, and of what.

    Attributes:
        folder: A copy of the project, which may be spoilt.
        project: Its project file.
        checkpoint: A checkpoint of its calibration, and of no other.
        rows: Folder of its sweep.
    """

    folder: Path
    project: Path
    checkpoint: Path
    rows: Path


Kind = Callable[[Given, Random], list[str]]
"""Spoils the copy, and returns the words of the command."""

KINDS: dict[str, Kind] = {}
"""The kinds of inputs by name."""


def kind(function: Kind) -> Kind:
    """Add a kind of inputs, by the name of its function."""
    KINDS[function.__name__] = function
    return function


def calibrate(given: Given, *more: str) -> list[str]:
    """The words of a calibration of the project."""
    return ["calibrate", str(given.project), "-o", str(given.folder / "out"), *more]


def edit(given: Given, *changes: tuple[str, str]) -> list[str]:
    """Exchange pieces of the project file; returns the words of its calibration."""
    text = given.project.read_text(encoding="utf-8")
    for old, new in changes:
        if old not in text:
            raise RuntimeError(f"{old!r} is no longer in the demo's project file")
        text = text.replace(old, new, 1)
    given.project.write_text(text, encoding="utf-8")
    return calibrate(given)


def pick(random: Random, options):
    """Draw one of several options."""
    return options[random.integers(len(options))]


@kind
def cut_within_a_text(given, random):
    """Cut within a text."""
    text = given.project.read_bytes()
    lines = [
        i for i, line in enumerate(text.split(b"\n")) if line.startswith(b"name =")
    ]
    kept = b"\n".join(text.split(b"\n")[: pick(random, lines)])
    given.project.write_bytes(kept + b'\nname = "un' + b"u" * random.integers(20))
    return calibrate(given)


@kind
def not_utf8(given, random):
    """Not utf8."""
    text = given.project.read_bytes()
    at = random.integers(len(text))
    bad = bytes(
        random.choice([0xFF, 0xFE, 0xC0, 0xF8], 1 + random.integers(4)).tolist()
    )
    given.project.write_bytes(text[:at] + bad + text[at:])
    return calibrate(given)


@kind
def control_characters(given, random):
    """Control characters."""
    bad = chr(pick(random, [0, 1, 7, 8, 11, 27, 127]))
    return edit(given, ('name = "silicone_beam"', f'name = "a{bad}b"'))


@kind
def unknown_keys(given, random):
    """Unknown keys."""
    table = pick(
        random, ["[mesh]", "[material]", "[markers]", "[settings]", "[newton]"]
    )
    key = json.dumps(pick(random, WORDS))
    return edit(given, (f"\n{table}\n", f"\n{table}\n{key} = {random.integers(9)}\n"))


@kind
def misspelt_keys(given, random):
    """Misspelt keys."""
    key = pick(random, ["law", "density", "field", "lower", "std", "gravity", "tol"])
    at = random.integers(len(key))
    wrong = key[:at] + pick(random, ["q", "_", "ß"]) + key[at + 1 :]
    wrong = wrong if wrong.isascii() else json.dumps(wrong)
    return edit(given, (f"\n{key} = ", f"\n{wrong} = "))


@kind
def missing_keys(given, random):
    """Missing keys."""
    key = pick(random, ["law", "E", "nu", "density", "field", "lower", "upper"])
    return edit(given, (f"\n{key} = ", f"\n# {key} = "))


@kind
def missing_tables(given, random):
    """Missing tables."""
    table = pick(random, ["mesh", "material", "shared", "markers.positions"])
    text = given.project.read_text(encoding="utf-8")
    begin = text.index(f"\n[{table}]\n")
    given.project.write_text(text[:begin] + text[text.index("\n[", begin + 1) :])
    return calibrate(given)


@kind
def wrong_dimensions(given, random):
    """Wrong dimensions."""
    wrong = [
        f'"{random.integers(1, 99)} {u}"' for u in ("K", "s", "kg", "kelvin*s", "mol")
    ]
    return edit(given, (pick(random, QUANTITIES), pick(random, wrong)))


@kind
def unknown_units(given, random):
    """Unknown units."""
    unit = pick(
        random, ["kpa", "Pascals!", "mmm", "^", "m/", "µ", "()", "kPa kPa kPa(", ""]
    )
    return edit(given, (pick(random, QUANTITIES), f'"3 {unit}"'))


@kind
def numbers_that_are_none(given, random):
    """Numbers that are none."""
    word = pick(
        random, ["nan", "inf", "-inf", "1e999", "--3", "3..1", "0x", "1_", "1,5e"]
    )
    old = pick(random, QUANTITIES)
    return edit(given, (old, f'"{word} {old.strip(chr(34)).split()[1]}"'))


@kind
def floats_that_are_none(given, random):
    """Floats that are none."""
    where = pick(
        random, ["nu = 0.499", "tol = 1e-6", "rtol = 1e-8", "step_bound = 1.0"]
    )
    key = where.split()[0]
    return edit(
        given, (where, f"{key} = {pick(random, ['nan', 'inf', '-inf', '-1.0'])}")
    )


@kind
def negative_quantities(given, random):
    """Negative quantities."""
    old = pick(random, ['E = "200', 'density = "1070', 'std = "1 ', 'size = "(100'])
    return edit(given, (old, old.replace('"', '"-').replace("-(", "(-")))


@kind
def bare_numbers(given, random):
    """Bare numbers."""
    value = float(10.0 ** random.uniform(-300, 300))
    return edit(given, (pick(random, QUANTITIES), repr(value)))


@kind
def numbers_too_large(given, random):
    """Numbers too large."""
    n = int(pick(random, LARGE) * random.uniform(1.0, 9.0))
    change = pick(
        random,
        [
            ("cells = [14, 4, 4]", f"cells = [{n}, {n}, 1]"),
            ("[settings]\n", f"[settings]\nstarts = {n}\n"),
            ("max_steps = 50", f"max_steps = {n * 10**4}"),
            ("[newton]\n", f"[newton]\nmax_steps = {n * 10**4}\n"),
            ('E = "200 kPa"', f'E = "1e{n} kPa"'),
        ],
    )
    return edit(given, change)


@kind
def wrong_types(given, random):
    """Wrong types."""
    old = pick(
        random,
        [
            '"neo-hookean"',
            '"200 kPa"',
            "0.499",
            "[14, 4, 4]",
            '"linear"',
            "1e-6",
            "50\n",
        ],
    )
    new = pick(
        random, ["1979-05-27", "true", "[[]]", "{ a = 1 }", '["x"]', "07:32:00", "[{}]"]
    )
    return edit(given, (f"= {old}", f"= {new}" + "\n" * old.endswith("\n")))


@kind
def deep_nesting(given, random):
    """Deep nesting."""
    n = int(random.integers(200, 4900))
    open_, close = pick(random, [("[", "]"), ("{a=", "}"), ("[{a=", "}]")])
    return edit(given, ("[newton]\n", f"[newton]\nx = {open_ * n}1{close * n}\n"))


@kind
def keys_twice(given, random):
    """Keys twice."""
    line = pick(random, ["law", "E", "nu", "density", "field", "lower"])
    return edit(given, (f"\n{line} = ", f"\n{line} = 1\n{line} = "))


@kind
def bounds_that_cannot_be(given, random):
    """Bounds that cannot be."""
    lower = 10.0 ** random.uniform(3.1, 9.0)
    return edit(given, ('lower = "50 kPa"', f'lower = "{lower:.6g} kPa"'))


@kind
def unknown_names(given, random):
    """Unknown names."""
    change = pick(
        random,
        [
            ('group = "x_min"', "group = {}"),
            ('markers = ["1", "2", "3"]', "markers = [{}]"),
            ('edge = "tip_edge"', "edge = {}"),
            ('field = "E"', "field = {}"),
            ('role = "validation"', "role = {}"),
            ('file = "markers.csv"', "file = {}"),
            ('law = "neo-hookean"', "law = {}"),
        ],
    )
    return edit(given, (change[0], change[1].format(json.dumps(pick(random, WORDS)))))
