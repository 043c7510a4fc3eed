"""What a benchmark is given, what it returns, and how it is found."""

import ast
import difflib
import importlib
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType
from typing import Literal, NamedTuple, get_args

Figure = float | int | str
"""A number, or a word."""

Better = Literal["higher", "lower", "between", "either"]
"""Which change of a figure is one for the better; "between": into the goal's range."""

TIMES = {"s", "ms", "us"}
"""Last words of names of times."""

COSTS = TIMES | {"bytes", "kb", "mb", "gb"}
"""The same of times and memory, of which less is better."""


@dataclass(frozen=True)
class Options:
    """How a problem is run.

    Attributes:
        output: Folder for pictures and other files of the problem.
        say: Tells the user what is being done.
        counts: Which parts are run, and how many times each; empty for all, as often
            as the problem's own `COUNTS` say.
    """

    output: Path
    say: Callable[[str], None] = print
    counts: Mapping[str, int] = field(default_factory=dict)

    def folder(self) -> Path:
        """The output folder, made when the first problem writes into it."""
        self.output.mkdir(parents=True, exist_ok=True)
        return self.output


Sense = Literal["at least", "at most", "between"]
"""Which side of a bound is meant."""


class Goal(NamedTuple):
    """What a figure is meant to be.

    Attributes:
        sense: Which side of the bound, or "between" it and `upper`.
        bound: The bound; it meets the goal.
        upper: Upper end of a range; it meets the goal.
    """

    sense: Sense
    bound: float
    upper: float = math.inf

    def met(self, value: Figure) -> bool:
        """Whether a figure reaches the goal; a word never does."""
        if isinstance(value, str):
            return False
        if self.sense == "between":
            return self.bound <= value <= self.upper
        return value >= self.bound if self.sense == "at least" else value <= self.bound

    def __str__(self) -> str:
        if self.sense == "between":
            return f"between {self.bound:g} and {self.upper:g}"
        return f"{self.sense} {self.bound:g}"

    @classmethod
    def read(cls, text: str) -> "Goal":
        """The goal that `str` wrote, as records hold it."""
        match = re.fullmatch(r"(at least|at most|between) (\S+?)(?: and (\S+))?", text)
        if match is None:
            raise ValueError(f"{text!r} is no goal, like 'at least 3'.")
        sense, bound, upper = match.groups()
        senses: dict[str, Sense] = {known: known for known in get_args(Sense)}
        return cls(senses[sense], float(bound), float(upper or math.inf))


class Table(NamedTuple):
    """A table for a person to read; the cells are formatted already."""

    title: str
    columns: Sequence[str]
    rows: Sequence[Sequence[str]]


@dataclass(frozen=True)
class Outcome:
    """What a problem found.

    Attributes:
        figures: The results, flat: name to a finite number or a word.
        samples: The raw repeats behind them, name to values.
        goals: What some of the figures are meant to be.
        tables: The results again, for a person to read.
        better: Which way is better, where the goal and the name of a figure do not
            tell: "either" for the time of another program.
    """

    figures: Mapping[str, Figure]
    samples: Mapping[str, Sequence[float]] = field(default_factory=dict)
    goals: Mapping[str, Goal] = field(default_factory=dict)
    tables: Sequence[Table] = ()
    better: Mapping[str, Better] = field(default_factory=dict)

    def __post_init__(self):
        for name, value in self.figures.items():
            if isinstance(value, str):
                continue
            if isinstance(value, bool) or not isinstance(value, int | float):
                raise TypeError(
                    f"figure {name!r} must be a number or a word, got {value!r}."
                )
            if not math.isfinite(value):
                raise ValueError(
                    f"figure {name!r} is {value}; JSON has no such number. Leave it "
                    "out, or use a word."
                )
        for what, names in (("goal", self.goals), ("better", self.better)):
            for name in names:
                if name not in self.figures:
                    raise ValueError(f"{what} {name!r} belongs to no figure.")

    def better_of(self, name: str) -> Better:
        """Which change of a figure is one for the better.

        Args:
            name: Name of the figure.
        """
        return self.better.get(name) or usual_better(name, self.goals.get(name))


def usual_better(name: str, goal: Goal | None) -> Better:
    """Which way is better, where the problem does not say.

    What the goal says; else less of a time or of memory, by the unit in the name. All
    others may go either way.

    Args:
        name: Name of the figure.
        goal: What it is meant to be, if anything.
    """
    if goal is not None:
        return _BY_SENSE[goal.sense]
    return "lower" if unit_of(name) in COSTS else "either"


_BY_SENSE: dict[str, Better] = {
    "at least": "higher",
    "at most": "lower",
    "between": "between",
}


def unit_of(name: str) -> str:
    """Unit of a figure or sample: the last word of its name, like "ms".

    "s" for names with "seconds" in them, like `seconds_30_starts`.
    """
    words = name.split("_")
    return "s" if "seconds" in words else words[-1]


class UnknownProblem(ValueError):
    """No problem has the name; the text suggests the near one."""


def discover(package: ModuleType) -> dict[str, str]:
    """Names of all problems and what they measure; nothing is imported.

    Args:
        package: The package that holds the problems as public modules.

    Returns:
        Name to first line of the docstring, sorted by name.
    """
    summaries = {}
    for folder in package.__path__:
        for path in Path(folder).glob("[!_]*.py"):
            text = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
            summaries[path.stem] = text.partition("\n")[0]
    return dict(sorted(summaries.items()))


class Problem(NamedTuple):
    """A problem, as its module has it.

    Attributes:
        run: Runs it.
        counts: Its parts, and how many times each is run; empty if it has none.
    """

    run: Callable[[Options], Outcome]
    counts: Mapping[str, int]


def load(package: ModuleType, name: str) -> Problem:
    """A problem by its name.

    Args:
        package: The package that holds the problems.
        name: Name of one of them.

    Raises:
        UnknownProblem: If there is none of that name.
    """
    known = discover(package)
    if name not in known:
        near = difflib.get_close_matches(name, known, n=1)
        hint = f" Did you mean {near[0]!r}?" if near else ""
        raise UnknownProblem(
            f"unknown benchmark {name!r}.{hint} Known: {', '.join(known)}."
        )
    module = importlib.import_module(f"{package.__name__}.{name}")
    return Problem(module.run, getattr(module, "COUNTS", {}))
