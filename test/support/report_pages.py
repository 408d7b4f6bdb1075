"""Reports in a real Chromium: what every one of them must do on a desk, on a phone, on paper, and without scripts."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

MOST_BYTES = 3_000_000
_MOST_DRAGS = 50
_RANGE = "() => (range => [range.start, range.end])(Bokeh.documents[0].roots()[0].x_range)"
_OUTSIDE = """() => [...document.querySelectorAll('.plot, table')].filter(one => one.closest('.scroll') === null
    && one.getBoundingClientRect().right > document.documentElement.clientWidth + 1).length"""
_DRAWN = "() => window.Bokeh?.documents.length === 1 && Bokeh.documents[0].is_idle"


class ReportPage:
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

    def wait(self) -> None:
        self.page.wait_for_function(_DRAWN)

    def zoom(self) -> None:
        self.wait()
        before = after = self.page.evaluate(_RANGE)
        place = self.page.locator("figure.plot > div > *").first
        for _ in range(_MOST_DRAGS):
            place.evaluate("place => place.scrollIntoView({block: 'end'})")
            box = place.bounding_box()
            x, y = box["x"] + 0.3 * box["width"], box["y"] + box["height"] - 120
            self.page.mouse.move(x, y)
            self.page.mouse.down()
            self.page.mouse.move(x + 0.1 * box["width"], y + 30, steps=3)
            self.page.mouse.up()
            self.page.wait_for_timeout(100)
            after = self.page.evaluate(_RANGE)
            if after != before:
                break
        assert before[0] < after[0] < after[1] < before[1]
        assert after[1] - after[0] < 0.5 * (before[1] - before[0])


class ReportCheck:
    def __init__(self, browser: Any) -> None:
        self._browser = browser

    def open(self, file: Path, **options: Any) -> ReportPage:
        return ReportPage(self._browser.new_context(**options), file)

    def __call__(self, file: Path) -> None:
        assert file.stat().st_size <= MOST_BYTES
        report = self.open(file, viewport={"width": 1200, "height": 900})
        report.zoom()
        report.page.emulate_media(media="print")
        report.page.set_viewport_size({"width": 690, "height": 980})  # A4 without its margins
        assert report.page.evaluate(_OUTSIDE) == 0
        report.page.emulate_media(media="screen")
        report.page.set_viewport_size({"width": 390, "height": 800})
        report.page.wait_for_function("() => document.documentElement.scrollWidth <= 390")
        assert report.faults == []
        report.page.context.close()

    def pages_of_paper(self, report: ReportPage) -> int:
        pdf = report.page.pdf(format="A4")
        return len(re.findall(rb"/Type\s*/Page\b", pdf))


@pytest.fixture
def check_report(chromium: Any) -> Callable[[Path], None]:
    return ReportCheck(chromium)


def leave_plots_out(patch: pytest.MonkeyPatch) -> None:
    """Have pages written without their plots, which take most of a command's time."""
    patch.setattr("rx90_common.report.page.components", lambda figures, **_: ("", [""] * len(figures)))


@pytest.fixture
def undrawn(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    if "check_report" not in request.fixturenames:
        leave_plots_out(monkeypatch)
