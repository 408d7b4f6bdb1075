"""Write the tables of measured figures in README.md and docs/, all of them from benchmarks/measured.json.

    python -m benchmarks.figures [--add out/bench.json]

A page says where a table belongs by two comments, `<!-- figures: NAME -->` and `<!-- end of figures -->`; what is
between them is replaced by the table of that name in benchmarks/figures.md. measured.json lists for each figure of
out/bench.json what was measured so far; a table shows the lowest and the highest. `--add` adds what one machine has
measured. If a change of the code moves a figure, delete its list in measured.json and measure anew.
"""

from __future__ import annotations

import argparse
import json
import re
import string
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from benchmarks.report import ROOT
from rx90_common.base.errors import ConfigError, Rx90Error
from rx90_common.base.quoting import quoted

MEASURED = ROOT / "benchmarks" / "measured.json"
TABLES = ROOT / "benchmarks" / "figures.md"
UNMEASURED = "not measured yet"

Measured = Mapping[str, Sequence[float]]

_WITH_UNIT = re.compile(rf"({UNMEASURED}) [^\s|]+(?= \|)")
_PLACE = re.compile(r"(<!-- figures: (\w+) -->\n)(.*?)(<!-- end of figures -->)", re.DOTALL)


@dataclass(frozen=True)
class Range:
    """The values that were measured of one figure; `runs` where each is a median: lowest and highest single runs."""

    values: Sequence[float]
    runs: Sequence[float]

    def __format__(self, spec: str) -> str:
        """Return the lowest and the highest, or one number if they look the same; `%` after the format: in percent."""
        if not self.values:
            return UNMEASURED
        single = f" (single runs: {_between(self.runs, spec)})" if self.runs else ""
        return _between(self.values, spec) + single


def _between(values: Sequence[float], spec: str) -> str:
    factor = 100.0 if spec.endswith("%") else 1.0
    low, high = (format(factor * value, spec.rstrip("%")) for value in (min(values), max(values)))
    return low if low == high else f"{low} to {high}"


def _range(key: str, measured: Measured) -> Range:
    low, high = (measured.get(f"{key}_{which}", ()) for which in ("lowest", "highest"))
    return Range(measured.get(key, ()), [*low, *high])


def tables() -> dict[str, str]:
    """Return the tables by name, with keys of out/bench.json in braces."""
    return {name: rows for _, name, rows, _ in _PLACE.findall(TABLES.read_text(encoding="utf-8"))}


def keys() -> set[str]:
    """Return the keys of out/bench.json that tables name."""
    return {
        key for rows in tables().values() for _, key, _, _ in string.Formatter().parse(rows) if key
    }


def pages() -> list[Path]:
    """Return the pages that may hold tables."""
    return [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]


def with_figures(page: str, measured: Measured) -> str:
    """Return the text of a page with its tables written anew.

    Raises:
        ConfigError: if the page asks for a table that there is not.
    """
    known, ranges = tables(), {key: _range(key, measured) for key in keys()}

    def written(place: re.Match[str]) -> str:
        if place[2] not in known:
            raise ConfigError(f"the table is {place[2]!r}; accepted: {', '.join(known)}")
        return place[1] + _WITH_UNIT.sub(r"\1", known[place[2]].format_map(ranges)) + place[4]

    return _PLACE.sub(written, page)


def add(measured: Measured, figures: Mapping[str, float]) -> dict[str, list[float]]:
    """Return the measured values with those of one machine; figures that no table shows are left out.

    Raises:
        ConfigError: if a figure of the machine is not a number.
    """
    names = {f"{key}{which}" for key in keys() for which in ("", "_lowest", "_highest")}
    for name in names & figures.keys():
        if not isinstance(figures[name], int | float):
            raise ConfigError(f"{name} is {quoted(figures[name])}; accepted: a number")
    both = {
        name: {*measured.get(name, ()), *([figures[name]] if name in figures else [])}
        for name in sorted(names)
    }
    return {name: sorted(values) for name, values in both.items() if values}


def as_text(measured: Measured) -> str:
    """Return the text of measured.json: a line for each figure."""
    lines = (f"  {json.dumps(key)}: {json.dumps(values)}" for key, values in measured.items())
    return "{\n" + ",\n".join(lines) + "\n}\n"


def read(file: Path) -> dict:  # type: ignore[type-arg]  # lists in measured.json, numbers in bench.json
    """Read figures.

    Raises:
        ConfigError: if the file cannot be read, or is not a JSON object.
    """
    try:
        found = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise ConfigError(f"{file}: {error}; accepted: a file that `make bench` wrote") from error
    if not isinstance(found, dict):
        raise ConfigError(f"{file} is not a JSON object; accepted: a file that `make bench` wrote")
    return found


def main() -> int:
    """Add what is asked for and write the tables; return 2 if a file is refused."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.figures", description=(__doc__ or "").splitlines()[0]
    )
    parser.add_argument(
        "--add",
        type=Path,
        metavar="FILE",
        help="what one machine has measured, as in out/bench.json",
    )
    options = parser.parse_args()
    try:
        measured = read(MEASURED)
        if options.add is not None:
            measured = add(measured, read(options.add))
        written = {
            page: with_figures(page.read_text(encoding="utf-8"), measured) for page in pages()
        }
    except Rx90Error as error:
        print(error, file=sys.stderr)
        return error.exit_code
    for file, content in {MEASURED: as_text(measured), **written}.items():
        file.write_text(content, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
