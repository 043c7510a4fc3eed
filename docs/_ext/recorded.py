"""Numbers in the text of pages that are those of a benchmark record.

In the source of a page a comment behind such a number names its figure, as in
`65<!-- compile.demo_cold_s --> s`, or a sample, `25<!-- growth.series_solve_s[0] -->`.
A factor may follow it, `<!-- pneumatic_arm.E_f_kPa * 1e-3 -->`. Readers do not see it.
`python docs/_ext/recorded.py` writes the numbers of the committed records into all
pages, to as many digits as stand there. A test fails where they differ.
"""

import json
import math
import re
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[2]

MARK = re.compile(
    r"(?P<typed>(?<![\w.])-?\d+(?: \d{3})*(?:\.\d+)?(?:e-?\d+)?)"
    r"<!-- (?P<record>\w+)\.(?P<figure>[\w.]+)(?:\[(?P<index>\d+)\])?"
    r"(?: \* (?P<factor>[\d.e-]+))? -->"
)
"""A number, and the comment that says where it comes from."""


class Recorded(NamedTuple):
    """A number on a page.

    Attributes:
        source: Its record and figure, as the comment names them.
        typed: What the page says.
        record: What the record says, to as many digits.
    """

    source: str
    typed: str
    record: str


def pages() -> list[Path]:
    """Return the README and the pages of the docs."""
    own = [p for p in sorted(ROOT.glob("docs/**/*.md")) if "build" not in p.parts]
    return [ROOT / "README.md", *own]


def numbers(text: str) -> Iterator[Recorded]:
    """Yield the marked numbers of a page."""
    for mark in MARK.finditer(text):
        yield _recorded(mark)


def renewed(text: str) -> str:
    """Return a page with the numbers of the records."""

    def with_number(mark: re.Match[str]) -> str:
        return mark[0].replace(mark["typed"], _recorded(mark).record, 1)

    return MARK.sub(with_number, text)


def written(value: float, like: str) -> str:
    """Write a number to the digits of another one.

    As many significant digits, at least two, where final zeros of a whole number are
    none; thousands apart, and powers of ten where the other one has them.
    """
    digits = re.sub(r"e.*|[^\d.]", "", like)
    whole = "." not in digits
    digits = digits.replace(".", "").lstrip("0")
    n = max(len(digits.rstrip("0") if whole else digits), 1 if "e" in like else 2)
    if "e" in like:
        text = f"{value:.{n - 1}e}"
        return re.sub(r"e([+-])0*(\d)", lambda m: f"e{m[1].strip('+')}{m[2]}", text)
    if value == 0.0:
        return "0"
    places = n - 1 - math.floor(math.log10(abs(value)))
    rounded = round(value, places)
    # A whole number that was recorded as one has no digits behind the point.
    places = 0 if whole and float(value).is_integer() else max(places, 0)
    return f"{rounded:,.{places}f}".replace(",", " ")


def _recorded(mark: re.Match[str]) -> Recorded:
    path = ROOT / "benchmarks/records" / f"{mark['record']}.json"
    content = json.loads(path.read_text(encoding="utf-8"))
    if mark["index"] is None:
        value = content["figures"][mark["figure"]]
    else:
        value = content["samples"][mark["figure"]][int(mark["index"])]
    source = mark[0].partition("<!-- ")[2].removesuffix(" -->")
    number = written(value * float(mark["factor"] or 1), mark["typed"])
    return Recorded(source, mark["typed"], number)


def main() -> None:
    """Write the numbers of the records into all pages."""
    for page in pages():
        text = page.read_text(encoding="utf-8")
        for number in numbers(text):
            if number.typed != number.record:
                where = page.relative_to(ROOT)
                print(f"{where}: {number.source}: {number.typed} to {number.record}")
        page.write_text(renewed(text), encoding="utf-8")


if __name__ == "__main__":
    main()
