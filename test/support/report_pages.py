"""Reports in a real Chromium: what every one of them must do on a desk, on a phone, on paper, and without scripts."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

MOST_BYTES = 3_000_000
_MOST_DRAGS = 50
_RANGE = "place => [place.figures[0].x_range.start, place.figures[0].x_range.end]"
_OUTSIDE = """() => [...document.querySelectorAll('.still svg, table')].filter(one => one.closest('.scroll') === null
    && one.getBoundingClientRect().right > document.documentElement.clientWidth + 1).length"""


class ReportPage:
    """A report that is open in a browser, with all that went wrong in it."""

    def __init__(self, context: Any, file: Path) -> None:
        self.page = context.new_page()
        self.page.set_default_timeout(60_000)
        self.faults: list[str] = []
        self.page.on("pageerror", lambda error: self.faults.append(str(error)))
        self.page.on("console", self._note)
        self.page.on("request", lambda request: self._check(request.url, file.as_uri()))
        self.page.goto(file.as_uri())

    def _note(self, message: Any) -> None:
        if message.type in {"warning", "error"}:
            self.faults.append(message.text)

    def _check(self, url: str, own: str) -> None:
        if url != own and not url.startswith(("data:", "blob:")):
            self.faults.append(f"request of {url}")

    def plot(self, number: int) -> Any:
        """Return a plot that has been brought into the window and drawn."""
        place = self.page.locator("figure.plot").nth(number)
        place.scroll_into_view_if_needed()
        self.page.wait_for_function("place => place.dataset.state === 'drawn'", arg=place.element_handle())
        return place

    def zoom(self, number: int) -> None:
        """Drag over the middle of a plot's first panel until its axis shows about that part.

        More than once, because plots that are drawn meanwhile may move the one below the pointer.
        """
        place = self.plot(number)
        before = after = place.evaluate(_RANGE)
        for _ in range(_MOST_DRAGS):
            place.evaluate("place => place.scrollIntoView({block: 'start'})")
            box = place.locator(".live").bounding_box()
            x, y = box["x"] + 0.2 * box["width"], box["y"] + 70
            self.page.mouse.move(x, y)
            self.page.mouse.down()
            self.page.mouse.move(x + 0.1 * box["width"], y + 30, steps=3)
            self.page.mouse.up()
            self.page.wait_for_timeout(100)
            after = place.evaluate(_RANGE)
            if after != before:
                break
        assert before[0] < after[0] < after[1] < before[1]
        assert after[1] - after[0] < 0.5 * (before[1] - before[0])


class ReportCheck:
    """What reports are held to."""

    def __init__(self, browser: Any) -> None:
        self._browser = browser

    def open(self, file: Path, **options: Any) -> ReportPage:
        """Open a report in a context of its own, which ends with the browser."""
        return ReportPage(self._browser.new_context(**options), file)

    def __call__(self, file: Path) -> None:
        """Hold a report to what all of them must do: size, no requests, no complaints, zoom, phone, paper."""
        assert file.stat().st_size <= MOST_BYTES
        report = self.open(file, viewport={"width": 1200, "height": 900})
        report.zoom(0)
        report.plot(report.page.locator("figure.plot").count() - 1)
        self.print(report)
        report.page.emulate_media(media="screen")
        report.page.set_viewport_size({"width": 390, "height": 800})
        report.page.wait_for_function("() => document.documentElement.scrollWidth <= 390")
        assert report.faults == []
        report.page.context.close()

    def print(self, report: ReportPage) -> None:
        """Fail unless on paper each plot is a whole picture."""
        report.page.emulate_media(media="print")
        stills = report.page.locator(".still svg")
        assert stills.count() == report.page.locator("figure.plot").count()
        assert all(stills.nth(k).is_visible() for k in range(stills.count()))
        assert not report.page.locator(".live").first.is_visible()
        report.page.set_viewport_size({"width": 690, "height": 980})  # A4 without its margins
        assert report.page.evaluate(_OUTSIDE) == 0

    def pages_of_paper(self, report: ReportPage) -> int:
        """Return how many pages the report has as PDF."""
        return len(re.findall(rb"/Type\s*/Page\b", report.page.pdf(format="A4")))


@pytest.fixture
def check_report(chromium: Any) -> Callable[[Path], None]:
    """Return the check of a report; see ReportCheck."""
    return ReportCheck(chromium)


def leave_plots_out(patch: pytest.MonkeyPatch) -> None:
    """Have pages written without their plots, which take most of a command's time."""
    for drawn in ("as_svg", "plot_json"):
        patch.setattr(f"rx90_common.report.page.{drawn}", lambda *_: "")


@pytest.fixture
def undrawn(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave the plots out of pages that the test writes, unless it looks at one in the browser."""
    if "check_report" not in request.fixturenames:
        leave_plots_out(monkeypatch)
