"""The pages' links, and the rows that say what follows which source."""

import ast
import importlib
import itertools
import math
import re
from collections.abc import Iterator
from functools import cache
from html import unescape
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import unquote, urlsplit

import nbformat
import pytest
import yaml
from markdown_it import MarkdownIt
from markdown_it.token import Token

from friction_bench.rig.rig_file import load_rig
from rx90_common.base.rates import Rates
from rx90_common.base.share import PACKAGES
from rx90_common.report.page import render_page

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs/explanation/sources.md"
WORKS = ROOT / "docs/reference/glossary_and_works.md"
CITATION = re.compile(
    r"\b([A-Z][\w-]+)(?: and others| et al\.)?,? \(?\b(19[5-9]\d|20[0-2]\d)\b(?!\s*(?:Hz|mm|s\b|N|µ|\d))"
)
NO_AUTHORS = {"Control", "DLR", "ICINCO", "ICRA", "Informatics", "November"}
"""Words before a year that are a journal, a conference, an institute or a month."""
VERDICTS = {"exact", "approximate", "different", "absent"}


class Row(NamedTuple):
    """One statement of a source: its number, the statement, where it is, the verdict, a remark and tests."""

    number: str
    statement: str
    where: str
    verdict: str
    remark: str
    test: str


@cache
def tokens(page: Path) -> list[Token]:
    text = page.read_text(encoding="utf-8")
    if page.suffix == ".ipynb":
        cells = nbformat.reads(text, as_version=4).cells
        text = "\n\n".join(cell.source for cell in cells if cell.cell_type == "markdown")
    return MarkdownIt("commonmark").enable("table").parse(text)


def tables() -> list[list[Row]]:
    found: list[list[Row]] = []
    cells: list[str] = []
    for before, token in itertools.pairwise(tokens(PAGE)):
        if token.type == "tbody_open":
            found.append([])
        elif token.type == "inline" and before.type == "td_open":
            cells.append(token.content)
        elif token.type == "tr_close" and cells:
            found[-1].append(Row(*cells))
            cells = []
    return found


TABLES = tables()
ROWS = [pytest.param(row, id=f"{name}-{row.number}") for name, rows in zip("ab", TABLES, strict=True) for row in rows]


def quoted_names(cell: str) -> list[str]:
    return re.findall(r"`([^`]+)`", cell)


def named(place: str) -> Any:
    """Return what a place names: a file, the value of a key in a file, or an object of a module."""
    file, _, key = place.partition(": ")
    if "/" in file:
        text = (ROOT / file).read_text(encoding="utf-8")
        content: Any = yaml.safe_load(text) if key else text
        for part in key.split(".") if key else ():
            content = content[part]
        return content
    parts = place.split(".")
    for length in range(len(parts), 0, -1):
        try:
            found = importlib.import_module(".".join(parts[:length]))
        except ModuleNotFoundError:
            continue
        for part in parts[length:]:
            found = getattr(found, part)
        return found
    raise LookupError(place)


def is_test(place: str) -> bool:
    file, _, function = place.partition("::")
    path = ROOT / file
    if not (path.is_file() and path.name.startswith("test_") and function.startswith("test_")):
        return False
    return any(isinstance(node, ast.FunctionDef) and node.name == function for node in ast.parse(path.read_text()).body)


@pytest.mark.parametrize("row", ROWS)
def test_a_row_names_what_is_there(row: Row) -> None:
    """A verdict is one of four words; places and tests exist; exact has a test, the others a sentence that says why."""
    assert row.verdict in VERDICTS
    places, tests = quoted_names(row.where), quoted_names(row.test)
    for place in places:
        assert named(place) is not None
    assert [one for one in tests if not is_test(one)] == []
    if row.verdict == "exact":
        assert places
        assert tests
    else:
        assert row.remark.endswith(".")
    if row.verdict != "absent":
        assert places


