"""Links of README.md, CONTRIBUTING.md and docs/ lead somewhere: to a page and its heading, a file, or an address."""

from __future__ import annotations

import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from urllib.parse import urlsplit

import nbformat
from markdown_it import MarkdownIt
from markdown_it.token import Token

ROOT = Path(__file__).resolve().parents[2]
PAGES = [
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    *sorted((ROOT / "docs").rglob("*.md")),
    *sorted((ROOT / "docs").rglob("*.ipynb")),
]
NAMED = re.compile(r"(?<![\w/.])docs/[\w/]+\.(?:md|ipynb|png|svg|webp)")


@cache
def tokens(page: Path) -> list[Token]:
    """Return the Markdown tokens of a page or a notebook."""
    text = page.read_text(encoding="utf-8")
    if page.suffix == ".ipynb":
        cells = nbformat.reads(text, as_version=4).cells
        text = "\n\n".join(cell.source for cell in cells if cell.cell_type == "markdown")
    return MarkdownIt("commonmark").enable("table").parse(text)


def links(page: Path) -> Iterator[str]:
    """Give the targets of links and pictures of a page."""
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


def test_every_page_that_is_named_is_there() -> None:
    """A page of docs/ that code, help, configuration or the changelog names by its path exists."""
    wrong = []
    for folder in (
        "",
        "rx90_*",
        "friction_bench",
        "benchmarks",
        "config",
        "docs",
        "firmware",
        "launch",
        "test",
        "tools",
    ):
        files = ROOT.glob("*.*") if not folder else (p for root in ROOT.glob(folder) for p in root.rglob("*.*"))
        for file in files:
            if file.suffix in {".py", ".md", ".rst", ".yaml", ".xml", ".toml", ".txt", ".c", ".h", ".ipynb"}:
                for name in NAMED.findall(file.read_text(encoding="utf-8")):
                    wrong += [f"{file.relative_to(ROOT)}: {name}"] * (not (ROOT / name).is_file())
    assert not wrong


def test_every_page_is_reached_from_the_first() -> None:
    """From docs/index.md links lead to every page and notebook of docs/."""
    reached, open_pages = set(), [ROOT / "docs/index.md"]
    while open_pages:
        page = open_pages.pop()
        if page not in reached:
            reached.add(page)
            targets = [(page.parent / urlsplit(target).path).resolve() for target in links(page)]
            open_pages += [target for target in targets if target in PAGES]
    assert reached >= {page for page in PAGES if page.is_relative_to(ROOT / "docs")}


def test_tests_that_a_page_names_are_there() -> None:
    """Where a page says `test_file.py::test_name`, one file of that name has that test."""
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
