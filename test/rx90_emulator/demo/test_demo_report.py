"""The report of the demonstration."""

from pathlib import Path
from typing import Any

import pytest

import rx90_emulator as rx
from rx90_emulator.demo.demonstration import RunReport


@pytest.fixture(scope="module")
def pages(tmp_path_factory: pytest.TempPathFactory, shipped: rx.Setup, task: rx.LineTask) -> list[Path]:
    folder = tmp_path_factory.mktemp("demo")
    bag = folder / "run"
    rx.write_bag(rx.run_line(shipped, task, record_fast=True), bag)
    run = RunReport(bag, shipped, task, 0.0)
    found = [folder / "report.html", folder / "again.html"]
    for page in found:
        page.write_text(run.page(bag, rx.compare_bags(bag, bag), 1.0, "real time"), encoding="utf-8")
    return found


def test_the_same_run_gives_the_same_page(pages: list[Path]) -> None:
    """A report of the same run has the same bytes: no counter, no chance, no date of its libraries."""
    assert pages[0].read_bytes() == pages[1].read_bytes()


def test_the_report_in_a_browser(check_report: Any, pages: list[Path]) -> None:
    """The page holds to what all reports do, takes few sheets of paper, and says without scripts what plots need."""
    check_report(pages[0])
    report = check_report.open(pages[0], viewport={"width": 1200, "height": 900})
    assert report.faults == []
    assert check_report.pages_of_paper(report) >= 3
    report.page.context.close()
    plain = check_report.open(pages[0], java_script_enabled=False)
    assert plain.page.locator("noscript").count() == plain.page.locator("figure.plot").count()
    plain.page.context.close()