def test_all_equations_and_statements_have_a_row() -> None:
    """Both tables are numbered through, and each equation that a source numbers has one row of its own."""
    for rows, equations, least in zip(TABLES, ((17, 18, 19), (1, 2, 3, 4, 5)), (30, 40), strict=True):
        assert [int(row.number) for row in rows] == list(range(1, len(rows) + 1))
        assert len(rows) >= least
        for equation in equations:
            assert sum(row.statement.startswith(f"equation {equation}:") for row in rows) == 1


def test_every_work_that_is_cited_is_listed() -> None:
    """An author before a year, in pages, code and parameter files, stands with that year in one row of the works."""
    listed = [line for line in WORKS.read_text(encoding="utf-8").splitlines() if line.startswith("| ")]
    cited: dict[tuple[str, str], str] = {}
    for folder in ("docs", "config", "benchmarks", "tools", *PACKAGES):
        for file in (ROOT / folder).rglob("*"):
            if file.suffix in {".md", ".py", ".yaml"} and file != WORKS:
                text = re.sub(r"\s*\n\s*#?\s*", " ", file.read_text(encoding="utf-8")).replace("ue", "ü")
                cited |= {(name, year): file.name for name, year in CITATION.findall(text) if name not in NO_AUTHORS}
    assert len(cited) > 40
    missing = {
        work: file
        for work, file in cited.items()
        if not any(work[0] in line.replace("ue", "ü") and work[1] in line for line in listed)
    }
    assert missing == {}


def test_each_doi_is_one_and_leads_to_itself() -> None:
    """A DOI has the form of one, its link is that of doi.org, and no two works have the same."""
    found = re.findall(r"\[(10\.\d{4,5}/[^\]\s]+)\]\(https://doi\.org/([^\s]+)\) \|", WORKS.read_text(encoding="utf-8"))
    assert len(found) > 30
    assert all(name == unquote(target) for name, target in found)
    assert len({name for name, _ in found}) == len(found)


def test_every_report_holds_the_glossary() -> None:
    """The frame holds each term and each work of the page, with its DOI, and each report is written into the frame."""
    frame = render_page("rx90_common.report", "page.html.j2").partition("<footer>")[2].partition("</footer>")[0]
    rows = [line.split(" | ") for line in WORKS.read_text(encoding="utf-8").splitlines() if line.startswith("| ")]
    for row in rows:
        first = re.sub(r"[*`]|\]\([^)]*\)|\[", "", row[0].removeprefix("| "))
        assert first in unescape(re.sub(r"</?(em|code|a)\b[^>]*>", "", frame))
    links = set(re.findall(r"\]\((https://doi[^\s]+)\) \|", WORKS.read_text(encoding="utf-8")))
    assert links <= {unescape(link) for link in re.findall(r'href="([^"]+)"', frame)}
    assert ".md" not in frame  # pages that a report's reader does not have
    pages = [page for package in PACKAGES for page in (ROOT / package).rglob("*.html.j2") if page.name[0] != "_"]
    without = [page.name for page in pages if not page.read_text().startswith('{% extends "page.html.j2" %}')]
    assert sorted(without) == ["page.html.j2", "plots.html.j2"]
    assert len(pages) >= 10


def test_published_rates_and_rig_figures_are_the_shipped_ones() -> None:
    """1 and 4 kHz; 31:1, 504 pulses of 0.714286 degrees, 20 ms; no code of the firmware asks for more than 0.18 Nm."""
    assert (Rates().position_hz, Rates().base_hz) == (1000, 4000)
    rig = load_rig(ROOT / "config/rig/gm8224.yaml")
    assert (rig.gear.ratio, rig.counts_per_revolution, rig.tick) == (31.0, 504, 0.02)
    assert math.degrees(rig.angle_step) == pytest.approx(0.714286, abs=5e-7)
    text = (ROOT / "firmware/core/rig_config.h").read_text(encoding="utf-8")
    figures = {name: int(value) for name, value in re.findall(r"#define (\w+) (\d+)u", text)}
    assert (figures["COUNTS_PER_REV"], figures["TICK_US"]) == (504, 20_000)
    full_scale, code = figures["DAC_FULL_SCALE"] * 1e-5, figures["TORQUE_LIMIT_CODE"]
    assert code * full_scale / 255 <= 0.18 < (code + 1) * full_scale / 255


