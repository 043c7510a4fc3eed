"""Figures of a fresh run against those of the committed record."""

import json
import math
import statistics
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple

from benchmarks._problem import TIMES, Better, Figure, Goal, unit_of, usual_better

RECORDS = Path(__file__).with_name("records")
"""Where the committed records are."""

LEAST = 0.05
"""Least relative change of a measured figure that counts [-].

From one process to the next, memory and cores fall differently; the samples of one
process do not show that.
"""

UNSAMPLED = 0.10
"""The same for a measured figure without samples of its own [-]."""

OTHER_DAY = 1.0
"""The same for a bare time [-].

One machine is twice as fast on one day as on another, where others share its processor.
Ratios of times that were measured in one run are what shows a smaller change.
"""

Verdict = Literal["worse", "better", "same", "changed", "new", "gone"]

WORSE: tuple[Verdict, ...] = ("worse", "gone")
"""What is not measured any more could hide anything, and counts as worse."""

_KEYS = ("name", "hardware", "versions", "figures", "goals", "samples")


class BadRecord(ValueError):
    """A file is no record of a benchmark, or there is none to compare with."""


class Change(NamedTuple):
    """One figure, then and now.

    Attributes:
        figure: Its name.
        before: Its value in the record; None if it was not there.
        now: Its value in the fresh run; None if it is not there.
        ratio: Now over before; None for words, signs that differ, and zero.
        allowed: Relative change that is not told from noise [-].
        better: Which way is better.
        verdict: "changed" is a change of which neither way is better.
    """

    figure: str
    before: Figure | None
    now: Figure | None
    ratio: float | None
    allowed: float
    better: Better
    verdict: Verdict


class Comparison(NamedTuple):
    """A fresh run beside its record.

    Attributes:
        name: Name of the problem.
        changes: One entry per figure, in the order of the fresh run.
        warnings: What makes them hard to compare: machine, versions, load.
    """

    name: str
    changes: tuple[Change, ...]
    warnings: tuple[str, ...]

    @property
    def worse(self) -> list[Change]:
        """What somebody must look at."""
        return [change for change in self.changes if change.verdict in WORSE]


def read_record(path: Path) -> dict[str, Any]:
    """A record that `run --json` wrote.

    Args:
        path: The file.

    Raises:
        BadRecord: If it is not there, or is something else.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise BadRecord(f"{path} cannot be read: {error.strerror}.") from error
    except ValueError as error:
        raise BadRecord(f"{path} is no JSON: {error}.") from error
    missing = [k for k in _KEYS if not isinstance(content, dict) or k not in content]
    if missing:
        raise BadRecord(
            f"{path} is no record of a benchmark: it has no {', '.join(missing)}. "
            "`python -m benchmarks run NAME --json FILE` writes one."
        )
    return content


def fresh_files(paths: Sequence[Path]) -> list[Path]:
    """Files as given, and all JSON files of the folders among them.

    Raises:
        BadRecord: If a folder holds none, or is not there.
    """
    records: list[Path] = []
    for path in paths:
        files = sorted(path.glob("*.json")) if path.is_dir() else [path]
        if not files:
            raise BadRecord(
                f"{path} holds no records; `python -m benchmarks run --all` writes "
                "one per problem."
            )
        records += files
    return records


def compare(before: Mapping[str, Any], now: Mapping[str, Any]) -> Comparison:
    """Judge every figure of two records of one problem.

    Args:
        before: The committed record.
        now: The record of the fresh run; it knows which way is better.

    Raises:
        BadRecord: If they are of different problems.
    """
    if before["name"] != now["name"]:
        raise BadRecord(
            f"the record is of {before['name']!r}, the fresh run of {now['name']!r}."
        )
    names = [
        *now["figures"],
        *(n for n in before["figures"] if n not in now["figures"]),
    ]
    changes = tuple(_change(name, before, now) for name in names)
    return Comparison(now["name"], changes, tuple(_warnings(before, now)))


def _change(name: str, before: Mapping[str, Any], now: Mapping[str, Any]) -> Change:
    old, new = before["figures"].get(name), now["figures"].get(name)
    better = _better(name, before, now)
    ratio = _ratio(old, new)
    allowed = _allowed(name, before, now)
    if new is None:
        verdict: Verdict = "gone"
    elif old is None:
        verdict = "new"
    elif isinstance(old, str) or isinstance(new, str):
        verdict = _of_words(old, new, better)
    elif better == "between":
        verdict = _of_range(old, new, now["goals"][name]["goal"])
    else:
        verdict = _of_numbers(old, new, allowed, better)
    return Change(name, old, new, ratio, allowed, better, verdict)


def _better(name: str, before: Mapping[str, Any], now: Mapping[str, Any]) -> Better:
    """What the fresh record says; older ones said nothing, and the usual holds."""
    record = now if name in now["figures"] else before
    if "better" in record:
        return record["better"][name]
    goal = record["goals"].get(name)
    return usual_better(name, None if goal is None else Goal.read(goal["goal"]))


def _of_words(old: Figure, new: Figure, better: Better) -> Verdict:
    """A number that became a word, like "not reached", is lost."""
    if old == new:
        return "same"
    if better == "either" or isinstance(old, str) == isinstance(new, str):
        return "changed"
    return "worse" if isinstance(new, str) else "better"


def _of_range(old: float, new: float, text: str) -> Verdict:
    goal = Goal.read(text)
    if goal.met(old) == goal.met(new):
        return "same"
    return "better" if goal.met(new) else "worse"


def _of_numbers(old: float, new: float, allowed: float, better: Better) -> Verdict:
    if abs(new - old) <= allowed * abs(old):
        return "same"
    if better == "either":
        return "changed"
    return "better" if (new > old) == (better == "higher") else "worse"


def _ratio(old: Figure | None, new: Figure | None) -> float | None:
    if old is None or new is None or isinstance(old, str) or isinstance(new, str):
        return None
    return new / old if old * new > 0.0 else None


def _allowed(name: str, before: Mapping[str, Any], now: Mapping[str, Any]) -> float:
    """Relative change of a figure that is not told from noise [-].

    Nothing for a count, and for a time what the machine does by itself. Otherwise half
    the quartile range of the samples of either run, added up, so that a change counts
    where the middle halves of the samples do not touch.
    """
    if unit_of(name) in TIMES:
        return OTHER_DAY
    values = [record["figures"].get(name) for record in (before, now)]
    if all(isinstance(value, int) for value in values):
        return 0.0
    spreads = [_spread(name, record["samples"]) for record in (before, now)]
    known = [spread for spread in spreads if spread is not None]
    return max(LEAST, math.fsum(known)) if known else UNSAMPLED


def _spread(name: str, samples: Mapping[str, Sequence[float]]) -> float | None:
    """Half the quartile range of the samples of that name over their median [-]."""
    values = samples.get(name)
    if values is None or len(values) < 2:
        return None
    low, middle, high = statistics.quantiles(values, n=4, method="inclusive")
    return 0.5 * (high - low) / abs(middle) if middle else None


def _warnings(before: Mapping[str, Any], now: Mapping[str, Any]) -> list[str]:
    warnings = []
    for what in ("hardware", "versions"):
        for key in sorted({*before[what], *now[what]} - {"load_before", "commit"}):
            old, new = (record[what].get(key) for record in (before, now))
            if old != new:
                warnings.append(f"{what}: {key} is {new}, was {old}")
    load, cores = now["hardware"].get("load_before"), now["hardware"]["cores"]
    if load is not None and load > 0.5 * cores:
        warnings.append(
            f"the machine was busy before the run: load {load:.1f} on {cores} cores"
        )
    return warnings
