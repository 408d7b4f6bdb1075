"""Take the picture of the demonstration's report that README and docs show, from the report of a run.

    make demo                                  # prints the path of its report
    python -m tools.report_picture REPORT      # docs/images/report.png of it; needs playwright and Chromium

The figures in the picture are those of that run, on the machine that ran it.
"""

from __future__ import annotations

import argparse
import shutil
from pathlib import Path

PICTURE = Path(__file__).resolve().parent.parent / "docs" / "images" / "report.png"
_SIZE = {"width": 1050, "height": 950}  # pixels: the cards and the path error
_BROWSERS = ("chromium", "chromium-browser", "google-chrome")


def take(report: Path, picture: Path, browser: str) -> None:
    """Write what the top of a report looks like when it is opened."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        running = playwright.chromium.launch(executable_path=browser, args=["--no-sandbox"])
        page = running.new_page(viewport=_SIZE)
        page.goto(report.resolve().as_uri())
        page.screenshot(path=picture)
        running.close()


def main() -> None:
    """Take and save."""
    parser = argparse.ArgumentParser(description="Take the picture of the demonstration's report.")
    parser.add_argument("report", type=Path, help="HTML file of a demonstration")
    parser.add_argument("--output", type=Path, default=PICTURE, help="PNG file")
    options = parser.parse_args()
    browser = next(filter(None, map(shutil.which, _BROWSERS)), None)
    if browser is None:
        parser.exit(
            3,
            f"report_picture: none of {', '.join(_BROWSERS)} on the path; accepted: one of them\n",
        )
    if not options.report.is_file():
        parser.exit(
            2,
            f"report_picture: {options.report}: no such file; accepted: the report of rx90 demo\n",
        )
    take(options.report, options.output, browser)
    print(options.output)


if __name__ == "__main__":
    main()