PAGES = [
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    *sorted((ROOT / "docs").rglob("*.md")),
    *sorted((ROOT / "docs").rglob("*.ipynb")),
]
NAMED = re.compile(r"(?<![\w/.])docs/[\w/]+\.(?:md|ipynb|png|svg|webp)")


def links(page: Path) -> Iterator[str]:
    for token in tokens(page):
        for child in token.children or ():
            target = child.attrGet("href") or child.attrGet("src")
            if target is not None:
                yield str(target)


@cache
def anchors(page: Path) -> set[str]:
    """Return the anchors of a page's headings, as GitHub and the site make them."""
    found = tokens(page)
    headings = [found[k + 1].children or [] for k, token in enumerate(found) if token.type == "heading_open"]
    texts = ["".join(child.content for child in children) for children in headings]
    return {re.sub(r"[^\w\- ]", "", text.strip().lower()).replace(" ", "-") for text in texts}


def test_every_link_leads_somewhere() -> None:
    """A link's file is there, its anchor is a heading of that page, and an address has a host and no blank."""
    wrong = []
    for page in PAGES:
        for target in links(page):
            address = urlsplit(target)
            if address.scheme:
                good = address.scheme == "https" and "." in address.netloc and " " not in target
            else:
                file = (page.parent / address.path).resolve() if address.path else page
                good = file.exists() and file.is_relative_to(ROOT)
                good = good and (not address.fragment or address.fragment in anchors(file))
            wrong += [f"{page.relative_to(ROOT)}: {target}"] * (not good)
    assert not wrong


def test_how_to_pages_fit_on_two_screens() -> None:
    for page in (ROOT / "docs/howto").glob("*.md"):
        text = page.read_text(encoding="utf-8")
        assert len(text.split()) <= 1000, page.name
        rows = [table.count("\n") - 2 for table in re.findall(r"(?:^ *\|.*\n)+", text, re.MULTILINE)]
        assert max(rows, default=0) <= 15, page.name


def test_every_page_that_is_named_is_there() -> None:
    wrong = []
    for folder in ("", *PACKAGES, "benchmarks", "config", "docs", "firmware", "launch", "test", "tools"):
        files = ROOT.glob("*.*") if not folder else (p for root in ROOT.glob(folder) for p in root.rglob("*.*"))
        for file in files:
            if file.suffix in {".py", ".md", ".rst", ".yaml", ".xml", ".toml", ".txt", ".c", ".h", ".ipynb"}:
                for name in NAMED.findall(file.read_text(encoding="utf-8")):
                    wrong += [f"{file.relative_to(ROOT)}: {name}"] * (not (ROOT / name).is_file())
    assert not wrong


def test_tests_that_a_page_names_are_there() -> None:
    wrong = []
    for page in PAGES:
        for file, name in re.findall(r"(test_\w+\.py)::(\w+)", page.read_text(encoding="utf-8")):
            found = (ROOT / "test").rglob(file)
            good = any(f"def {name}(" in path.read_text(encoding="utf-8") for path in found)
            wrong += [f"{page.relative_to(ROOT)}: {file}::{name}"] * (not good)
    assert not wrong


def test_walks_name_functions_that_are_there() -> None:
    """Each step of the walks in architecture.md names a file, and functions or classes that are defined in it."""
    page = (ROOT / "docs/explanation/architecture.md").read_text(encoding="utf-8")
    steps = re.findall(r"^\| `([\w/]+\.py)` \| ([^|]+) \|", page, re.MULTILINE)
    assert len(steps) > 25
    for file, said in steps:
        text = (ROOT / file).read_text(encoding="utf-8")
        for name in re.findall(r"[\w.]*?(\w+)`", said):
            assert re.search(rf"(def|class) {name}\b|^{name}\b", text, re.MULTILINE), f"{file}: {name}"
